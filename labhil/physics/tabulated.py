"""Simulation kernels of a coordinate whose acceleration is tabulated, for simulators that cannot be compiled.

The table is a cubic spline over position and a polynomial in velocity and input (``simulators.tables`` fills
it). The kernels are compiled once for all such simulators.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from labhil.compiled import compiled, inlined
from labhil.physics.at_port import compile_laws_at_port
from labhil.physics.extra_force import with_extra_force
from labhil.physics.moving_part import Motion, Stops
from labhil.physics.stick_slip import compile_integrator
from labhil.signals import FloatArray, IntArray


class Table(NamedTuple):
    """Acceleration over position, velocity and input, SI.

    Cell k begins at ``low`` + k/``per_unit``; outside the cells the acceleration is that at the end.
    ``cells`` (n, 4, i, j) holds for each cell the coefficients of the cubic (falling powers of the relative
    position in the cell), for each power of the input (minus ``u_mid``, over ``u_half``) and of the velocity
    (over ``v_half``). The input is clipped to ``u_low`` … ``u_high``.
    """

    low: float
    per_unit: float
    v_half: float
    u_mid: float
    u_half: float
    u_low: float
    u_high: float
    cells: FloatArray


@inlined
def _cubic(cells: FloatArray, k: int, i: int, j: int, s: float) -> float:
    """Coefficient (i, j) at the relative position ``s`` in cell ``k``."""
    return ((cells[k, 0, i, j] * s + cells[k, 1, i, j]) * s + cells[k, 2, i, j]) * s + cells[k, 3, i, j]


@inlined
def acceleration(x: float, v: float, u: float, table: Table) -> float:
    """Interpolate the acceleration."""
    cells = table.cells
    last, powers, orders = cells.shape[0], cells.shape[2], cells.shape[3]
    place = min(max((x - table.low) * table.per_unit, 0.0), float(last))
    if not np.isfinite(place):
        return np.nan
    k = min(int(place), last - 1)
    s, r = place - k, v / table.v_half
    w = (min(max(u, table.u_low), table.u_high) - table.u_mid) / table.u_half
    total = 0.0
    for i in range(powers - 1, -1, -1):
        row = 0.0
        for j in range(orders - 1, -1, -1):
            row = row * r + _cubic(cells, k, i, j, s)
        total = total * w + row
    return total


LAWS = compile_laws_at_port(acceleration)
_run = compile_integrator(LAWS)
_run_pushed = compile_integrator(with_extra_force(LAWS))
_pull = LAWS.acceleration


@compiled
def run(
    t: FloatArray, node_t: FloatArray, values: FloatArray, first: IntArray, last: IntArray,
    states: FloatArray, stops: Stops, part: Any, course: Any, out: FloatArray,
) -> None:  # fmt: skip
    """Simulate windows (see ``stick_slip.Run``); a part is (table, pushes)."""
    _run(t, node_t, values, first, last, states, stops, part, course, out)


@compiled
def run_pushed(
    t: FloatArray, node_t: FloatArray, values: FloatArray, first: IntArray, last: IntArray,
    states: FloatArray, stops: Stops, part: Any, course: Any, out: FloatArray,
) -> None:  # fmt: skip
    """Simulate windows under an additional force; a part is Pushed((table, pushes), force)."""
    _run_pushed(t, node_t, values, first, last, states, stops, part, course, out)


@compiled
def pulls(x: FloatArray, v: FloatArray, bend: FloatArray, u: FloatArray, part: Any) -> FloatArray:
    """Accelerations (n,) at positions, velocities, bends and inputs (n,); zero where the part is at rest."""
    accelerations = np.zeros(x.size)
    for k in range(x.size):
        if v[k] != 0.0:
            accelerations[k] = _pull(Motion(x[k], v[k], 0.0, bend[k]), np.sign(v[k]), u[k], part)
    return accelerations


@compiled
def look_up(x: float, v: float, u: float, table: Table) -> float:
    """Interpolate the acceleration, to be called from Python."""
    return acceleration(x, v, u, table)
