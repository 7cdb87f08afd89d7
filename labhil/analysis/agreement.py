"""Agreement of one output of a model with its rig: whether residuals stay within a band, and since when.

``shadow`` makes the residuals while the rig runs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class Agreement:
    """State of agreement of one output.

    Attributes:
        band: Half width of the band, in noise levels.
        left_at: Time at which the residual left the band, s; None while the model agrees.
        beyond: Distance of the newest stretch's largest residual beyond the band, in noise levels.
        calm_since: Time since which the residual has been within the band again, s; None while it is not.
        times_left: Number of times that the residual has left the band.
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
        """Update the state with one more simulated stretch.

        Args:
            t: Times of its samples, (n,) s.
            residual: Measured − simulated in noise levels, (n,).
            calm: Time for which the residual has to stay within the band until the model agrees again, s.

        Returns:
            The new state.
        """
        if not len(t):
            return self
        first = find_exit(residual, self.band)
        beyond = max(0.0, float(np.max(np.abs(residual), initial=0.0)) - self.band)
        if first is not None:
            agreed_before = self.left_at is None
            return replace(
                self,
                left_at=float(t[first]) if agreed_before else self.left_at,
                beyond=beyond,
                calm_since=None,
                times_left=self.times_left + agreed_before,
            )
        if self.left_at is None:
            return replace(self, beyond=0.0)
        since = float(t[0]) if self.calm_since is None else self.calm_since
        if t[-1] - since >= calm:
            return replace(self, left_at=None, beyond=0.0, calm_since=None)
        return replace(self, beyond=beyond, calm_since=since)


def find_exit(
    residual: FloatArray, band: float, *, run_length: int = 8, min_run_length: int = 3
) -> int | None:
    """Find where residuals leave a band: the first of a run beyond it on one side.

    Args:
        residual: (n,) of one stretch; a value that is not finite is beyond any band.
        band: Half width of the band, in the residuals' unit.
        run_length: Residuals in a row that noise does not cause.
        min_run_length: The same in a short stretch, where a fifth of its samples make a run.

    Returns:
        Index of the first; None where the residuals stay within the band.
    """
    needed = min(run_length, max(min_run_length, len(residual) // 5))
    finite = np.nan_to_num(residual, nan=np.inf, posinf=np.inf, neginf=-np.inf)
    run_starts = [
        first for side in (finite, -finite) if (first := _first_run(side > band, needed)) is not None
    ]
    return min(run_starts, default=None)


def _first_run(beyond: np.ndarray, needed: int) -> int | None:
    """Index at which the first run of ``needed`` true values begins; None without one."""
    if len(beyond) < needed:
        return None
    counts = np.convolve(beyond, np.ones(needed, dtype=np.int64), "valid")
    full = np.flatnonzero(counts == needed)
    return int(full[0]) if len(full) else None
