"""Particle swarms: the reference text's, one whose inertia adapts, and one with differential evolution."""

from __future__ import annotations

import numpy as np

from labhil.identify.estimators.search import Ledger, SearchResult
from labhil.signals import FloatArray

CONFIDENCE = 2.0
"""C₁ and C₂ of the reference text (its d₁ and d₂)."""

INERTIA = (0.9, 0.4)
"""χ of the reference text, from the first to the last iteration."""

PER_DIMENSION = 10


def text_swarm(
    ledger: Ledger, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
    """The reference text's swarm, equations 3.1 to 3.3: V ← χ·[V + C₁(p − X)·r₁ + C₂(g − X)·r₂], X ← X + V.

    Ten particles per dimension, χ falls from 0.9 to 0.4 over ``iterations``, and multiplies the whole
    bracket. The text says nothing of bounds: here particles that leave the box are put on its edge.
    ``start`` takes the place of one particle.
    """
    return _swarm(ledger, seed, start, iterations, adaptive=False, crossing=0.0)


def affordable(ledger: Ledger, iterations: int = 1000) -> int:
    """Rounds of a swarm that the budget leaves of so many; in these χ has to fall, or it never does."""
    return max(1, min(iterations, ledger.budget.evaluations // (PER_DIMENSION * len(ledger.box)) - 1))


def adaptive_swarm(
    ledger: Ledger, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
    """A swarm whose inertia follows its success (Nickabadi, Ebadzadeh and Safabakhsh 2011).

    χ = χ_min + (χ_max − χ_min)·(share of particles that improved in the last round).
    """
    return _swarm(ledger, seed, start, iterations, adaptive=True, crossing=0.0)


def swarm_with_evolution(
    ledger: Ledger, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
    """A swarm whose memories are also crossed by differential evolution (rand/1, half of the coordinates)."""
    return _swarm(ledger, seed, start, iterations, adaptive=True, crossing=0.5)


def _swarm(
    ledger: Ledger, seed: int, start: FloatArray | None, iterations: int, *, adaptive: bool, crossing: float
) -> SearchResult:
    random = np.random.default_rng(seed)
    box, count = ledger.box, PER_DIMENSION * len(ledger.box)
    x = box.draw(random, count)
    if start is not None:
        x[0] = box.clip(start)
    v = np.zeros_like(x)
    best, best_cost = x.copy(), ledger.many(x)
    success = 1.0
    for k in range(iterations):
        if ledger.enough():
            break
        share = success if adaptive else 1.0 - k / iterations
        inertia = INERTIA[1] + (INERTIA[0] - INERTIA[1]) * share
        leader = best[np.argmin(best_cost)]
        r1, r2 = random.random((2, *x.shape))
        v = inertia * (v + CONFIDENCE * (best - x) * r1 + CONFIDENCE * (leader - x) * r2)
        x = box.clip(x + v)
        cost = ledger.many(x)
        better = cost < best_cost
        best[better], best_cost[better] = x[better], cost[better]
        success = float(np.mean(better))
        if crossing:
            _cross(ledger, random, best, best_cost, crossing)
    return ledger.result()


def _cross(
    ledger: Ledger, random: np.random.Generator, best: FloatArray, best_cost: FloatArray, crossing: float
) -> None:
    """One generation of differential evolution among the particles' best places, in place."""
    n = len(best)
    a, b, c = (best[random.permutation(n)] for _ in range(3))
    mutant = a + 0.6 * (b - c)
    trial = ledger.box.clip(np.where(random.random(best.shape) < crossing, mutant, best))
    cost = ledger.many(trial)
    better = cost < best_cost
    best[better], best_cost[better] = trial[better], cost[better]
