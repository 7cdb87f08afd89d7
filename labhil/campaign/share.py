"""Counts with their limits, as benchmarks and trials report them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from scipy import stats


@dataclass(frozen=True, slots=True)
class Share:
    """A count of so many with its two-sided 95 % Clopper-Pearson limits."""

    hits: int
    of: int

    @property
    def value(self) -> float:
        """The share, NaN of none."""
        return self.hits / self.of if self.of else float("nan")

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper limit."""
        k, n = self.hits, self.of
        low = float(stats.beta.ppf(0.025, k, n - k + 1)) if k else 0.0
        high = float(stats.beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
        return low, high

    def to_json(self) -> dict[str, Any]:
        """As plain JSON data; a share of none is null."""
        limits = list(self.limits) if self.of else None
        return {
            "hits": self.hits,
            "of": self.of,
            "share": self.value if self.of else None,
            "limits95": limits,
        }

    def __str__(self) -> str:
        """As people write it: ``98.2 % (393 of 400; 96.3 to 99.3)``."""
        if not self.of:
            return "–"
        low, high = self.limits
        return f"{100 * self.value:.1f} % ({self.hits} of {self.of}; {100 * low:.1f} to {100 * high:.1f})"
