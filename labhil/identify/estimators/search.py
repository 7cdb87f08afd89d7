"""Interface of the global searches: box, budget, cost evaluations and result.

Each method takes a ``CostEvaluator``, a seed, a start and a number of iterations, and returns a
``SearchResult``.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from labhil.signals import FloatArray

Progress = Callable[[str], None]

MAX_COST = 1e100
"""Cost in place of one that is not finite: its square, which some libraries form, is still finite."""


@dataclass(frozen=True, slots=True)
class Box:
    """Bounds (P,) of the searched parameters; they hold for every point that is evaluated."""

    lower: FloatArray
    upper: FloatArray

    def __len__(self) -> int:
        return len(self.lower)

    def clip(self, z: FloatArray) -> FloatArray:
        """The nearest point inside the box."""
        return np.clip(z, self.lower, self.upper)

    def draw(self, random: np.random.Generator, count: int) -> FloatArray:
        """Draw points (count, P) uniformly."""
        return np.asarray(random.uniform(self.lower, self.upper, (count, len(self))))


@dataclass(frozen=True, slots=True)
class Budget:
    """When a search stops.

    Attributes:
        evaluations: Number of cost evaluations.
        threshold: Cost at or below which it stops.
        patience: Number of rounds without a gain.
        gain: Relative decrease of the best cost that counts as a gain.
    """

    evaluations: int
    threshold: float = 0.0
    patience: int = 1_000_000
    gain: float = 1e-4


@dataclass(frozen=True, slots=True)
class SearchResult:
    """Where a search ended.

    Attributes:
        z: (P,) the best point.
        cost: Its cost.
        evaluations: Number of cost evaluations.
        history: Best cost after each round.
        stopped_because: The reason, as text.
        draws: (n, P) of the posterior, by ``mcmc`` only.
    """

    z: FloatArray
    cost: float
    evaluations: int
    history: tuple[float, ...]
    stopped_because: str
    draws: FloatArray | None = None


@dataclass
class CostEvaluator:
    """Evaluates a cost, keeps the best point, counts evaluations, and stops a search at its budget.

    Args:
        cost: Function of one point (P,).
        box: Bounds of all points.
        budget: When to stop.
        progress: Called with a line of text after each round.
        threads: On which the points of a population are evaluated; the result does not depend on it.
    """

    cost: Callable[[FloatArray], float]
    box: Box
    budget: Budget
    progress: Progress = lambda text: None
    threads: int = 1
    z: FloatArray = field(init=False)
    best: float = field(default=float("inf"), init=False)
    evaluations: int = field(default=0, init=False)
    history: list[float] = field(default_factory=list, init=False)
    stopped_because: str = field(default="", init=False)
    _since: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self.z = 0.5 * (self.box.lower + self.box.upper)

    def evaluate(self, z: FloatArray) -> float:
        """Evaluate the cost of a point (P,), clipped to the box; a cost that is not finite is very large."""
        inside = self.box.clip(np.asarray(z, dtype=np.float64))
        return self._note(inside, self.cost(inside))

    def evaluate_all(self, points: FloatArray) -> FloatArray:
        """Evaluate the costs (n,) of points (n, P)."""
        inside = self.box.clip(points)
        if self.threads == 1:
            # one by one, so that an interruption keeps the best point until then
            return np.array([self._note(z, self.cost(z)) for z in inside])
        with ThreadPoolExecutor(self.threads) as executor:
            costs = executor.map(self.cost, inside)
            return np.array([self._note(z, c) for z, c in zip(inside, costs, strict=True)])

    def _note(self, z: FloatArray, cost: float) -> float:
        """Count an evaluation and keep the point if it is the best; the cost, made finite."""
        self.evaluations += 1
        cost = min(cost, MAX_COST) if np.isfinite(cost) else MAX_COST
        if cost < self.best:
            self.best, self.z = cost, z.copy()
        return cost

    def end_round(self) -> bool:
        """Close a round; True when the search should stop, with the reason in ``stopped_because``."""
        before = self.history[-1] if self.history else float("inf")
        self.history.append(self.best)
        least = 0.0 if np.isinf(before) else self.budget.gain * abs(before)
        self._since = 0 if self.best < before - least else self._since + 1
        self.progress(f"best cost {self.best:.6g} after {self.evaluations} evaluations")
        if self.best <= self.budget.threshold:
            self.stopped_because = "below the threshold"
        elif self._since >= self.budget.patience:
            self.stopped_because = f"no gain in {self._since} rounds"
        elif self.evaluations >= self.budget.evaluations:
            self.stopped_because = "evaluations are used up"
        return bool(self.stopped_because)

    def result(self, draws: FloatArray | None = None) -> SearchResult:
        """The result so far."""
        return SearchResult(
            self.z,
            self.best,
            self.evaluations,
            tuple(self.history),
            self.stopped_because or "finished",
            draws,
        )
