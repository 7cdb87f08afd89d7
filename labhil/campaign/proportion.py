"""Binomial proportions with their confidence limits, as benchmarks and trials report them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from scipy import stats


@dataclass(frozen=True, slots=True)
class Proportion:
    """``hits`` of ``total`` cases, with two-sided 95 % Clopper-Pearson limits."""

    hits: int
    total: int

    @property
    def value(self) -> float:
        """The proportion, NaN of no cases."""
        return self.hits / self.total if self.total else float("nan")

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper 95 % limit."""
        k, n = self.hits, self.total
        low = float(stats.beta.ppf(0.025, k, n - k + 1)) if k else 0.0
        high = float(stats.beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
        return low, high

    def to_json(self) -> dict[str, Any]:
        """Return the proportion as plain JSON data; of no cases it is null."""
        limits = list(self.limits) if self.total else None
        return {
            "hits": self.hits,
            "of": self.total,
            "share": self.value if self.total else None,
            "limits95": limits,
        }

    def __str__(self) -> str:
        """Return text like ``98.2 % (393 of 400; 96.3 to 99.3)``."""
        if not self.total:
            return "–"
        low, high = self.limits
        return f"{100 * self.value:.1f} % ({self.hits} of {self.total}; {100 * low:.1f} to {100 * high:.1f})"
