"""From a problem to what a global search sees: a finite box, and a cost of one vector.

Sizes that cannot be zero (an inertia, a resistance) are searched by their logarithm. Parameters in which
the outputs are linear are projected out (Golub and Pereyra 1973): for every point of the others they are
solved for, so the search is as small as what is really nonlinear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from labhil.identify.estimators.search import Box
from labhil.identify.problem import Point, Problem
from labhil.signals import FloatArray, IntArray

DECADE = 1.5
"""Half width of the box in decades around the start, for sizes that cannot be zero."""

SCALES = 5.0
"""Half width of the box in scales, for parameters without a finite bound."""


@dataclass(frozen=True)
class Coordinates:
    """How a search's vector stands for the free parameters of a problem.

    ``searched`` (S,) are places among the free ones, ``linear`` (L,) those that are solved for;
    ``logarithmic`` (S,) marks which are searched by their logarithm. Initial states are ``states``, held.
    """

    problem: Problem
    searched: IntArray
    linear: IntArray
    logarithmic: np.ndarray
    box: Box
    start: FloatArray
    states: FloatArray

    @classmethod
    def of(cls, problem: Problem, *, project: bool = True) -> Coordinates:
        """Coordinates around the problem's start; without ``project`` everything is searched."""
        point = problem.start()
        parameters = [problem.model.parameters[i] for i in problem.free]
        is_linear = np.array([project and p.linear for p in parameters], dtype=bool)
        searched, linear = np.flatnonzero(~is_linear), np.flatnonzero(is_linear)
        size = np.maximum(np.abs(point.z), 1e-12)
        logarithmic = np.array([parameters[j].term is None and problem.lower[j] > 0.0 for j in searched])
        lower, upper = problem.lower[searched], problem.upper[searched]
        reach = SCALES * np.maximum(1.0, size[searched])
        low = np.where(logarithmic, size[searched] / 10**DECADE, np.maximum(lower, -reach))
        high = np.where(logarithmic, size[searched] * 10**DECADE, np.minimum(upper, reach))
        low, high = np.maximum(low, lower), np.minimum(high, upper)
        shaped = np.array([parameters[j].shape and problem.lower[j] > 0.0 for j in searched])
        logarithmic = logarithmic | shaped
        begin = np.clip(point.z[searched], low, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = [np.where(logarithmic, np.log(np.maximum(x, 1e-300)), x) for x in (low, high, begin)]
        return cls(problem, searched, linear, logarithmic, Box(ends[0], ends[1]), ends[2], point.states)

    def z(self, vector: FloatArray) -> FloatArray:
        """All free parameters, scaled; the linear ones solved for within their bounds."""
        z = self.problem.start().z.copy()
        z[self.searched] = np.where(self.logarithmic, np.exp(np.where(self.logarithmic, vector, 0.0)), vector)
        return self._solved(z) if len(self.linear) else z

    def cost(self, vector: FloatArray) -> float:
        """Sum of squared residuals in units of noise, initial states held."""
        residuals = self.problem.residuals(Point(self.z(vector), self.states))
        return float(residuals @ residuals)

    def _solved(self, z: FloatArray) -> FloatArray:
        """``z`` with the linear parameters at their least squares."""
        z[self.linear] = 0.0
        base = self.problem.residuals(Point(z, self.states))
        columns = np.empty((len(base), len(self.linear)))
        for k, j in enumerate(self.linear):
            moved = z.copy()
            moved[j] = 1.0
            columns[:, k] = self.problem.residuals(Point(moved, self.states)) - base
        bounds = (self.problem.lower[self.linear], self.problem.upper[self.linear])
        values, *_ = np.linalg.lstsq(columns, -base, rcond=None)
        if np.any(values < bounds[0]) or np.any(values > bounds[1]):
            values = lsq_linear(columns, -base, bounds=bounds).x
        z[self.linear] = values
        return z
