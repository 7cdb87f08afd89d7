"""What a search works on, and when its two kinds of data speak for a step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from labhil.diagnose.evidence import Evidence, bic, effective_samples
from labhil.identify.fitted import Fitted
from labhil.identify.score import Score, score
from labhil.physics.model import Model, Record
from labhil.signals import FloatArray

NEEDED_BIC = -10.0
"""Very strong evidence on the search data, in the usual reading of BIC."""

JUDGED_LENGTH, JUDGED_WINDOWS = 4.0 / 3.0, 10
"""Judged windows are this much longer than those of the search, or so short that they can be counted."""

MOST_OF_A_RECORDING = 0.5
"""Share of each of several recordings that a judged window, which has a lead-in too, may have."""

JUDGED_SHARES = (1.0, 0.25)
"""What acts slowly shows on long windows, what acts fast and often on many short ones."""

ALPHA = 0.1
"""One-sided level of the held-out test that every step has to pass by itself."""

TRUSTED = 1e-6
"""The search data's p value is trusted down to this: noise is never quite what it is taken for."""

TOGETHER = 5e-4
"""Level of both tests together (Fisher's method)."""


@dataclass(frozen=True, slots=True)
class Data:
    """What a search works on: search and test records with their noise, and the windows' length in s.

    ``begin`` is the vector that fits begin at; parameters with a key in ``held`` stay there.
    """

    model: Model
    search: Record
    test: Record
    sigma: FloatArray
    test_sigma: FloatArray
    window: float
    begin: FloatArray
    held: frozenset[str] = frozenset()

    def judge(self, theta: FloatArray) -> tuple[Score, ...]:
        """Scores on held-out windows: as long as can be counted, short ones, and as long as the metric's."""
        lengths: tuple[float | None, ...] = (None,)
        if self.model.state_names:
            durations = self.test.durations
            countable = min(sum(durations) / JUDGED_WINDOWS, MOST_OF_A_RECORDING * min(durations))
            length = min(JUDGED_LENGTH * self.window, countable)
            longest = min(self.model.horizon, self.test.max_horizon)
            lengths = (*(share * length for share in JUDGED_SHARES), longest)
        return tuple(score(self.model, theta, self.test, self.test_sigma, length) for length in lengths)


def is_supported(evidence: Evidence, p_search: float) -> bool:
    """Both kinds of data must speak for a step, each by itself and both together."""
    if evidence.delta_bic >= NEEDED_BIC or evidence.heldout_loglik_gain <= 0 or evidence.p_value >= ALPHA:
        return False
    both = -2.0 * (np.log(max(p_search, TRUSTED)) + np.log(max(evidence.p_value, 1e-300)))
    return bool(stats.chi2.sf(both, 4) < TOGETHER)


def is_far_likelier(fitted: Fitted, rival: Fitted) -> bool:
    """Whether the searched data speak very strongly for one fit over another on the same windows."""
    effective = min(effective_samples(fitted), effective_samples(rival))
    return bic(fitted, effective) - bic(rival, effective) < NEEDED_BIC
