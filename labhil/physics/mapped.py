"""A force tabulated over drive and position, interpolated by a bicubic spline in a kernel.

The spline is stored as one bicubic polynomial per cell. Outside the table it is extrapolated linearly with
the slope at the edge. ``physics.force_map`` reads such tables.
"""

from __future__ import annotations

from typing import NamedTuple

from labhil.compiled import compiled, inlined
from labhil.signals import FloatArray


class Axis(NamedTuple):
    """An axis of equal cells from ``low`` to ``high``, ``per_unit`` of them to a unit."""

    low: float
    high: float
    cells: int
    per_unit: float


class Chart(NamedTuple):
    """A force over drive and position: Σ C[a, b]·fᵃ·gᵇ in each cell, times ``scale``.

    f and g run from 0 to 1 across a cell; ``numbers`` (n·m·16,) are the coefficients of all cells.
    """

    u: Axis
    x: Axis
    numbers: FloatArray
    scale: float


@inlined
def row(b: float, at: int, c: FloatArray) -> float:
    """Σ c[at + n]·bⁿ of four coefficients."""
    return c[at] + b * (c[at + 1] + b * (c[at + 2] + b * c[at + 3]))


@inlined
def row_slope(b: float, at: int, c: FloatArray) -> float:
    """Derivative by b of :func:`row`."""
    return c[at + 1] + b * (2.0 * c[at + 2] + b * 3.0 * c[at + 3])


@inlined
def rise_at(a: float, b: float, k: int, c: FloatArray) -> float:
    """Derivative by position at ``a`` and ``b`` within the cell whose coefficients begin at ``k``."""
    inner = row_slope(b, k + 8, c) + a * row_slope(b, k + 12, c)
    return row_slope(b, k, c) + a * (row_slope(b, k + 4, c) + a * inner)


@inlined
def locate(u: float, x: float, c: Chart) -> tuple[float, float, int]:
    """Relative coordinates in the cell of (u, x), below 0 or above 1 outside, and its first coefficient."""
    a, b = (u - c.u.low) * c.u.per_unit, (x - c.x.low) * c.x.per_unit
    i, j = min(max(int(a), 0), c.u.cells - 1), min(max(int(b), 0), c.x.cells - 1)
    return a - i, b - j, 16 * (i * c.x.cells + j)


@inlined
def charted_force(u: float, x: float, c: Chart) -> float:
    """Interpolated force at drive ``u`` and position ``x``."""
    a, b, k = locate(u, x, c)
    n = c.numbers
    if a < 0.0 or a > 1.0 or b < 0.0 or b > 1.0:
        return beyond_edges(a, b, k, c)
    r0, r1, r2, r3 = row(b, k, n), row(b, k + 4, n), row(b, k + 8, n), row(b, k + 12, n)
    return c.scale * (r0 + a * (r1 + a * (r2 + a * r3)))


@compiled
def beyond_edges(a: float, b: float, k: int, c: Chart) -> float:
    """Force outside the table: linear extrapolation from the nearest edge."""
    f, g, n = min(max(a, 0.0), 1.0), min(max(b, 0.0), 1.0), c.numbers
    r0, r1, r2, r3 = row(g, k, n), row(g, k + 4, n), row(g, k + 8, n), row(g, k + 12, n)
    force = r0 + f * (r1 + f * (r2 + f * r3))
    force += (a - f) * (r1 + f * (2.0 * r2 + 3.0 * f * r3)) + (b - g) * rise_at(f, g, k, n)
    return c.scale * force


@compiled
def charted_slope(u: float, x: float, c: Chart) -> float:
    """Derivative of the force by position."""
    a, b, k = locate(u, x, c)
    f, g = min(max(a, 0.0), 1.0), min(max(b, 0.0), 1.0)
    return c.scale * c.x.per_unit * rise_at(f, g, k, c.numbers)
