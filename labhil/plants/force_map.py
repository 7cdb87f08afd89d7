"""Interpolate the measured forces of a magnet.

Between its points the force is the tensor product of cubic splines through them; beyond its edges it goes on
straight, with the slope that it has there. The spline is kept as its knots and coefficients, as FITPACK makes
them, in one array of fixed length, so that a kernel is compiled once for all tables.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labhil.compiled import compiled
from labhil.errors import UsageError
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import RectBivariateSpline

COLUMNS = ("coil_current", "plunger_position", "magnetic_force")

MAX_NODES = 100
"""Most nodes in a direction; a finer table is interpolated to as many at equal distances."""

PLATE_NODES = 33
"""Nodes in each direction of the grid for scattered points."""

MIN_POINTS = 6
"""Fewest points: those of a plane with curvature."""

NEIGHBOURS = 64
"""Number of points that determine the force of a node, where there are more than 20 times as many."""

DEGREE_I, DEGREE_X, KNOTS_I, KNOTS_X = 0, 1, 2, 3
FIRST_KNOT_I = 4
FIRST_KNOT_X = FIRST_KNOT_I + MAX_NODES + 4
FIRST_COEFFICIENT = FIRST_KNOT_X + MAX_NODES + 4
LENGTH = FIRST_COEFFICIENT + MAX_NODES * MAX_NODES
"""Indices in the array: degrees, numbers of knots (0: no table), knots, and coefficients, row by row."""


def no_table() -> FloatArray:
    """Return the array of a magnet without a table, (LENGTH,)."""
    return np.zeros(LENGTH)


def force_map_of(path: Path) -> FloatArray:
    """Fit a spline to the forces in a CSV file.

    Scattered points are interpolated to a grid by a thin plate spline; a table that starts above 0 A gets the
    force 0 without current.

    Args:
        path: The file, with columns coil_current (A), plunger_position (m) and magnetic_force (N).

    Returns:
        The spline, (LENGTH,).

    Raises:
        UsageError: The file cannot be read, or its points do not span an area.
    """
    try:
        header = [name.strip() for name in path.read_text(encoding="utf-8-sig").split("\n", 1)[0].split(",")]
        places = [header.index(name) for name in COLUMNS]
        i, x, force = np.loadtxt(path, delimiter=",", skiprows=1, usecols=places, ndmin=2).T
    except (OSError, ValueError) as error:
        expected = ", ".join(COLUMNS)
        raise UsageError(f"{path}: expected a CSV file with the columns {expected}: {error}") from error
    is_valid = len(force) >= MIN_POINTS and bool(np.all(np.isfinite([i, x, force])))
    if not is_valid or len(np.unique(i)) < 2 or len(np.unique(x)) < 2:
        raise UsageError(
            f"{path}: expected finite forces at {MIN_POINTS} points at least, of two currents and two "
            f"positions or more; found {len(force)} rows that are not"
        )
    if i.min() > 0.0:
        edge = np.unique(x)
        i, x, force = (np.r_[a, b] for a, b in ((i, 0.0 * edge), (x, edge), (force, 0.0 * edge)))
    nodes = _to_grid(i, x, force)
    try:
        current, position, table = nodes if nodes is not None else _interpolate_plate(i, x, force)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise UsageError(f"{path}: expected points at least that span an area: {error}") from error
    return _pack(current, position, table)


def _to_grid(
    i: FloatArray, x: FloatArray, force: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return nodes (n,) and (m,) with the mean force (n, m); None where a node has no point."""
    current, position = np.unique(i), np.unique(x)
    index = np.searchsorted(current, i) * len(position) + np.searchsorted(position, x)
    count = np.bincount(index, minlength=len(current) * len(position))
    if np.any(count == 0):
        return None
    total = np.bincount(index, force, minlength=len(count))
    return current, position, (total / count).reshape(len(current), len(position))


def _interpolate_plate(
    i: FloatArray, x: FloatArray, force: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Interpolate scattered points by a thin plate spline at the nodes of a grid."""
    from scipy.interpolate import RBFInterpolator

    size = np.array([np.ptp(i), np.ptp(x)])
    points, same = np.unique(np.column_stack([i, x]), axis=0, return_inverse=True)
    values = np.bincount(same.ravel(), force) / np.bincount(same.ravel())
    current, position = np.linspace(i.min(), i.max(), PLATE_NODES), np.linspace(x.min(), x.max(), PLATE_NODES)
    nodes = np.array(
        [(current_node, position_node) for current_node in current for position_node in position]
    )
    neighbours = NEIGHBOURS if len(values) > 20 * NEIGHBOURS else None
    plate = RBFInterpolator(points / size, values, neighbors=neighbours)
    return current, position, plate(nodes / size).reshape(PLATE_NODES, PLATE_NODES)


def _pack(current: FloatArray, position: FloatArray, table: FloatArray) -> FloatArray:
    if max(table.shape) > MAX_NODES:
        spline = _spline(current, position, table)
        current, position = (np.linspace(a[0], a[-1], min(len(a), MAX_NODES)) for a in (current, position))
        table = spline(current, position)
    spline = _spline(current, position, table)
    knots_i, knots_x, coefficients = spline.tck
    packed = no_table()
    packed[:FIRST_KNOT_I] = *spline.degrees, len(knots_i), len(knots_x)
    packed[FIRST_KNOT_I : FIRST_KNOT_I + len(knots_i)] = knots_i
    packed[FIRST_KNOT_X : FIRST_KNOT_X + len(knots_x)] = knots_x
    packed[FIRST_COEFFICIENT : FIRST_COEFFICIENT + len(coefficients)] = coefficients
    return packed


def _spline(current: FloatArray, position: FloatArray, table: FloatArray) -> RectBivariateSpline:
    from scipy.interpolate import RectBivariateSpline

    degree_i, degree_x = (min(3, n - 1) for n in table.shape)
    return RectBivariateSpline(current, position, table, kx=degree_i, ky=degree_x, s=0)


Four = tuple[float, float, float, float]


@compiled
def _find_interval(value: float, first: int, knots: int, degree: int, s: FloatArray) -> int:
    """Return the index of the knot on the left of a value."""
    low, high = degree, knots - degree - 1
    while high - low > 1:
        middle = (low + high) // 2
        if value < s[first + middle]:
            high = middle
        else:
            low = middle
    return low


@compiled
def _basis(value: float, first: int, interval: int, degree: int, s: FloatArray) -> Four:
    """Evaluate the B-splines of a degree that are not zero in the interval (de Boor's recursion)."""
    a, b, c, d = 1.0, 0.0, 0.0, 0.0
    for k in range(1, degree + 1):
        new = (0.0, 0.0, 0.0, 0.0)
        old = (a, b, c, d)
        w, x, y, z = new
        for r in range(k):
            low, high = s[first + interval + 1 + r - k], s[first + interval + 1 + r]
            quotient = old[r] / (high - low) if high > low else 0.0
            falling, rising = quotient * (high - value), quotient * (value - low)
            if r == 0:
                w, x = w + falling, x + rising
            elif r == 1:
                x, y = x + falling, y + rising
            else:
                y, z = y + falling, z + rising
        a, b, c, d = w, x, y, z
    return a, b, c, d


@compiled
def _basis_slopes(value: float, first: int, interval: int, degree: int, s: FloatArray) -> Four:
    """Evaluate the slopes of these B-splines."""
    p, q, r, _ = _basis(value, first, interval, degree - 1, s)
    lower = (p, q, r)
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for k in range(degree):
        width = s[first + interval + 1 + k] - s[first + interval + 1 + k - degree]
        quotient = degree * lower[k] / width if width > 0.0 else 0.0
        if k == 0:
            a, b = a - quotient, b + quotient
        elif k == 1:
            b, c = b - quotient, c + quotient
        else:
            c, d = c - quotient, d + quotient
    return a, b, c, d


@compiled
def _evaluate(
    by_i: Four, by_x: Four, interval_i: int, interval_x: int,
    s: FloatArray,
) -> float:  # fmt: skip
    degree_i, degree_x = int(s[DEGREE_I]), int(s[DEGREE_X])
    width, total = int(s[KNOTS_X]) - degree_x - 1, 0.0
    for m in range(degree_i + 1):
        row = FIRST_COEFFICIENT + (interval_i - degree_i + m) * width + interval_x - degree_x
        inner = 0.0
        for n in range(degree_x + 1):
            inner += by_x[n] * s[row + n]
        total += by_i[m] * inner
    return total


@compiled
def mapped_force(i: float, x: float, s: FloatArray) -> tuple[float, float]:
    """Return force (N) and ∂F/∂i (N/A) at a field current (A) and a position (m)."""
    degree_i, degree_x = int(s[DEGREE_I]), int(s[DEGREE_X])
    low_i, high_i = s[FIRST_KNOT_I + degree_i], s[FIRST_KNOT_I + int(s[KNOTS_I]) - degree_i - 1]
    low_x, high_x = s[FIRST_KNOT_X + degree_x], s[FIRST_KNOT_X + int(s[KNOTS_X]) - degree_x - 1]
    clipped_i, clipped_x = min(max(i, low_i), high_i), min(max(x, low_x), high_x)
    interval_i = _find_interval(clipped_i, FIRST_KNOT_I, int(s[KNOTS_I]), degree_i, s)
    interval_x = _find_interval(clipped_x, FIRST_KNOT_X, int(s[KNOTS_X]), degree_x, s)
    by_i, by_x = (
        _basis(clipped_i, FIRST_KNOT_I, interval_i, degree_i, s),
        _basis(clipped_x, FIRST_KNOT_X, interval_x, degree_x, s),
    )
    per_current = _evaluate(
        _basis_slopes(clipped_i, FIRST_KNOT_I, interval_i, degree_i, s), by_x, interval_i, interval_x, s
    )
    force = _evaluate(by_i, by_x, interval_i, interval_x, s) + (i - clipped_i) * per_current
    if x != clipped_x:
        force += (x - clipped_x) * _evaluate(
            by_i, _basis_slopes(clipped_x, FIRST_KNOT_X, interval_x, degree_x, s), interval_i, interval_x, s
        )
    return force, per_current
