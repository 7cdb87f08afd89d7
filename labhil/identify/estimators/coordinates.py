"""From a problem to what a global search sees: a finite box, and a cost of one vector.

Sizes that cannot be zero (an inertia, a resistance) are searched by their logarithm. Parameters in which
the outputs are linear are projected out, so the search is as small as what is really nonlinear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.identify.estimators.projection import Reduced
from labhil.identify.estimators.search import Box
from labhil.identify.problem import Point, Problem
from labhil.physics.terms import Parameter
from labhil.signals import FloatArray

DECADES = 1.5
"""How far beyond scale and start a size reaches that has no telling bounds, both ways."""

TELLING = 1e5
"""Bounds of a size that are further apart only keep the model computable; they say nothing of where it is."""

SCALES = 5.0
"""Reach of a parameter without a finite bound, both ways from zero: in scales, and in starts beyond one."""


def box(problem: Problem, start: FloatArray | None = None) -> Box:
    """The finite box of all free parameters, in units of their scale, always inside the bounds.

    A finite bound is the box's. Where a bound is infinite the box ends five scales from zero, or five
    times the start where that is more than a scale. A size that cannot be zero and whose bounds are more than
    five decades apart reaches 1.5 decades beyond both its scale and its ``start`` (P,).
    """
    z = problem.start().z if start is None else start
    parameters = [problem.model.parameters[i] for i in problem.free]
    reach = SCALES * np.maximum(1.0, np.abs(z))
    low = np.where(np.isfinite(problem.lower), problem.lower, -reach)
    high = np.where(np.isfinite(problem.upper), problem.upper, reach)
    vague = np.array([_is_size(p) for p in parameters], dtype=bool)
    vague &= (problem.lower > 0.0) & (problem.upper > TELLING * problem.lower)
    size = np.maximum(np.abs(z), 1e-12)
    low = np.where(vague, np.minimum(size, 1.0) / 10**DECADES, low)
    high = np.where(vague, np.maximum(size, 1.0) * 10**DECADES, high)
    low, high = np.maximum(low, problem.lower), np.minimum(high, problem.upper)
    return Box(low, np.maximum(low, high))


def _is_size(parameter: Parameter) -> bool:
    """Whether it is a rig's own parameter or a width: then it is searched by its logarithm, if positive."""
    return parameter.term is None or parameter.shape


@dataclass(frozen=True)
class Coordinates:
    """How a search's vector stands for the free parameters of a problem.

    ``logarithmic`` (S,) marks which of the searched ones, those that ``reduced`` keeps, are searched by
    their logarithm; ``box`` and ``start`` (S,) are in these coordinates.
    """

    reduced: Reduced
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
        """Coordinates around ``start`` (by default the problem's own).

        Without ``project`` the linear parameters are searched too.
        """
        begin = problem.start() if start is None else start
        reduced = Reduced.of(problem, begin, project=project)
        full_box = box(problem, begin.z)
        low, high = full_box.lower[reduced.kept], full_box.upper[reduced.kept]
        sizes = [_is_size(problem.model.parameters[i]) for i in problem.free[reduced.kept]]
        chosen = np.array(sizes, dtype=bool) & (low > 0.0)
        inside = np.clip(begin.z[reduced.kept], low, high)
        transformed = [np.where(chosen, np.log(np.where(chosen, x, 1.0)), x) for x in (low, high, inside)]
        return cls(reduced, chosen, Box(transformed[0], transformed[1]), transformed[2])

    def z(self, vector: FloatArray) -> FloatArray:
        """All free parameters, scaled; the linear ones solved for within their bounds."""
        kept = self._searched_parameters(vector)
        return self.reduced.solve(kept)[0] if len(self.reduced.linear) else kept

    def cost(self, vector: FloatArray) -> float:
        """Sum of squared residuals in units of noise, but for what initial states explain."""
        return self.reduced.cost(self._searched_parameters(vector))

    def _searched_parameters(self, vector: FloatArray) -> FloatArray:
        """The searched parameters, scaled; the exponential's rounding must not leave the bounds."""
        kept = np.where(self.logarithmic, np.exp(np.where(self.logarithmic, vector, 0.0)), vector)
        places, problem = self.reduced.kept, self.reduced.problem
        return np.clip(kept, problem.lower[places], problem.upper[places])
