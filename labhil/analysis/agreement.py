"""Whether residuals stay within a band, and since when they do not: one output of a model beside its rig."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.signals import FloatArray

RUN = 8
"""Residuals in a row, beyond the band on one side, that no noise makes: the model has left it."""

SHORTEST_RUN = 3
"""The same where a stretch has few samples."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """What is known of one output.

    Attributes:
        band: Half width of the band, in noise levels.
        left_at: When the residual left the band, s; None while the model agrees.
        beyond: How far the largest residual of the newest stretch was beyond the band, in noise levels.
        calm_since: Since when the residual has been back within it, s; None while it is not.
        times_left: How often it has left the band.
    """

    band: float
    left_at: float | None = None
    beyond: float = 0.0
    calm_since: float | None = None
    times_left: int = 0

    @property
    def agrees(self) -> bool:
        """Whether the model explains this output."""
        return self.left_at is None

    def after(self, t: FloatArray, residual: FloatArray, calm: float) -> Agreement:
        """What is known after one more simulated stretch.

        Args:
            t: Times of its samples, (n,) s.
            residual: Measured − simulated in noise levels, (n,).
            calm: How long the residual has to stay within the band until the model agrees again, s.

        Returns:
            The new state.
        """
        if not len(t):
            return self
        first = leaves(residual, self.band)
        beyond = max(0.0, float(np.max(np.abs(residual), initial=0.0)) - self.band)
        if first is not None:
            fresh = self.left_at is None
            return replace(
                self,
                left_at=float(t[first]) if fresh else self.left_at,
                beyond=beyond,
                calm_since=None,
                times_left=self.times_left + fresh,
            )
        if self.left_at is None:
            return replace(self, beyond=0.0)
        since = float(t[0]) if self.calm_since is None else self.calm_since
        if t[-1] - since >= calm:
            return replace(self, left_at=None, beyond=0.0, calm_since=None)
        return replace(self, beyond=beyond, calm_since=since)


def leaves(residual: FloatArray, band: float) -> int | None:
    """Where a stretch of residuals (n,) leaves the band for good: the first of a run; None where it does not.

    A residual that is not finite, of a simulation that ran away, is beyond any band.
    """
    needed = min(RUN, max(SHORTEST_RUN, len(residual) // 5))
    known = np.nan_to_num(residual, nan=np.inf, posinf=np.inf, neginf=-np.inf)
    run_starts = [first for side in (known, -known) if (first := _first_run(side > band, needed)) is not None]
    return min(run_starts, default=None)


def _first_run(beyond: np.ndarray, needed: int) -> int | None:
    """Index at which the first run of ``needed`` values begins; None without one."""
    if len(beyond) < needed:
        return None
    counts = np.convolve(beyond, np.ones(needed, dtype=np.int64), "valid")
    full = np.flatnonzero(counts == needed)
    return int(full[0]) if len(full) else None
