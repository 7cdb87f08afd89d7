"""The solenoid as a magnetic equivalent circuit that saturates, solved in milliseconds per force curve.

Cells in columns that run along the axis, joined by reluctances along it and across::

    bored core of the plunger | rings of its rim | clearance | rings of the wall | air | casing

Each reluctance is steel that follows its curve, air, or both in series. The coil drives the loops between
the columns ``air`` and ``casing``. The circuit so includes oblique flux from the gap into the collar,
saturated corners of nose and collar, and leakage through ring and winding, without formulas for fringing. It
does not include that steel saturates by the magnitude of a field that turns: at corners its forces are
somewhat too high (:mod:`labhil.optimise.field` shows how much).

The fluxes ψ of the loops (Wb) minimise the convex function Σ w(Φ) − Σ drive·ψ, w being a branch's energy
∫ u dΦ; Newton's method with a line search finds them. Minus the minimum is the coenergy W', and the force
is dW'/dx at constant current. Cells move with the plunger, and x moves by exactly one of their heights per
step, so that no edge of the tube crosses a border of cells in between, and differences of W' have no noise
from the discretisation.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from math import log, pi, sqrt, tan
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.cores import cores
from labhil.errors import RunError
from labhil.optimise.geometry import HOUSING, Housing, check_designs
from labhil.optimise.steel import FREE_CUTTING, MU0, Steel, magnetisation
from labhil.signals import FloatArray

PITCH = 0.5e-3
"""Height of the cells near the gap, and distance of the positions of a force curve, m."""

RIMS, WALLS = 3, 2
CLEARANCE = RIMS + 1
FIRST_WALL = RIMS + 2
AIR = FIRST_WALL + WALLS
CASING = AIR + 1
COLUMNS = CASING + 1
AIR_THICKNESS = 2e-3
"""Thickness of the air column next to the wall, m, for the leakage along the axis."""

FINE_AHEAD, FINE_BEHIND, COARSE, FEATURES = 13, 21, 5, 6
CELLS = FINE_AHEAD + FINE_BEHIND + 2 * COARSE + FEATURES
LOOPS = COLUMNS - 1
MIN_HEIGHT = 1e-8
"""Least height of a cell between two equal borders, m, so that the circuit is regular."""
ALONG, ACROSS = 0, 1

TOLERANCE = 1e-11
"""Relative change of the coenergy at which Newton's method ends."""
MAX_STEPS = 100
MIN_LINE_SEARCH_STEP = 1e-9


class Network(NamedTuple):
    """Branches as (2, cells, columns): along the axis to the next cell, and across to the next column."""

    metal: FloatArray
    """Way through steel, m."""
    air: FloatArray
    """Way through everything else, m."""
    section: FloatArray
    """m²."""
    drive: FloatArray
    """(cells − 1,): current that the outermost loops enclose, A."""


def positions(housing: Housing = HOUSING) -> FloatArray:
    """Return the positions (m,) of the plunger, m, from 0 to the whole travel."""
    return np.asarray(PITCH * np.arange(round(housing.travel / PITCH) + 1), dtype=np.float64)


def force_curves(
    designs: FloatArray,
    *,
    current: float | None = None,
    housing: Housing = HOUSING,
    steel: Steel = FREE_CUTTING,
) -> FloatArray:
    """Compute the force on the plunger towards the pole piece along its travel; batches use all cores.

    Args:
        designs: Designs (n, 5), m and rad.
        current: Coil current, A, not 0; that of the housing when absent.
        housing: Fixed dimensions.
        steel: Magnetisation curve.

    Returns:
        Forces (n, m), N, at :func:`positions`; each is the mean over one pitch around its position.

    Raises:
        UsageError: A design is far outside of Table A.2's bounds.
        RunError: Newton's method does not converge.
    """
    table = check_designs(designs)
    mmf = housing.turns * (housing.current if current is None else current)
    energies = np.empty((len(table), len(positions(housing)) + 1))
    parts = np.array_split(np.arange(len(table)), min(cores(), max(1, len(table) // 4)))
    with ThreadPoolExecutor(len(parts)) as threads:
        runs = [
            threads.submit(_coenergies, table[part], mmf, housing, steel, energies[part[0] : part[-1] + 1])
            for part in parts
            if len(part)
        ]
    if not all(run.result() for run in runs):
        raise RunError("magnetic circuit: expected Newton's method to lower the energy, it did not")
    return np.asarray(np.diff(energies, axis=1) / PITCH)


@compiled
def _coenergies(designs: FloatArray, mmf: float, housing: Housing, steel: Steel, out: FloatArray) -> bool:
    """Write W' (n, m) in J at x = −½, ½, 1½, … pitches; return whether all solutions converged."""
    z = np.empty(CELLS + 1)
    network = Network(
        np.zeros((2, CELLS, COLUMNS)),
        np.zeros((2, CELLS, COLUMNS)),
        np.ones((2, CELLS, COLUMNS)),
        np.zeros(CELLS - 1),
    )
    psi = np.zeros((CELLS - 1, LOOPS))
    psi_before = np.zeros((CELLS - 1, LOOPS))
    gradient = np.zeros((CELLS - 1, LOOPS))
    step = np.zeros((CELLS - 1, LOOPS))
    band = np.zeros((CELLS - 1, LOOPS, LOOPS + 1))
    all_converged = True
    for n in range(designs.shape[0]):
        psi[:] = 0.0
        for j in range(out.shape[1]):
            front = housing.residual_gap + housing.travel - (j - 0.5) * PITCH
            _set_borders(front, designs[n], housing, z)
            for i in range(CELLS):
                _branches_of_cell(i, front, designs[n], housing, z, network)
            _set_drives(mmf, housing, z, network.drive)
            out[n, j], converged = _solve(network, steel, psi, psi_before, gradient, step, band)
            all_converged = all_converged and converged
    return all_converged


@compiled
def _set_borders(front: float, design: FloatArray, housing: Housing, z: FloatArray) -> None:
    """Write ascending borders z (cells + 1,): fine ones around the front, coarse ones, and all edges."""
    first, last = front - FINE_AHEAD * PITCH, front + FINE_BEHIND * PITCH
    n = 0
    for k in range(COARSE):
        z[n] = -housing.ahead + (first + housing.ahead) * k / COARSE
        n += 1
    for k in range(-FINE_AHEAD, FINE_BEHIND + 1):
        z[n] = front + k * PITCH
        n += 1
    for k in range(COARSE):
        z[n] = last + (housing.behind - last) * (k + 1) / COARSE
        n += 1
    z[n], z[n + 1], z[n + 2] = 0.0, design[1], design[1] + design[3]
    z[n + 3] = front + design[2]
    z[n + 4], z[n + 5] = -housing.ahead - housing.flange, housing.behind + housing.flange
    z.sort()


@compiled
def _set_drives(mmf: float, housing: Housing, z: FloatArray, drive: FloatArray) -> None:
    """Write the magnetomotive force of the coil between the middles of neighbouring cells, A."""
    for i in range(CELLS - 1):
        top = min(0.5 * (z[i + 1] + z[i + 2]), housing.behind)
        bottom = max(0.5 * (z[i] + z[i + 1]), -housing.ahead)
        drive[i] = mmf * (top - bottom) / (housing.ahead + housing.behind)


@compiled
def _cell_ring(
    column: int, middle: float, front: float, design: FloatArray, housing: Housing
) -> tuple[float, float, bool]:
    """Return inner and outer radius (m) of a column at height ``middle``, and whether it is steel there."""
    inside = design[0] + housing.clearance
    outside = inside + housing.wall
    if column == CASING:
        return outside + housing.window, outside + housing.window + housing.casing, True
    if column == AIR:
        flange = middle < -housing.ahead or middle > housing.behind
        return outside, outside + (housing.window if flange else AIR_THICKNESS), flange
    if column >= FIRST_WALL:
        width = housing.wall / WALLS
        inner = inside + (column - FIRST_WALL) * width
        return inner, inner + width, middle < design[1] or middle > design[1] + design[3]
    nose_end = front + design[2]
    bored = 0.0 < middle < nose_end
    if column == 0:
        return 0.0, housing.bore_radius, not bored
    # The column of the rim keeps the nose's radius in the gap, so that its cells face the nose.
    depth = min(max(nose_end - middle, 0.0), design[2]) if bored else 0.0
    radius = design[0] - depth * tan(design[4])
    if column == CLEARANCE:
        return radius, inside, middle < 0.0
    rim = radius - housing.bore_radius
    inner = radius - rim * (1.0 - (column - 1) / RIMS) ** 2
    return inner, radius - rim * (1.0 - column / RIMS) ** 2, middle < 0.0 or middle > front


@compiled
def _branches_of_cell(
    i: int, front: float, design: FloatArray, housing: Housing, z: FloatArray, network: Network
) -> None:
    """Write the branches from cell i of every column to the next cell and to the next column."""
    middle, height = 0.5 * (z[i] + z[i + 1]), max(z[i + 1] - z[i], MIN_HEIGHT)
    for k in range(COLUMNS):
        inner, outer, steel = _cell_ring(k, middle, front, design, housing)
        if i < CELLS - 1:
            next_middle, height2 = 0.5 * (z[i + 1] + z[i + 2]), max(z[i + 2] - z[i + 1], MIN_HEIGHT)
            inner2, outer2, steel2 = _cell_ring(k, next_middle, front, design, housing)
            area, area2 = pi * (outer**2 - inner**2), pi * (outer2**2 - inner2**2)
            section = min(area, area2)
            if steel != steel2:
                section = area if steel else area2
            _set_branch(
                network,
                ALONG,
                i,
                k,
                0.5 * height * section / area,
                steel,
                0.5 * height2 * section / area2,
                steel2,
            )
            network.section[ALONG, i, k] = section
        if k < COLUMNS - 1:
            inner2, outer2, steel2 = _cell_ring(k + 1, middle, front, design, housing)
            radius = 0.5 * (outer + inner2)
            length = radius * log(2.0 * outer / (inner + outer))
            length2 = radius * log((inner2 + outer2) / (2.0 * inner2))
            _set_branch(network, ACROSS, i, k, length, steel, length2, steel2)
            if inner2 > outer * (1.0 + 1e-9):
                network.air[ACROSS, i, k] += radius * log(inner2 / outer)
            network.section[ACROSS, i, k] = 2.0 * pi * radius * height


@compiled
def _set_branch(
    network: Network, side: int, i: int, k: int, length: float, steel: bool, length2: float, steel2: bool
) -> None:
    """Write the lengths of steel and air of a branch in its two cells."""
    network.metal[side, i, k] = (length if steel else 0.0) + (length2 if steel2 else 0.0)
    network.air[side, i, k] = (0.0 if steel else length) + (0.0 if steel2 else length2)


@compiled
def _solve(
    network: Network,
    steel: Steel,
    psi: FloatArray,
    psi_before: FloatArray,
    gradient: FloatArray,
    step: FloatArray,
    band: FloatArray,
) -> tuple[float, bool]:
    """Solve for the fluxes of the loops, from a start in ``psi``; return coenergy (J) and convergence.

    The other arrays are work arrays.
    """
    energy = _linearise(network, steel, psi, gradient, band)
    for _ in range(MAX_STEPS):
        step[:] = gradient
        decrement = _newton_step(band, step)
        if decrement <= TOLERANCE * abs(energy):
            return -energy, True
        psi_before[:] = psi
        share = 1.0
        while True:
            psi[:] = psi_before - share * step
            trial_energy = _linearise(network, steel, psi, gradient, band)
            if trial_energy <= energy - 1e-3 * share * decrement:
                break
            share *= 0.5
            if share < MIN_LINE_SEARCH_STEP:
                return -energy, False
        energy = trial_energy
    return -energy, False


@compiled
def _linearise(
    network: Network, steel: Steel, psi: FloatArray, gradient: FloatArray, band: FloatArray
) -> float:
    """Return the energy (J) that the fluxes minimise; write its gradient (A) and Hessian (A/Wb).

    ``band[i, k, d]`` couples loop (i, k) to the one d places before it in row-major order.
    """
    n, m = psi.shape
    gradient[:] = 0.0
    band[:] = 0.0
    energy = 0.0
    for i in range(n):
        gradient[i, m - 1] = -network.drive[i]
        energy -= network.drive[i] * psi[i, m - 1]
        for k in range(COLUMNS):
            flux = (psi[i, k - 1] if k > 0 else 0.0) - (psi[i, k] if k < m else 0.0)
            u, slope, w = _branch(flux, network, ALONG, i, k, steel)
            energy += w
            if k > 0:
                gradient[i, k - 1] += u
                band[i, k - 1, 0] += slope
            if k < m:
                gradient[i, k] -= u
                band[i, k, 0] += slope
                if k > 0:
                    band[i, k, 1] -= slope
    for i in range(n + 1):
        for k in range(m):
            flux = (psi[i, k] if i < n else 0.0) - (psi[i - 1, k] if i > 0 else 0.0)
            u, slope, w = _branch(flux, network, ACROSS, i, k, steel)
            energy += w
            if i < n:
                gradient[i, k] += u
                band[i, k, 0] += slope
                band[i, k, m] -= slope
            if i > 0:
                gradient[i - 1, k] -= u
                band[i - 1, k, 0] += slope
    return energy


@compiled
def _branch(
    flux: float, network: Network, side: int, i: int, k: int, steel: Steel
) -> tuple[float, float, float]:
    """Return magnetic voltage u (A) of a branch at ``flux`` (Wb), du/dΦ (A/Wb) and energy ∫ u dΦ (J)."""
    section = network.section[side, i, k]
    B = flux / section
    u = network.air[side, i, k] * B / MU0
    slope = network.air[side, i, k] / MU0
    density = 0.5 * u * B
    metal = network.metal[side, i, k]
    if metal > 0.0:
        h, stiffness, stored = magnetisation(abs(B), steel)
        u += metal * h if B > 0.0 else -metal * h
        slope += metal * stiffness
        density += metal * stored
    return u, slope / section, density * section


@compiled
def _newton_step(matrix: FloatArray, right: FloatArray) -> float:
    """Replace the gradient g in ``right`` by H⁻¹·g (banded Cholesky); return g·H⁻¹·g."""
    size, width = matrix.shape[0] * matrix.shape[1], matrix.shape[2]
    band, g = matrix.reshape(size, width), right.reshape(size)
    decrement = 0.0
    for n in range(size):
        first = max(0, n - width + 1)
        for m in range(first, n + 1):
            total = band[n, n - m]
            for p in range(first, m):
                total -= band[n, n - p] * band[m, m - p]
            band[n, n - m] = total / band[m, 0] if m < n else sqrt(total)
        value = g[n]
        for p in range(first, n):
            value -= band[n, n - p] * g[p]
        g[n] = value / band[n, 0]
        decrement += g[n] * g[n]
    for n in range(size - 1, -1, -1):
        value = g[n]
        for p in range(n + 1, min(size, n + width)):
            value -= band[p, p - n] * g[p]
        g[n] = value / band[n, 0]
    return decrement
