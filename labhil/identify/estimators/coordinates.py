"""Coordinates of a global search: a finite box, and a cost that is a function of one vector.

Positive constants (an inertia, a resistance) are searched by their logarithm. Parameters in which the outputs
are linear are projected out, so that only the nonlinear ones are searched (``projection``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.identify.estimators.projection import ReducedProblem
from labhil.identify.estimators.search import Box
from labhil.identify.problem import Point, Problem
from labhil.physics.terms import Parameter
from labhil.signals import FloatArray


def search_box(
    problem: Problem,
    start: FloatArray | None = None,
    *,
    scales: float = 5.0,
    decades: float = 1.5,
    max_bound_ratio: float = 1e5,
) -> Box:
    """Choose a finite box for all free parameters; it is always inside their bounds.

    A finite bound of a parameter is also the box's.

    Args:
        problem: What is estimated.
        start: (P,) start values in units of the parameters' scales; by default the problem's own.
        scales: Distance of the box's end from zero where a bound is infinite, in scales (or in start values
            where these are larger than a scale).
        decades: How far the box of a positive constant with wide bounds reaches beyond both its scale and its
            start value.
        max_bound_ratio: Upper over lower bound, beyond which bounds count as wide: they only keep the model
            computable.

    Returns:
        In units of the parameters' scales.
    """
    z = problem.start().z if start is None else start
    parameters = [problem.model.parameters[i] for i in problem.free]
    reach = scales * np.maximum(1.0, np.abs(z))
    low = np.where(np.isfinite(problem.lower), problem.lower, -reach)
    high = np.where(np.isfinite(problem.upper), problem.upper, reach)
    has_wide_bounds = np.array([_is_size(p) for p in parameters], dtype=bool)
    has_wide_bounds &= (problem.lower > 0.0) & (problem.upper > max_bound_ratio * problem.lower)
    size = np.maximum(np.abs(z), 1e-12)
    low = np.where(has_wide_bounds, np.minimum(size, 1.0) / 10**decades, low)
    high = np.where(has_wide_bounds, np.maximum(size, 1.0) * 10**decades, high)
    low, high = np.maximum(low, problem.lower), np.minimum(high, problem.upper)
    return Box(low, np.maximum(low, high))


def _is_size(parameter: Parameter) -> bool:
    """Whether it is a constant of the rig or a width, which is searched by its logarithm if positive."""
    return parameter.term is None or parameter.shape


@dataclass(frozen=True)
class Coordinates:
    """Transformation between a search's vector (S,) and the free parameters of a problem.

    Attributes:
        reduced: The problem without its linear parameters.
        logarithmic: (S,) of bool, parameters that are searched by their logarithm.
        box: The searched box in these coordinates.
        start: (S,) start values in these coordinates.
    """

    reduced: ReducedProblem
    logarithmic: np.ndarray
    box: Box
    start: FloatArray

    @classmethod
    def of(
        cls,
        problem: Problem,
        start: Point | None = None,
        *,
        project: bool = True,
    ) -> Coordinates:
        """Make the coordinates of a problem.

        Args:
            problem: What is estimated.
            start: Centre of the search; by default the problem's start.
            project: Solve for linear parameters; otherwise they are searched, too.
        """
        begin = problem.start() if start is None else start
        reduced = ReducedProblem.of(problem, begin, project=project)
        full_box = search_box(problem, begin.z)
        low, high = full_box.lower[reduced.kept], full_box.upper[reduced.kept]
        sizes = [_is_size(problem.model.parameters[i]) for i in problem.free[reduced.kept]]
        chosen = np.array(sizes, dtype=bool) & (low > 0.0)
        inside = np.clip(begin.z[reduced.kept], low, high)
        transformed = [np.where(chosen, np.log(np.where(chosen, x, 1.0)), x) for x in (low, high, inside)]
        return cls(reduced, chosen, Box(transformed[0], transformed[1]), transformed[2])

    def z(self, vector: FloatArray) -> FloatArray:
        """Scaled free parameters (P,) for a search's vector; linear ones are solved for within bounds."""
        kept = self._searched_parameters(vector)
        return self.reduced.solve(kept)[0] if len(self.reduced.linear) else kept

    def cost(self, vector: FloatArray) -> float:
        """Sum of squared residuals in units of noise, initial states projected out."""
        return self.reduced.cost(self._searched_parameters(vector))

    def _searched_parameters(self, vector: FloatArray) -> FloatArray:
        """The searched parameters, scaled; the exponential's rounding must not leave the bounds."""
        kept = np.where(self.logarithmic, np.exp(np.where(self.logarithmic, vector, 0.0)), vector)
        places, problem = self.reduced.kept, self.reduced.problem
        return np.clip(kept, problem.lower[places], problem.upper[places])
