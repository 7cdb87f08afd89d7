"""Slopes of a problem that were taken nearby, so that a fit can begin without taking them anew.

Slopes by differences take a simulation for each parameter and state. Restarts within the uncertainty of a
fit, and profiles along one of its parameters, begin near a point at which they are known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.identify.problem import Linearised, Point, Problem
from labhil.signals import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Slopes:
    """Slopes of a problem near a point.

    Attributes:
        lin: The problem to first order there.
    """

    lin: Linearised

    @classmethod
    def at(cls, problem: Problem, point: Point, residuals: FloatArray) -> Slopes:
        """Take the slopes at ``point``, where the residuals are ``residuals`` (N·c,)."""
        return cls(problem.linearise(point, residuals))

    def with_residuals(self, residuals: FloatArray) -> Slopes:
        """The same slopes where the residuals are ``residuals`` (N·c,)."""
        return Slopes(replace(self.lin, residuals=residuals))

    def without(self, places: IntArray) -> Slopes:
        """The same with the free parameters at these places (K,) held."""
        return Slopes(replace(self.lin, by_parameters=np.delete(self.lin.by_parameters, places, axis=1)))
