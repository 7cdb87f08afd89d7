"""Particle swarms: the reference text's, one with adaptive inertia, one with differential evolution."""

from __future__ import annotations

import numpy as np

from labhil.identify.estimators.search import CostEvaluator, SearchResult
from labhil.signals import FloatArray

ACCELERATION = 2.0
"""C₁ and C₂ of the reference text (its d₁ and d₂)."""

INERTIA = (0.9, 0.4)
"""χ of the reference text at the first and the last iteration."""

PARTICLES_PER_DIMENSION = 10
"""Number of particles over the number of dimensions, as in the reference text."""


def reference_swarm(
    evaluator: CostEvaluator, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
    """The reference text's swarm, equations 3.1 to 3.3: V ← χ·[V + C₁(p − X)·r₁ + C₂(g − X)·r₂], X ← X + V.

    There are ten particles per dimension; χ falls from 0.9 to 0.4 over ``iterations``, and multiplies the
    whole bracket. The text does not state how bounds hold: here particles that leave the box are moved to its
    edge. ``start`` replaces one particle.
    """
    return _swarm(evaluator, seed, start, iterations, adaptive=False, crossing=0.0)


def affordable_iterations(evaluator: CostEvaluator, iterations: int = 1000) -> int:
    """Iterations of a swarm within the budget, at most ``iterations``; χ is to fall over these."""
    particles = PARTICLES_PER_DIMENSION * len(evaluator.box)
    return max(1, min(iterations, evaluator.budget.evaluations // particles - 1))


def adaptive_swarm(
    evaluator: CostEvaluator, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
    """A swarm with adaptive inertia (Nickabadi, Ebadzadeh and Safabakhsh 2011).

    χ = χ_min + (χ_max − χ_min)·(share of particles that improved in the last round).
    """
    return _swarm(evaluator, seed, start, iterations, adaptive=True, crossing=0.0)


def swarm_with_evolution(
    evaluator: CostEvaluator, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
    """An adaptive swarm whose personal bests also undergo differential evolution (rand/1, crossover 0.5)."""
    return _swarm(evaluator, seed, start, iterations, adaptive=True, crossing=0.5)


def _swarm(
    evaluator: CostEvaluator,
    seed: int,
    start: FloatArray | None,
    iterations: int,
    *,
    adaptive: bool,
    crossing: float,
) -> SearchResult:
    """Run a swarm; ``crossing`` is the crossover rate of differential evolution, 0 for none."""
    random = np.random.default_rng(seed)
    box, count = evaluator.box, PARTICLES_PER_DIMENSION * len(evaluator.box)
    x = box.draw(random, count)
    if start is not None:
        x[0] = box.clip(start)
    v = np.zeros_like(x)
    best, best_cost = x.copy(), evaluator.evaluate_all(x)
    success = 1.0
    for k in range(iterations):
        if evaluator.end_round():
            break
        share = success if adaptive else 1.0 - k / iterations
        inertia = INERTIA[1] + (INERTIA[0] - INERTIA[1]) * share
        leader = best[np.argmin(best_cost)]
        r1, r2 = random.random((2, *x.shape))
        v = inertia * (v + ACCELERATION * (best - x) * r1 + ACCELERATION * (leader - x) * r2)
        x = box.clip(x + v)
        cost = evaluator.evaluate_all(x)
        better = cost < best_cost
        best[better], best_cost[better] = x[better], cost[better]
        success = float(np.mean(better))
        if crossing:
            _cross(evaluator, random, best, best_cost, crossing)
    return evaluator.result()


def _cross(
    evaluator: CostEvaluator,
    random: np.random.Generator,
    best: FloatArray,
    best_cost: FloatArray,
    crossing: float,
) -> None:
    """Run one generation of differential evolution among the particles' personal bests, in place."""
    n = len(best)
    a, b, c = (best[random.permutation(n)] for _ in range(3))
    mutant = a + 0.6 * (b - c)
    trial = evaluator.box.clip(np.where(random.random(best.shape) < crossing, mutant, best))
    cost = evaluator.evaluate_all(trial)
    better = cost < best_cost
    best[better], best_cost[better] = trial[better], cost[better]
