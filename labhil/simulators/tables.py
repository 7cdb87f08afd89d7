"""The acceleration of a simulator that nobody can compile, as a table that is exact where it is smooth.

MuJoCo, and a Python function that makes a step, are evaluated for their acceleration at points in position,
velocity and input: at even nodes along the way, at Chebyshev's points of the other two. The slow evaluation
happens once for each set of the simulator's own parameters; all windows and all effects are then simulated
by one compiled kernel, with rests as events.
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

Ask = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Positions, velocities, inputs, each (m,), to accelerations (m,)."""

MOST_VELOCITIES = 9
MOST_INPUTS = 7
PROBED = 7
"""Points of velocity and input, and places along the way, at which the shape is determined."""

NEGLIGIBLE = 1e-8
SMOOTH = 1e-4
"""Share of the acceleration's size: below the first a power is left out, above the second the last power of
all shows that the acceleration has a corner or a jump."""

CELLS = 160
"""Along the way."""

BEYOND = 2.0
"""Times the largest recorded speed, up to which a simulation may go."""


class Reach(NamedTuple):
    """Where a table has to be right: position, size of the velocity, and input, SI."""

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
    ) -> Reach:
        """Around what a recording shows; positions that nobody measured begin at 0 in each window."""
        speed = float(np.max(np.abs(speeds), initial=0.0)) or 1.0
        if x is None:
            low, high = -speed * horizon, speed * horizon
        else:
            low, high = float(np.min(x)), float(np.max(x))
        margin = max(0.5 * (high - low), 0.1 * speed) if x is not None else 0.0
        ends = np.clip([np.min(u), np.max(u)], *clip)
        least, most = float(ends[0]), float(ends[1])
        half = 0.5 * (most - least) or abs(most) or 1.0
        middle = 0.5 * (least + most)
        return cls(low - margin, high + margin, BEYOND * speed, middle - half, middle + half)


@dataclass(frozen=True, slots=True)
class Shape:
    """How many powers of input and velocity an acceleration has within a reach."""

    inputs: int
    velocities: int

    @classmethod
    def of(cls, ask: Ask, reach: Reach, name: str, rough: float = NEGLIGIBLE) -> Shape:
        """Sample a few places, and leave out powers below ``rough``; UsageError where it is not smooth."""
        x = np.linspace(reach.x_low, reach.x_high, PROBED)
        accelerations = _sample(ask, x, reach, MOST_INPUTS, MOST_VELOCITIES)
        size = float(np.max(np.abs(accelerations))) or 1.0
        by_input = _strengths(accelerations, 1, size)
        by_velocity = _strengths(accelerations, 2, size)
        for what, strengths in (("input", by_input), ("velocity", by_velocity)):
            if np.max(strengths[-2:]) > SMOOTH:
                raise UsageError(
                    f"simulator {name!r}: expected an acceleration that is smooth in its {what}, found one "
                    "with a corner or a jump; leave dry friction, dead zones and limits to the effects that "
                    "are offered (`labhil terms`)"
                )
        return cls(_count_needed(by_input, rough), _count_needed(by_velocity, rough))


def table_of(ask: Ask, reach: Reach, shape: Shape, clip: tuple[float, float]) -> Table:
    """Fill a table.

    Args:
        ask: The simulator at some values of its own parameters.
        reach: Where the table has to be right.
        shape: Powers of input and velocity that it needs.
        clip: What the simulator clips its input to.

    Returns:
        The table.
    """
    cells = CELLS
    x = np.linspace(reach.x_low, reach.x_high, cells + 1)
    accelerations = _sample(ask, x, reach, shape.inputs, shape.velocities)
    powers = np.einsum(
        "ia,jb,xab->xij", _to_powers(shape.inputs), _to_powers(shape.velocities), accelerations, optimize=True
    )
    spline = np.asarray(CubicSpline(np.arange(cells + 1.0), powers, axis=0).c)
    return Table(
        reach.x_low,
        cells / (reach.x_high - reach.x_low),
        reach.speed,
        0.5 * (reach.u_low + reach.u_high),
        0.5 * (reach.u_high - reach.u_low),
        *clip,
        np.ascontiguousarray(np.moveaxis(spline, 1, 0)),
    )


def _sample(ask: Ask, x: FloatArray, reach: Reach, inputs: int, velocities: int) -> FloatArray:
    """Accelerations (places, inputs, velocities) at Chebyshev's points of the last two."""
    u = 0.5 * (reach.u_low + reach.u_high) + 0.5 * (reach.u_high - reach.u_low) * _points(inputs)
    v = reach.speed * _points(velocities)
    places, drives, speeds = np.meshgrid(x, u, v, indexing="ij")
    accelerations = ask(places.ravel(), speeds.ravel(), drives.ravel()).reshape(places.shape)
    if not np.isfinite(accelerations).all():
        raise UsageError(
            f"expected a simulator with finite accelerations, found others where the position is "
            f"{reach.x_low:.4g} to {reach.x_high:.4g}, the velocity up to {reach.speed:.4g} and the input "
            f"{reach.u_low:.4g} to {reach.u_high:.4g}"
        )
    return accelerations


def _points(count: int) -> FloatArray:
    """Points in −1 … 1; of a single one 0."""
    return np.asarray(chebyshev.chebpts1(count)) if count > 1 else np.zeros(1)


def _to_powers(count: int) -> FloatArray:
    """Matrix from values at the points to coefficients of powers."""
    return np.asarray(np.linalg.inv(np.vander(_points(count), increasing=True)))


def _strengths(accelerations: FloatArray, axis: int, size: float) -> FloatArray:
    """Largest Chebyshev coefficient of each order along an axis, over the size."""
    along = np.moveaxis(accelerations, axis, 0)
    count = len(along)
    matrix = np.linalg.inv(chebyshev.chebvander(_points(count), count - 1))
    return np.asarray(np.max(np.abs(matrix @ along.reshape(count, -1)), axis=1) / size)


def _count_needed(strengths: FloatArray, rough: float) -> int:
    counted = np.flatnonzero(strengths > rough)
    return int(counted[-1]) + 1 if len(counted) else 1
