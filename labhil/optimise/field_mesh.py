"""Grids for the field solver: lines through all edges of the solenoid that follow the cone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labhil.optimise.geometry import Housing
from labhil.signals import FloatArray

BoolArray = NDArray[np.bool_]

FAR = 50e-3
"""Distance from the casing to where the field is taken as zero, m."""
FINEST = 0.3e-3
"""Cell beside an edge next to the gap, m, on the coarsest grid."""
COARSEST = 6e-3
GROWTH = 0.875
"""Growth of the cells per distance from the next edge."""


@dataclass(frozen=True, slots=True)
class Section:
    """A half plane (r, z) of quadrilaterals with their materials and currents."""

    r: FloatArray
    """(nr + 1, nz + 1): radii of the nodes, m."""
    z: FloatArray
    """(nr + 1, nz + 1): heights of the nodes, m."""
    steel: BoolArray
    """(nr, nz): cells of steel."""
    moving: BoolArray
    """(nr, nz): cells of the part whose force is computed."""
    current_density: FloatArray
    """(nr, nz): around the axis, A/m²."""
    closed: bool = True
    """Whether the field vanishes on the outer edges; else the flux lines cross them at right angles."""


def solenoid(design: FloatArray, x: float, current: float, housing: Housing, fineness: float) -> Section:
    """Make the grid of a solenoid.

    Args:
        design: Design (5,), m and rad.
        x: Position of the plunger, m.
        current: Coil current, A.
        housing: Fixed dimensions.
        fineness: Divisor of all cells; 1 is the coarsest grid that resolves the clearance.

    Returns:
        The section.
    """
    R, L1, L2, W, _ = design
    front = housing.residual_gap + housing.travel - x
    inside = R + housing.clearance
    outside = inside + housing.wall
    shell = outside + housing.window
    end = housing.behind + housing.flange
    start = -housing.ahead - housing.flange
    tail = front + housing.plunger_length
    r = graded(
        [0.0, housing.bore_radius, R, inside, outside, shell, shell + housing.casing, shell + FAR], fineness
    )
    z_edges = [start - FAR, start, -housing.ahead, 0.0, front, front + L2, L1, L1 + W, housing.behind, end]
    z = graded([*z_edges, tail, tail + FAR], fineness)
    rm, zm = np.meshgrid(0.5 * (r[1:] + r[:-1]), 0.5 * (z[1:] + z[:-1]), indexing="ij")
    plunger = (rm < R) & (zm > front) & (zm < tail) & ((rm > housing.bore_radius) | (zm > front + L2))
    pole = (rm < outside) & (zm > start) & (zm < 0.0)
    tube = (rm > inside) & (rm < outside) & (zm > 0.0) & (zm < end) & ((zm < L1) | (zm > L1 + W))
    flanges = (zm > start) & (zm < end) & ((zm < -housing.ahead) | (zm > housing.behind)) & (rm > outside)
    casing = (rm > shell) & (zm > start) & (zm < end)
    steel = plunger | pole | tube | ((flanges | casing) & (rm < shell + housing.casing))
    coil = (rm > outside) & (rm < shell) & (zm > -housing.ahead) & (zm < housing.behind)
    area = housing.window * (housing.ahead + housing.behind)
    density = np.where(coil, housing.turns * current / area, 0.0)
    return Section(*_bend(r, z, front, design, housing), steel, plunger, density)


def graded(edges: list[float], fineness: float) -> FloatArray:
    """Return ascending lines through all ``edges`` (m), dense next to them."""
    lines = []
    marks = np.unique(np.round(edges, 9))
    for low, high in pairwise(marks):
        s = np.linspace(low, high, 400)
        size = np.minimum(COARSEST, FINEST + GROWTH * np.minimum(s - low, high - s))
        if low == marks[0] or high == marks[-1]:  # towards the axis or the far edge nothing is narrow
            near = high if low == marks[0] else low
            size = FINEST + GROWTH * np.abs(s - near)
        count = np.concatenate([[0.0], np.cumsum(0.5 * (1 / size[1:] + 1 / size[:-1]) * np.diff(s))])
        cells = max(2, int(np.ceil(fineness * count[-1])))
        lines.append(np.interp(np.arange(cells) * count[-1] / cells, count, s))
    return np.concatenate([*lines, [marks[-1]]])


def _bend(
    r: FloatArray, z: FloatArray, front: float, design: FloatArray, housing: Housing
) -> tuple[FloatArray, FloatArray]:
    """Return the nodes, moved inwards so that the line r = R follows the cone."""
    R, L2 = design[0], design[2]
    narrowing = np.interp(z, [0.0, front, front + L2], [0.0, L2 * np.tan(design[4]), 0.0])
    share = np.interp(r, [housing.bore_radius, R, R + housing.clearance], [0.0, 1.0, 0.0])
    return r[:, None] - share[:, None] * narrowing[None, :], np.broadcast_to(z, (len(r), len(z))).copy()
