"""What a global search gets and gives, whichever the method."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from labhil.signals import FloatArray

Progress = Callable[[str], None]

WORST = 1e100
"""What a cost that is no finite number counts as; the squares that libraries form of it stay finite."""


@dataclass(frozen=True, slots=True)
class Box:
    """Bounds (P,) of what is searched; they hold for every point that is ever tried."""

    lower: FloatArray
    upper: FloatArray

    def __len__(self) -> int:
        return len(self.lower)

    def clip(self, z: FloatArray) -> FloatArray:
        """The nearest point inside."""
        return np.clip(z, self.lower, self.upper)

    def draw(self, random: np.random.Generator, count: int) -> FloatArray:
        """Points (count, P), uniform."""
        return np.asarray(random.uniform(self.lower, self.upper, (count, len(self))))


@dataclass(frozen=True, slots=True)
class Budget:
    """When to stop: after ``evaluations``, below ``threshold``, or after ``patience`` rounds of no gain.

    A gain is a fall of the best cost by more than ``gain`` of it.
    """

    evaluations: int
    threshold: float = 0.0
    patience: int = 1_000_000
    gain: float = 1e-4


@dataclass(frozen=True, slots=True)
class SearchResult:
    """The best point (P,) with its cost; ``history`` is the best cost after each round."""

    z: FloatArray
    cost: float
    evaluations: int
    history: tuple[float, ...]
    stopped_because: str
    draws: FloatArray | None = None


@dataclass
class Ledger:
    """Evaluates a cost, remembers the best, counts, and says when it is enough.

    ``cost`` takes one point (P,) and gives a number; populations are evaluated on ``threads``, which
    kernels allow since they release the interpreter; the order of results does not depend on that.
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

    def one(self, z: FloatArray) -> float:
        """Cost of a point, clipped into the box; a number that is not finite counts as very large."""
        inside = self.box.clip(np.asarray(z, dtype=np.float64))
        return self._note(inside, self.cost(inside))

    def many(self, points: FloatArray) -> FloatArray:
        """Costs (n,) of points (n, P)."""
        inside = self.box.clip(points)
        if self.threads == 1:
            # one by one, so that an interruption leaves what is known by then
            return np.array([self._note(z, self.cost(z)) for z in inside])
        with ThreadPoolExecutor(self.threads) as executor:
            costs = executor.map(self.cost, inside)
            return np.array([self._note(z, c) for z, c in zip(inside, costs, strict=True)])

    def _note(self, z: FloatArray, cost: float) -> float:
        self.evaluations += 1
        cost = min(cost, WORST) if np.isfinite(cost) else WORST
        if cost < self.best:
            self.best, self.z = cost, z.copy()
        return cost

    def enough(self) -> bool:
        """Close a round; True when the search should stop, with the reason noted."""
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
        """The best point so far with its cost."""
        return SearchResult(
            self.z,
            self.best,
            self.evaluations,
            tuple(self.history),
            self.stopped_because or "finished",
            draws,
        )
