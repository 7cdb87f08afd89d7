"""Measured magnetic forces: reads a table of current, position and force, and fits a bicubic spline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator, RectBivariateSpline

from labhil.errors import RigFileError
from labhil.physics.mapped import Axis, Chart, charted_force
from labhil.rig import KnownFile
from labhil.signals import FloatArray

COLUMNS = ("coil_current", "plunger_position", "magnetic_force")

GRID_NODES = 33
"""Nodes in each direction of the grid for scattered points; the error of it is stated in the notes."""

HERMITE = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [-3, 3, -2, -1], [2, -2, 1, 1]], dtype=np.float64)
"""Coefficients of a cubic on 0 … 1 from its values and slopes at both ends."""


@dataclass(frozen=True, slots=True)
class ForceMap:
    """The spline through a table of forces.

    Attributes:
        current: Grid of currents, (n,), A.
        position: Grid of positions, (m,), m.
        chart: The spline.
        points: Number of points in the table.
        gridded: Whether these are on a grid.
        rms: RMS difference between spline and points, N; zero but for rounding on a grid.
        worst: Largest difference between spline and points, N.
    """

    current: FloatArray
    position: FloatArray
    chart: Chart
    points: int
    gridded: bool
    rms: float
    worst: float

    def over(self, mass: float) -> Chart:
        """The spline divided by the moving mass, as a kernel takes it."""
        return self.chart._replace(scale=1.0 / mass)

    def notes(self, current: FloatArray, position: FloatArray, *, edge_tolerance: float = 0.01) -> list[str]:
        """Notes for the user on the table, and on samples of a recording outside it.

        Args:
            current: Currents of the recording, (n,), A.
            position: Positions of the recording, (n,), m.
            edge_tolerance: Share of the table's range by which noise may exceed it without a note.

        Returns:
            One line each.
        """
        low, high, left, right = self.current[0], self.current[-1], self.position[0], self.position[-1]
        how = (
            f"on a grid of {len(self.current)} × {len(self.position)}"
            if self.gridded
            else f"on no grid, brought to one of {GRID_NODES} × {GRID_NODES}"
        )
        lines = [
            f"force_map: {self.points} points {how}; the bicubic spline is off them by {self.rms:.2g} N "
            f"(RMS), at most {self.worst:.2g} N. Beyond {low:.4g} to {high:.4g} A and "
            f"{left:.4g} to {right:.4g} m it goes on straight."
        ]
        ranges = ((current, low, high, "coil_current", "A"), (position, left, right, "plunger_position", "m"))
        for values, least, most, name, unit in ranges:
            excess = np.maximum(least - values, values - most)
            share = float(np.mean(excess > edge_tolerance * (most - least)))
            if share > 0.0:
                lines.append(
                    f"force_map: {name} leaves the table in {100.0 * share:.2g} % of the samples, by up to "
                    f"{excess.max():.3g} {unit}: the force there is the table's edge and its slope."
                )
        return lines


def read_force_map(table: KnownFile, *, min_points: int = 6) -> ForceMap:
    """Read a table of coil_current, plunger_position and magnetic_force (CSV; A, m, N).

    Points on a grid are interpolated by a bicubic spline; scattered ones by a thin-plate spline first. A
    table that starts above 0 A is extended by zero force at 0 A.

    Args:
        table: The table.
        min_points: Least number of points: a plane and its curvature.

    Returns:
        The force map.

    Raises:
        RigFileError: The table cannot be read, has too few points, or all of them are on one line.
    """
    lines = table.text().splitlines()
    try:
        header = lines[0].split(",")
        places = [[name.strip() for name in header].index(name) for name in COLUMNS]
        i, x, force = np.loadtxt(lines, delimiter=",", skiprows=1, usecols=places, ndmin=2).T
    except (ValueError, IndexError) as error:
        wanted = ", ".join(COLUMNS)
        raise RigFileError(f"{table.source}: expected a table with the columns {wanted}: {error}") from error
    if len(force) < min_points or not np.all(np.isfinite([i, x, force])):
        raise RigFileError(f"{table.source}: expected {min_points} finite rows or more, found {len(force)}")
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
    """Fit a bicubic spline through ``force`` (n, m) at ``current`` (n,) and ``position`` (m,); N, A, m."""
    spline = _spline(current, position, force)
    i, x = _equal_nodes(current), _equal_nodes(position)
    h, w = i[1] - i[0], x[1] - x[0]
    # values and slopes at its corners determine a bicubic polynomial
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
    """Axis of equal cells."""
    cells, low, high = len(edges) - 1, float(edges[0]), float(edges[-1])
    return Axis(low, high, cells, cells / (high - low))


def _equal_nodes(nodes: FloatArray, *, max_cells: int = 100) -> FloatArray:
    """Equally spaced nodes over the same range, as close as the closest two of ``nodes``.

    At most ``max_cells`` (cells of 1.3 MB) if the spacing is unequal; the spline then has a fourth-order
    error.
    """
    cells = int(np.ceil((nodes[-1] - nodes[0]) / np.diff(nodes).min() - 1e-6))
    return np.linspace(nodes[0], nodes[-1], min(cells, max(max_cells, len(nodes) - 1)) + 1)


def _spline(current: FloatArray, position: FloatArray, force: FloatArray) -> RectBivariateSpline:
    """Interpolating spline, cubic where there are enough nodes."""
    degrees = [min(3, len(nodes) - 1) for nodes in (current, position)]
    return RectBivariateSpline(current, position, force, kx=degrees[0], ky=degrees[1], s=0)


def _slope(spline: RectBivariateSpline, i: FloatArray, x: FloatArray, a: int, b: int) -> FloatArray:
    """Derivative of order a by current and b by position on a grid."""
    return np.asarray(spline(i, x, dx=a, dy=b), dtype=np.float64)


def _grid(
    i: FloatArray, x: FloatArray, force: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Nodes and forces (n, m) if the points are on a grid, repeated ones averaged; else None."""
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
    source: str, i: FloatArray, x: FloatArray, force: FloatArray, *, neighbours: int = 64
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Thin-plate spline through scattered points, evaluated on a grid.

    Each node uses that many nearest ``neighbours`` where there are more than 20 times as many points, for
    speed.
    """
    current = np.linspace(min(i.min(), 0.0), i.max(), GRID_NODES)
    position = np.linspace(x.min(), x.max(), GRID_NODES)
    points, values = np.column_stack([i, x]), force
    if i.min() > 0.0:
        points = np.vstack([points, np.column_stack([np.zeros(GRID_NODES), position])])
        values = np.r_[force, np.zeros(GRID_NODES)]
    size = np.array([np.ptp(current), np.ptp(position)])
    points, row = np.unique(points, axis=0, return_inverse=True)
    values = np.bincount(row.ravel(), values) / np.bincount(row.ravel())
    nodes = np.stack(np.meshgrid(current, position, indexing="ij"), axis=-1).reshape(-1, 2)
    nearest = neighbours if len(values) > 20 * neighbours else None
    try:
        plate = RBFInterpolator(points / size, values, neighbors=nearest)
        forces = plate(nodes / size)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise RigFileError(f"{source}: expected points that span an area: {error}") from error
    return current, position, forces.reshape(GRID_NODES, GRID_NODES)
