"""Compare the forces of the circuit with those of the field solver, and check the grid of the latter."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from labhil.optimise.circuit import force_curves, positions
from labhil.optimise.field import FINENESS, solve_solenoid
from labhil.optimise.geometry import HOUSING
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class FieldPoint:
    """One force by both methods, N."""

    candidate: str
    current: float
    """A."""
    position: float
    """m."""
    field: float
    circuit: float


@dataclass(frozen=True, slots=True)
class FieldCheck:
    """Forces by the field solver."""

    curves: Mapping[str, FloatArray]
    """Per candidate (m,) N at the circuit's positions and full current."""
    points: tuple[FieldPoint, ...]
    """Those curves and points at half the current."""
    refined: float
    """Largest relative change of a force on grids twice as fine, at one position per candidate."""
    unknowns: int
    """Of the largest grid."""

    def ratios(self) -> FloatArray:
        """Return circuit over field per point."""
        return np.array([point.circuit / point.field for point in self.points])


def check_by_field(designs: Mapping[str, FloatArray], progress: Callable[[str], None]) -> FieldCheck:
    """Solve the field along the stroke, and in its middle at half the current and on a finer grid.

    Args:
        designs: Designs (5,), m and rad, by name.
        progress: Called with a line of text before each design.

    Returns:
        The forces of both methods.

    Raises:
        MissingExtraError: scikit-fem is not installed.
    """
    x, full = positions(), HOUSING.current
    middle = len(x) // 2
    curves, points, changes, unknowns = {}, [], [], 0
    for name, design in designs.items():
        progress(f"field solver: {name}")
        solutions = [solve_solenoid(design, float(at), full) for at in x]
        half = solve_solenoid(design, float(x[middle]), 0.5 * full)
        finer = solve_solenoid(design, float(x[middle]), full, fineness=2.0 * FINENESS)
        curves[name] = np.array([-solution.force for solution in solutions])
        circuit = force_curves(design)[0]
        weak = float(force_curves(design, current=0.5 * full)[0, middle])
        points += [
            FieldPoint(name, full, *row)
            for row in zip(x.tolist(), curves[name].tolist(), circuit.tolist(), strict=True)
        ]
        points.append(FieldPoint(name, 0.5 * full, float(x[middle]), -half.force, weak))
        changes.append(abs(finer.force / solutions[middle].force - 1.0))
        unknowns = max(unknowns, int(finer.unknowns))
    return FieldCheck(curves, tuple(points), max(changes), unknowns)
