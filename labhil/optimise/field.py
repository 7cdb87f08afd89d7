"""Check of the circuit by a field solver: axisymmetric magnetostatics by finite elements (scikit-fem).

With the azimuthal vector potential A the field is B = (−∂A/∂z, ∂A/∂r + A/r); it makes

    ∫ (w(|B|) − J·A) 2πr dr dz,   w = ∫ H dB,

stationary, with A = 0 on the axis and far away. Newton's method with a line search; quadratic elements on
quadrilaterals whose lines follow every edge of :mod:`labhil.optimise.geometry`, the cone included. The
force is that of virtual work: Maxwell's stress against the gradient of a harmonic function that is 1 on
the plunger and 0 on all other steel, which is smoother than the stress on any one surface.

It shares the dimensions and the steel with the equivalent circuit, and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np

from labhil.errors import RunError
from labhil.extras import load_optional
from labhil.optimise.field_mesh import Section, solenoid
from labhil.optimise.geometry import HOUSING, Housing, check_designs
from labhil.optimise.steel import FREE_CUTTING, MU0, Steel, magnetisation_all
from labhil.signals import FloatArray

MAX_STEPS = 60
TOLERANCE = 1e-10
"""Relative change of the energy at which Newton's method ends."""
VANISHING = 1e-9
"""Flux density, T, below which the steel is linear."""
FINENESS = 1.0
"""Refinement of the grid of :func:`solve_solenoid`; three times as fine changes forces by 0.1 to 0.3 %."""


def load_skfem() -> ModuleType:
    """Import the field solver; MissingExtraError when it is not installed."""
    module: ModuleType = load_optional("skfem", "the check against a field solver")
    return module


@dataclass(frozen=True, slots=True)
class Solution:
    """Solution of the field problem."""

    coenergy: float
    """J, of the whole section turned around the axis."""
    force: float
    """N, along +z, on the moving part."""
    flux_density: FloatArray
    """(2, cells): radial and axial component at the middle of the cells, T."""
    unknowns: int
    steps: int


def solve_solenoid(
    design: FloatArray,
    x: float,
    current: float,
    *,
    housing: Housing = HOUSING,
    steel: Steel = FREE_CUTTING,
    fineness: float = FINENESS,
) -> Solution:
    """Solve for the field of a solenoid.

    Args:
        design: Design (5,), m and rad.
        x: Position of the plunger, m.
        current: Coil current, A.
        housing: Fixed dimensions.
        steel: Magnetisation curve.
        fineness: Refinement of the grid.

    Returns:
        The solution; its force counts towards +z, away from the pole piece.

    Raises:
        MissingExtraError: scikit-fem is not installed.
        UsageError: The design is far outside of Table A.2's bounds.
        RunError: Newton's method does not converge.
    """
    return FieldProblem(solenoid(check_designs(design)[0], x, current, housing, fineness), steel).solve()


class FieldProblem:
    """The finite element problem of a section with one steel."""

    def __init__(self, section: Section, steel: Steel) -> None:
        library = load_skfem()
        self.section, self.steel = section, steel
        nr, nz = section.r.shape
        node = np.arange(nr * nz).reshape(nr, nz)
        corners = np.stack([node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]])
        mesh = library.MeshQuad(np.stack([section.r.ravel(), section.z.ravel()]), corners.reshape(4, -1))
        self.basis = library.Basis(mesh, library.ElementQuad2(), intorder=4)
        self.r = np.asarray(self.basis.global_coordinates())[0]
        self.weight = 2.0 * np.pi * self.r * self.basis.dx
        self.is_steel = section.steel.ravel()[:, None]
        self.current = section.current_density.ravel()[:, None] + 0.0 * self.r

    @cached_property
    def fixed_unknowns(self) -> Any:
        """Numbers of the unknowns that are zero."""
        location = self.basis.doflocs
        is_fixed = location[0] < 1e-12
        if self.section.closed:
            z = self.section.z
            is_fixed |= location[0] > self.section.r.max() - 1e-12
            is_fixed |= (location[1] < z.min() + 1e-12) | (location[1] > z.max() - 1e-12)
        return np.flatnonzero(is_fixed)

    def solve(self) -> Solution:
        """Solve by Newton's method from a zero field; RunError where it does not converge."""
        A = np.zeros(self.basis.N)
        B = self.flux_density(A)
        energy = self.energies(A, B)[0]
        for step in range(MAX_STEPS):
            gradient, hessian = self._linearise(B)
            direction = self._solve_linear(hessian, gradient)
            decrement = float(gradient @ direction)
            if decrement <= TOLERANCE * abs(energy):
                return Solution(
                    self.energies(A, B)[1], self.force(B), B.mean(axis=2), int(self.basis.N), step
                )
            A, B, energy = self._advance(A, direction, decrement, energy)
        raise RunError(f"field solver: expected Newton's method to end in {MAX_STEPS} steps, it did not")

    def flux_density(self, A: FloatArray) -> FloatArray:
        """Return the radial and axial component of B (2, cells, points), T."""
        field = self.basis.interpolate(A)
        return np.stack([-field.grad[1], field.grad[0] + np.asarray(field) / self.r])

    def energies(self, A: FloatArray, B: FloatArray) -> tuple[float, float]:
        """Return ∫ w − J·A, which the field minimises, and the coenergy ∫ ∫ B dH, both in J."""
        magnitude = np.hypot(B[0], B[1])
        H, _, stored = magnetisation_all(magnitude, self.steel)
        air = magnitude**2 / (2.0 * MU0)
        energy = np.where(self.is_steel, stored, air)
        coenergy = np.where(self.is_steel, H * magnitude - stored, air)
        driven = self.current * np.asarray(self.basis.interpolate(A))
        return float(np.sum((energy - driven) * self.weight)), float(np.sum(coenergy * self.weight))

    def force(self, B: FloatArray) -> float:
        """Return the force (N) along +z on the moving cells, by virtual work in the air around them."""
        g = self.basis.interpolate(self._virtual_displacement()).grad
        pull = B[0] * B[1] * g[0] + 0.5 * (B[1] ** 2 - B[0] ** 2) * g[1]
        return -float(np.sum(np.where(self.is_steel, 0.0, pull / MU0) * self.weight))

    def _linearise(self, B: FloatArray) -> tuple[FloatArray, Any]:
        library = load_skfem()
        magnitude = np.hypot(B[0], B[1])
        H, slope, _ = magnetisation_all(magnitude, self.steel)
        # ν = H/B, and what dH/dB exceeds it by: it goes with the products of the components of B.
        small = magnitude < VANISHING
        nu = np.where(small, slope, H / np.maximum(magnitude, VANISHING))
        curvature = np.where(
            self.is_steel & ~small, (slope - nu) / np.maximum(magnitude, VANISHING) ** 2, 0.0
        )
        nu = np.where(self.is_steel, nu, 1.0 / MU0)

        def residual(v: Any, w: Any) -> Any:
            r = w.x[0]
            curl_term = w.br * -v.grad[1] + w.bz * (v.grad[0] + v / r)
            return 2.0 * np.pi * r * (w.nu * curl_term - w.j * v)

        def stiffness(u: Any, v: Any, w: Any) -> Any:
            r = w.x[0]
            ur, uz, vr, vz = -u.grad[1], u.grad[0] + u / r, -v.grad[1], v.grad[0] + v / r
            saturation_term = w.curvature * (w.br * ur + w.bz * uz) * (w.br * vr + w.bz * vz)
            return 2.0 * np.pi * r * (w.nu * (ur * vr + uz * vz) + saturation_term)

        known = {"nu": nu, "curvature": curvature, "br": B[0], "bz": B[1], "j": self.current}
        gradient = library.LinearForm(residual).assemble(self.basis, **known)
        gradient[self.fixed_unknowns] = 0.0
        return gradient, library.BilinearForm(stiffness).assemble(self.basis, **known)

    def _solve_linear(self, hessian: Any, gradient: FloatArray) -> FloatArray:
        library = load_skfem()
        return np.asarray(library.solve(*library.condense(hessian, gradient, D=self.fixed_unknowns)))

    def _advance(
        self, A: FloatArray, direction: FloatArray, decrement: float, energy: float
    ) -> tuple[FloatArray, FloatArray, float]:
        """Step along the direction, halved until the energy decreases."""
        step = 1.0
        while step > 1e-6:
            trial = A - step * direction
            B = self.flux_density(trial)
            trial_energy = self.energies(trial, B)[0]
            if trial_energy <= energy - 1e-3 * step * decrement:
                return trial, B, trial_energy
            step *= 0.5
        raise RunError("field solver: no step lowers the energy any further, and it has not settled")

    def _virtual_displacement(self) -> FloatArray:
        """Solve for the harmonic function that is 1 on the moving cells, 0 on other steel and the edges."""
        library = load_skfem()

        def stiffness(u: Any, v: Any, w: Any) -> Any:
            return u.grad[0] * v.grad[0] + u.grad[1] * v.grad[1]

        moving = self.section.moving.ravel()
        ones = np.unique(self.basis.element_dofs[:, moving])
        others = np.unique(self.basis.element_dofs[:, self.section.steel.ravel() & ~moving])
        location, z = self.basis.doflocs, self.section.z
        edge = (
            (location[0] > self.section.r.max() - 1e-12)
            | (location[1] < z.min() + 1e-12)
            | (location[1] > z.max() - 1e-12)
        )
        is_fixed = np.union1d(np.union1d(ones, others), np.flatnonzero(edge))
        g = np.zeros(self.basis.N)
        g[ones] = 1.0
        matrix = library.BilinearForm(stiffness).assemble(self.basis)
        return np.asarray(library.solve(*library.condense(matrix, x=g, D=is_fixed)))
