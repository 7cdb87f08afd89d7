"""Tabulate the acceleration of a simulator that cannot be compiled.

MuJoCo, an FMU or a Python step function is evaluated for its acceleration at points in position, velocity and
input: at even nodes of the position, at Chebyshev points of the other two. That happens once for each set of
the simulator's own parameters. :mod:`labhil.physics.tabulated` then simulates all windows and all effects by
one compiled kernel, with events.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import CubicSpline

from labhil.errors import UsageError
from labhil.physics.tabulated import Table
from labhil.signals import FloatArray

Acceleration = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Positions, velocities, inputs, each (m,), to accelerations (m,)."""

ROUNDING = 1e-8
"""Share of the acceleration's size below which a power of velocity or input is rounding."""


class OperatingRange(NamedTuple):
    """Range of position, velocity and input in which a table is valid, SI."""

    x_low: float = -np.pi
    x_high: float = np.pi
    speed: float = 10.0
    u_low: float = -1.0
    u_high: float = 1.0

    @classmethod
    def along(
        cls,
        x: FloatArray | None,
        speeds: FloatArray,
        u: FloatArray,
        horizon: float,
        clip: tuple[float, float],
        *,
        speed_margin: float = 2.0,
    ) -> OperatingRange:
        """Choose the range around what a recording contains.

        Args:
            x: Measured positions (n,); None where none is measured: then each window starts at 0.
            speeds: Velocities (m,).
            u: Inputs (n,).
            horizon: Longest window, s.
            clip: Limits of the input.
            speed_margin: Largest simulated velocity over the largest recorded one.

        Returns:
            The range.
        """
        speed = float(np.max(np.abs(speeds), initial=0.0)) or 1.0
        if x is None:
            low, high = -speed * horizon, speed * horizon
        else:
            low, high = float(np.min(x)), float(np.max(x))
        margin = max(0.5 * (high - low), 0.1 * speed) if x is not None else 0.0
        limits = np.clip([np.min(u), np.max(u)], *clip)
        u_low, u_high = float(limits[0]), float(limits[1])
        half = 0.5 * (u_high - u_low) or abs(u_high) or 1.0
        middle = 0.5 * (u_low + u_high)
        return cls(low - margin, high + margin, speed_margin * speed, middle - half, middle + half)


@dataclass(frozen=True, slots=True)
class TableShape:
    """Numbers of powers of input and velocity, and of cells of the position, that an acceleration needs."""

    inputs: int
    velocities: int
    cells: int

    @classmethod
    def of(
        cls,
        acceleration: Acceleration,
        where: OperatingRange,
        name: str,
        rounding: float = ROUNDING,
        *,
        n_positions: int = 7,
        max_inputs: int = 7,
        max_velocities: int = 9,
        max_last_power: float = 1e-4,
        cells: tuple[int, ...] = (1, 10, 20, 40, 80, 160),
        max_error: float = 1e-5,
    ) -> TableShape:
        """Determine the powers from samples at a few positions, and the cells from samples at all.

        Args:
            acceleration: The simulator at some values of its parameters.
            where: Range of the table.
            name: Name of the simulator, for the message.
            rounding: Share of the acceleration's size below which a power is left out.
            n_positions: Positions that are sampled.
            max_inputs: Most powers of the input.
            max_velocities: Most powers of the velocity.
            max_last_power: Largest share of the last two powers. Larger ones show a corner or a jump.
            cells: Numbers of cells to try, each of which divides the last.
            max_error: Largest error of the spline over the position, relative to the acceleration's size.

        Returns:
            The shape.

        Raises:
            UsageError: The acceleration is not smooth in velocity or input.
        """
        x = np.linspace(where.x_low, where.x_high, n_positions)
        accelerations = _sample(acceleration, x, where, max_inputs, max_velocities)
        size = float(np.max(np.abs(accelerations))) or 1.0
        by_input = _coefficient_sizes(accelerations, 1, size)
        by_velocity = _coefficient_sizes(accelerations, 2, size)
        for what, sizes in (("input", by_input), ("velocity", by_velocity)):
            if np.max(sizes[-2:]) > max_last_power:
                raise UsageError(
                    f"simulator {name!r}: expected an acceleration that is smooth in its {what}, found one "
                    "with a corner or a jump; leave dry friction, dead zones and limits to the effects that "
                    "are offered (`labhil terms`)"
                )
        inputs, velocities = _count_needed(by_input, rounding), _count_needed(by_velocity, rounding)
        x = np.linspace(where.x_low, where.x_high, cells[-1] + 1)
        accelerations = _sample(acceleration, x, where, inputs, velocities)
        allowed = max(max_error, rounding) * size
        enough = [n for n in cells if _error_of_cells(x, accelerations, cells[-1] // n) <= allowed]
        return cls(inputs, velocities, min(enough))


def fill_table(
    acceleration: Acceleration,
    where: OperatingRange,
    shape: TableShape,
    clip: tuple[float, float],
) -> Table:
    """Sample the acceleration and fit splines over the position.

    Args:
        acceleration: The simulator at some values of its parameters.
        where: Range of the table.
        shape: Powers of input and velocity, and cells of the position.
        clip: Limits of the input.

    Returns:
        The table.

    Raises:
        UsageError: An acceleration is not finite.
    """
    cells, x = shape.cells, np.linspace(where.x_low, where.x_high, shape.cells + 1)
    accelerations = _sample(acceleration, x, where, shape.inputs, shape.velocities)
    powers = np.einsum(
        "ia,jb,xab->xij", _to_powers(shape.inputs), _to_powers(shape.velocities), accelerations, optimize=True
    )
    spline = np.asarray(CubicSpline(np.arange(cells + 1.0), powers, axis=0).c)
    return Table(
        where.x_low,
        cells / (where.x_high - where.x_low),
        where.speed,
        0.5 * (where.u_low + where.u_high),
        0.5 * (where.u_high - where.u_low),
        *clip,
        np.ascontiguousarray(np.moveaxis(spline, 1, 0)),
    )


def _sample(
    acceleration: Acceleration, x: FloatArray, where: OperatingRange, inputs: int, velocities: int
) -> FloatArray:
    """Accelerations (positions, inputs, velocities) at Chebyshev points of the last two."""
    u = 0.5 * (where.u_low + where.u_high) + 0.5 * (where.u_high - where.u_low) * _chebyshev_points(inputs)
    v = where.speed * _chebyshev_points(velocities)
    places, drives, speeds = np.meshgrid(x, u, v, indexing="ij")
    accelerations = acceleration(places.ravel(), speeds.ravel(), drives.ravel()).reshape(places.shape)
    if not np.isfinite(accelerations).all():
        raise UsageError(
            f"expected a simulator with finite accelerations, found others where the position is "
            f"{where.x_low:.4g} to {where.x_high:.4g}, the velocity up to {where.speed:.4g} and the input "
            f"{where.u_low:.4g} to {where.u_high:.4g}"
        )
    return accelerations


def _error_of_cells(x: FloatArray, accelerations: FloatArray, stride: int) -> float:
    """Largest error of the spline through every so many positions, at all of them."""
    spline = CubicSpline(x[::stride], accelerations[::stride], axis=0)
    return float(np.max(np.abs(spline(x) - accelerations)))


def _chebyshev_points(count: int) -> FloatArray:
    """Points in −1 … 1, (count,); 0 for a single one."""
    return np.asarray(chebyshev.chebpts1(count)) if count > 1 else np.zeros(1)


def _to_powers(count: int) -> FloatArray:
    """Matrix from values at the Chebyshev points to coefficients of powers."""
    return np.asarray(np.linalg.inv(np.vander(_chebyshev_points(count), increasing=True)))


def _coefficient_sizes(accelerations: FloatArray, axis: int, size: float) -> FloatArray:
    """Largest Chebyshev coefficient of each order along an axis, relative to ``size``."""
    along = np.moveaxis(accelerations, axis, 0)
    count = len(along)
    matrix = np.linalg.inv(chebyshev.chebvander(_chebyshev_points(count), count - 1))
    return np.asarray(np.max(np.abs(matrix @ along.reshape(count, -1)), axis=1) / size)


def _count_needed(sizes: FloatArray, rounding: float) -> int:
    needed = np.flatnonzero(sizes > rounding)
    return int(needed[-1]) + 1 if len(needed) else 1
