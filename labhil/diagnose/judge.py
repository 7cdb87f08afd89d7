"""The data of a structure search, and the test that decides whether they support an added term.

A term needs very strong evidence on the search data (BIC), a gain on held-out data, and both together
(Fisher's method). The figures that are tested come from ``evidence.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from labhil.diagnose.evidence import Evidence, bic, effective_samples
from labhil.identify.fitted import Fitted
from labhil.identify.score import Score, score
from labhil.physics.model import Model
from labhil.physics.record import Record
from labhil.signals import FloatArray

VERY_STRONG_DELTA_BIC = -10.0
"""ΔBIC of very strong evidence: twice the log of a Bayes factor of 150 (Kass and Raftery, J. Am. Stat. Assoc.
90, 1995)."""

ALPHA = 0.1
"""One-sided level α of the held-out test of a single term."""

COMBINED_ALPHA = 5e-4
"""Level α of the tests on search and held-out data combined."""

SEARCH_P_VALUE_FLOOR = 1e-6
"""Smallest p value of the search data that counts: the assumed distribution of the noise is approximate."""


@dataclass(frozen=True, slots=True)
class Data:
    """What a structure search works on.

    Attributes:
        model: the model with all terms that may be added.
        search: the recordings that terms are fitted to and chosen on.
        test: the held-out recordings.
        sigma: standard deviation of the noise of each output of ``search``, (c,), SI units.
        test_sigma: the same of ``test``, (c,).
        window: length of the windows that are simulated, s.
        begin: parameter vector at which fits start.
        held: keys of the parameters that stay at their start values.
    """

    model: Model
    search: Record
    test: Record
    sigma: FloatArray
    test_sigma: FloatArray
    window: float
    begin: FloatArray
    held: frozenset[str] = frozenset()

    def score_held_out(
        self,
        theta: FloatArray,
        *,
        length_in_search_windows: float = 4.0 / 3.0,
        min_windows: int = 10,
        max_share_of_recording: float = 0.5,
        relative_lengths: Sequence[float] = (1.0, 0.25),
    ) -> tuple[Score, ...]:
        """Score a model on the held-out data, on windows of several lengths.

        Effects that act slowly show on long windows, those that act fast and often on many short ones.

        Args:
            theta: parameter vector of the model.
            length_in_search_windows: length of a window over that of the search's windows.
            min_windows: number of windows that the held-out data have to hold; else windows are shorter.
            max_share_of_recording: largest share of the shortest recording that one window may take; its
                lead-in comes on top.
            relative_lengths: lengths that are scored, over the one that follows from the above.

        Returns:
            A score for each length, then one on windows of the metric's length; a single score where the
            model has no states (inverse dynamics).
        """
        if not self.model.state_names:
            return (self.score_on_metric(theta),)
        durations = self.test.durations
        countable = min(sum(durations) / min_windows, max_share_of_recording * min(durations))
        length = min(length_in_search_windows * self.window, countable)
        shorter = (
            score(self.model, theta, self.test, self.test_sigma, share * length) for share in relative_lengths
        )
        return (*shorter, self.score_on_metric(theta))

    def score_on_metric(self, theta: FloatArray) -> Score:
        """Score a model on the held-out data, on windows of the metric's length.

        Args:
            theta: parameter vector of the model.
        """
        longest = min(self.model.horizon, self.test.max_horizon) if self.model.state_names else None
        return score(self.model, theta, self.test, self.test_sigma, longest)


def is_supported(
    evidence: Evidence,
    p_search: float,
    *,
    max_delta_bic: float = VERY_STRONG_DELTA_BIC,
    alpha: float = ALPHA,
    combined_alpha: float = COMBINED_ALPHA,
    min_p_search: float = SEARCH_P_VALUE_FLOOR,
) -> bool:
    """Decide whether search and held-out data support an addition, each alone and both together.

    Args:
        evidence: ΔBIC on the search data, gain and p value on the held-out data.
        p_search: p value on the search data, corrected for the number of candidates.
        max_delta_bic: ΔBIC below which the search data support it.
        alpha: level of the held-out test.
        combined_alpha: level of both p values combined by Fisher's method.
        min_p_search: smallest p value of the search data that counts.

    Returns:
        True if all tests support the addition.
    """
    if evidence.delta_bic >= max_delta_bic or evidence.heldout_loglik_gain <= 0 or evidence.p_value >= alpha:
        return False
    fisher = -2.0 * (np.log(max(p_search, min_p_search)) + np.log(max(evidence.p_value, 1e-300)))
    return bool(stats.chi2.sf(fisher, 4) < combined_alpha)


def is_strongly_favoured(
    fitted: Fitted, rival: Fitted, *, max_delta_bic: float = VERY_STRONG_DELTA_BIC
) -> bool:
    """Decide whether the search data very strongly favour a fit over another one on the same windows.

    Args:
        fitted: the fit in question.
        rival: the fit that it is compared with.
        max_delta_bic: BIC of the fit less that of the rival below which the evidence is very strong.

    Returns:
        True if the difference is below the limit.
    """
    effective = min(effective_samples(fitted), effective_samples(rival))
    return bic(fitted, effective) - bic(rival, effective) < max_delta_bic
