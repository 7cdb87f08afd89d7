"""A magnet's measured forces: a table of current, position and force, and the spline through it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator, RectBivariateSpline

from labhil.errors import RigFileError
from labhil.physics.mapped import Axis, Chart, charted_force
from labhil.rig import KnownFile
from labhil.signals import FloatArray

COLUMNS = ("coil_current", "plunger_position", "magnetic_force")

FEWEST = 6
"""Points: a plane and its curvature."""

ACROSS = 33
"""Nodes in each direction of the grid that scattered points are brought to; what that costs is stated."""

NEIGHBOURS = 64
"""Points next to a node that give its force where there are many more: all of them take a minute."""

BEYOND = 0.01
"""Share of the table's range that noise of a reading may lie beyond its edge without a word."""

FINEST = 100
"""Equal cells, at most, where a table's nodes are not equally far apart: its cells then fill 1.3 MB."""

HERMITE = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [-3, 3, -2, -1], [2, -2, 1, 1]], dtype=np.float64)
"""From values and slopes at 0 and 1 to the powers of a cubic between them."""


@dataclass(frozen=True, slots=True)
class ForceMap:
    """Forces ``force`` (n, m) at ``current`` (n,) and ``position`` (m,), A, m and N, and their ``chart``.

    ``rms`` and ``worst`` are how far the chart is from the points that were given, N: zero but for rounding
    where these stand on a grid.
    """

    current: FloatArray
    position: FloatArray
    chart: Chart
    points: int
    gridded: bool
    rms: float
    worst: float

    def over(self, mass: float) -> Chart:
        """The chart as a kernel takes it, over the moving mass."""
        return self.chart._replace(scale=1.0 / mass)

    def notes(self, current: FloatArray, position: FloatArray) -> list[str]:
        """What is done with the table, and where a recording (n,), A and m, leaves it; a line each."""
        low, high, left, right = self.current[0], self.current[-1], self.position[0], self.position[-1]
        how = (
            f"on a grid of {len(self.current)} × {len(self.position)}"
            if self.gridded
            else f"on no grid, brought to one of {ACROSS} × {ACROSS}"
        )
        lines = [
            f"force_map: {self.points} points {how}; the bicubic spline is off them by {self.rms:.2g} N "
            f"(RMS), at most {self.worst:.2g} N. Beyond {low:.4g} to {high:.4g} A and "
            f"{left:.4g} to {right:.4g} m it goes on straight."
        ]
        ranges = ((current, low, high, "coil_current", "A"), (position, left, right, "plunger_position", "m"))
        for values, least, most, name, unit in ranges:
            excess = np.maximum(least - values, values - most)
            share = float(np.mean(excess > BEYOND * (most - least)))
            if share > 0.0:
                lines.append(
                    f"force_map: {name} leaves the table in {100.0 * share:.2g} % of the samples, by up to "
                    f"{excess.max():.3g} {unit}: the force there is the table's edge and its slope."
                )
        return lines


def read_force_map(table: KnownFile) -> ForceMap:
    """A table of coil_current, plunger_position and magnetic_force (CSV; A, m, N).

    Points on a grid are interpolated by a bicubic spline; scattered ones by a thin plate first. A table that
    begins above 0 A gets the force without current, which is none. RigFileError when it cannot be read, or
    has too few points, or all on one line.
    """
    lines = table.text().splitlines()
    try:
        header = lines[0].split(",")
        places = [[name.strip() for name in header].index(name) for name in COLUMNS]
        i, x, force = np.loadtxt(lines, delimiter=",", skiprows=1, usecols=places, ndmin=2).T
    except (ValueError, IndexError) as error:
        wanted = ", ".join(COLUMNS)
        raise RigFileError(f"{table.source}: expected a table with the columns {wanted}: {error}") from error
    if len(force) < FEWEST or not np.all(np.isfinite([i, x, force])):
        raise RigFileError(f"{table.source}: expected {FEWEST} finite rows or more, found {len(force)}")
    if len(np.unique(i)) < 2 or len(np.unique(x)) < 2:
        raise RigFileError(
            f"{table.source}: expected forces at two currents and two positions or more, found "
            f"{len(np.unique(i))} and {len(np.unique(x))}"
        )
    grid = _grid(i, x, force)
    gridded = grid if grid is not None else _bring_to_grid(table.source, i, x, force)
    chart = chart_of(*gridded)
    errors = np.array([charted_force(*place, chart) for place in zip(i, x, strict=True)]) - force
    return ForceMap(
        gridded[0], gridded[1], chart, len(force), grid is not None,
        float(np.sqrt(np.mean(errors**2))), float(np.abs(errors).max()),
    )  # fmt: skip


def chart_of(current: FloatArray, position: FloatArray, force: FloatArray) -> Chart:
    """The bicubic spline through ``force`` (n, m) at ``current`` (n,) and ``position`` (m,)."""
    spline = _spline(current, position, force)
    i, x = _equal_nodes(current), _equal_nodes(position)
    h, w = i[1] - i[0], x[1] - x[0]
    # a polynomial of third degree in each direction is what its values and slopes at the corners make it
    f, f_x = _slope(spline, i, x, 0, 0), w * _slope(spline, i, x, 0, 1)
    f_i, f_ix = h * _slope(spline, i, x, 1, 0), h * w * _slope(spline, i, x, 1, 1)
    cells = np.empty((len(i) - 1, len(x) - 1, 4, 4))
    for m in range(len(i) - 1):
        for n in range(len(x) - 1):
            corners = np.s_[m : m + 2, n : n + 2]
            cells[m, n] = (
                HERMITE @ np.block([[f[corners], f_x[corners]], [f_i[corners], f_ix[corners]]]) @ HERMITE.T
            )
    return Chart(_axis(i), _axis(x), cells.ravel(), 1.0)


def _axis(edges: FloatArray) -> Axis:
    cells, low, high = len(edges) - 1, float(edges[0]), float(edges[-1])
    return Axis(low, high, cells, cells / (high - low))


def _equal_nodes(nodes: FloatArray) -> FloatArray:
    """Nodes at equal distances over these: the same where they are equal, else as close as the closest.

    Up to ``FINEST`` of them: between nodes that are no multiples apart the spline is met to the fourth order.
    """
    cells = int(np.ceil((nodes[-1] - nodes[0]) / np.diff(nodes).min() - 1e-6))
    return np.linspace(nodes[0], nodes[-1], min(cells, max(FINEST, len(nodes) - 1)) + 1)


def _spline(current: FloatArray, position: FloatArray, force: FloatArray) -> RectBivariateSpline:
    degrees = [min(3, len(nodes) - 1) for nodes in (current, position)]
    return RectBivariateSpline(current, position, force, kx=degrees[0], ky=degrees[1], s=0)


def _slope(spline: RectBivariateSpline, i: FloatArray, x: FloatArray, a: int, b: int) -> FloatArray:
    return np.asarray(spline(i, x, dx=a, dy=b), dtype=np.float64)


def _grid(
    i: FloatArray, x: FloatArray, force: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Nodes and forces (n, m) where the points stand on a grid, repeated ones averaged; else None."""
    current, row = np.unique(i, return_inverse=True)
    position, column = np.unique(x, return_inverse=True)
    count, total = (np.zeros((len(current), len(position))) for _ in range(2))
    np.add.at(count, (row, column), 1.0)
    np.add.at(total, (row, column), force)
    if not np.all(count):
        return None
    table = total / count
    if current[0] > 0.0:
        current, table = np.r_[0.0, current], np.vstack([np.zeros(len(position)), table])
    return current, position, table


def _bring_to_grid(
    source: str, i: FloatArray, x: FloatArray, force: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A thin plate through scattered points, on a grid over them."""
    current = np.linspace(min(i.min(), 0.0), i.max(), ACROSS)
    position = np.linspace(x.min(), x.max(), ACROSS)
    points, values = np.column_stack([i, x]), force
    if i.min() > 0.0:
        points = np.vstack([points, np.column_stack([np.zeros(ACROSS), position])])
        values = np.r_[force, np.zeros(ACROSS)]
    size = np.array([np.ptp(current), np.ptp(position)])
    points, row = np.unique(points, axis=0, return_inverse=True)
    values = np.bincount(row.ravel(), values) / np.bincount(row.ravel())
    nodes = np.stack(np.meshgrid(current, position, indexing="ij"), axis=-1).reshape(-1, 2)
    neighbours = NEIGHBOURS if len(values) > 20 * NEIGHBOURS else None
    try:
        plate = RBFInterpolator(points / size, values, neighbors=neighbours)
        forces = plate(nodes / size)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise RigFileError(f"{source}: expected points that span an area: {error}") from error
    return current, position, forces.reshape(ACROSS, ACROSS)
