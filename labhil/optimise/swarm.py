"""Maximise a function that evaluates many designs at once by the reference text's particle swarm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labhil.identify.estimators.search import Box, Budget, CostEvaluator
from labhil.identify.estimators.swarm import PARTICLES_PER_DIMENSION, reference_swarm
from labhil.signals import FloatArray

Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class SwarmResult:
    """The optimum of a swarm."""

    best: FloatArray
    """(k,)."""
    value: float


class _BatchEvaluator(CostEvaluator):
    """An evaluator that evaluates a population in one call."""

    def __init__(self, costs: Function, box: Box, budget: Budget) -> None:
        super().__init__(lambda z: float(costs(z[None, :])[0]), box, budget)
        self._costs = costs

    def evaluate_all(self, points: FloatArray) -> FloatArray:
        """Costs (n,) of points (n, k)."""
        inside = self.box.clip(points)
        return np.array([self._note(z, float(c)) for z, c in zip(inside, self._costs(inside), strict=True)])


def maximise(
    function: Function, lower: FloatArray, upper: FloatArray, seed: int, iterations: int
) -> SwarmResult:
    """Maximise a function by the swarm of equations 3.1 to 3.3, ten particles per dimension.

    Args:
        function: Points (n, k) to values (n,).
        lower: Lower bounds (k,).
        upper: Upper bounds (k,).
        seed: Seed of the swarm.
        iterations: Number of iterations.

    Returns:
        The best point and its value.
    """
    budget = Budget(PARTICLES_PER_DIMENSION * len(lower) * (iterations + 1), threshold=-np.inf)
    evaluator = _BatchEvaluator(lambda X: -function(X), Box(lower, upper), budget)
    result = reference_swarm(evaluator, seed, iterations=iterations)
    return SwarmResult(result.z, -result.cost)
