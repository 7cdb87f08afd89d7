"""The conclusion of a structure search: scores on held-out data, and whether more than noise remains.

``conclude`` is called by ``diagnosis.py`` once the search has ended; ``adequacy.py`` tests the residuals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from labhil.diagnose.adequacy import MAX_RMS_IN_NOISE, exceeds_noise, residual_rms
from labhil.diagnose.force_curve import ForceCurve, state_curve
from labhil.diagnose.joint_curves import fit_joint_curves
from labhil.diagnose.judge import Data
from labhil.diagnose.search_result import SearchResult
from labhil.identify.noise import estimate_coloured_noise
from labhil.identify.score import Score, score, scored_horizon
from labhil.identify.windows import noise_of
from labhil.physics.model import Metric, Model
from labhil.signals import FloatArray

DOUBTFUL_EXCESS = 1.5
"""RMSE over the noise floor from which the named terms are doubtful.

The floor of a few windows is uncertain: each window has only one error of its initial state.
"""


@dataclass(frozen=True, slots=True)
class Conclusion:
    """The end of a search: its result, force curves beside it, and the error that remains.

    Attributes:
        data: the data of the search.
        result: its named terms and rivals.
        curves: forces that no named term explains; of an arm one for each joint that has one.
        excess_remains: whether the final model leaves more than noise.
        before: score of the baseline on held-out data.
        after: score of the final model on the same windows, with the same noise.
        sigma: standard deviation of that noise, (c,).
    """

    data: Data
    result: SearchResult
    curves: tuple[ForceCurve, ...]
    excess_remains: bool
    before: Score
    after: Score
    sigma: FloatArray

    @property
    def accepted(self) -> tuple[Model, FloatArray]:
        """The final model and its parameter vector; the last curve was fitted beside all others."""
        if self.curves:
            return self.curves[-1].model, self.curves[-1].fit.theta
        return self.data.model, self.result.final.theta

    @property
    def claims(self) -> tuple[str, ...]:
        """Keys of the named terms, and names of the curves."""
        return (*(step.terms[0] for step in self.result.missing), *(curve.term for curve in self.curves))

    @property
    def claims_together(self) -> int:
        """Number of claims that stand or fall together; each joint of an arm has its own."""
        return 1 if self.data.model.metric is Metric.INVERSE_DYNAMICS else len(self.claims)

    @property
    def on_shorter_windows(self) -> tuple[Score, Score] | None:
        """Scores before and after on windows of the search; None unless the metric's error has grown.

        Noise that drives the plant itself exceeds the error of every model on long windows.
        """
        data, result = self.data, self.result
        if not result.missing or self.after.rmse < self.before.rmse or not data.model.state_names:
            return None
        return data.score_held_out(result.baseline.theta)[0], data.score_held_out(result.final.theta)[0]

    @property
    def predicts_worse(self) -> bool:
        """Whether held-out errors have grown on windows of the metric and on those of the search.

        A term may predict better on windows of some other length alone: a lag of 2 s makes any output smooth.
        No model counts as an answer that predicts worse than the one it replaces.
        """
        shorter = self.on_shorter_windows
        return shorter is not None and shorter[1].rmse >= shorter[0].rmse

    @property
    def explains_nothing(self) -> bool:
        """Whether the named effects leave more than noise, and an error on held-out data that is no smaller.

        They may be the best that the catalogue has for something else: what drives a rig unrecorded.
        """
        return bool(self.claims) and self.excess_remains and self.after.rmse >= self.before.rmse


@dataclass(frozen=True, slots=True)
class HeldOutScores:
    """Scores of baseline and final model on held-out data, on the same windows with the same noise.

    Attributes:
        before: score of the baseline.
        after: score of the final model.
        sigma: standard deviation of the noise, (c,).
        score_of: scores any other model, by its parameter vector, in the same way.
    """

    before: Score
    after: Score
    sigma: FloatArray
    score_of: Callable[[Model, FloatArray], Score]

    @classmethod
    def of(cls, data: Data, result: SearchResult) -> HeldOutScores:
        """Score the result of a search."""
        model, theta = data.model, result.final.theta
        horizon = scored_horizon(model, theta, data.test)
        noise = estimate_coloured_noise(model, theta, data.test, noise_of(data.test))
        score_of = partial(
            score,
            record=data.test,
            sigma=noise.sigma,
            horizon=horizon,
            variance_inflation=noise.variance_inflation,
        )
        before = score_of(model, result.baseline.theta)
        return cls(before, score_of(model, theta) if result.missing else before, noise.sigma, score_of)


def conclude(
    data: Data, result: SearchResult, rms: FloatArray, progress: Callable[[str], None]
) -> Conclusion:
    """Score the result of a search on held-out data, and fit force curves to the joints of an arm.

    Args:
        data: the data of the search.
        result: its result.
        rms: RMS of the final residuals on search and held-out data, (2, c), in units of the noise.
        progress: is called with a line of text at each stage.

    Returns:
        The conclusion; without claims where the final model predicts worse than the baseline.
    """
    progress("scores, intervals and exclusion limits")
    scores = HeldOutScores.of(data, result)
    more = more_than_noise_remains(data, result, rms, scores.after.excess)
    curves: tuple[ForceCurve, ...] = () if result.curve is None else (state_curve(data, result.curve),)
    if data.model.metric is Metric.INVERSE_DYNAMICS and result.complete:
        curves = fit_joint_curves(data, result)
    conclusion = Conclusion(data, result, curves, more, scores.before, scores.after, scores.sigma)
    if curves:
        conclusion = replace(conclusion, after=scores.score_of(*conclusion.accepted))
    return withdraw_claims(conclusion, progress)


def withdraw_claims(conclusion: Conclusion, progress: Callable[[str], None]) -> Conclusion:
    """Withdraw claims that held-out data refute, or that explain nothing of these.

    Args:
        conclusion: a conclusion with claims or without.
        progress: is called with a line of text at each stage.

    Returns:
        The conclusion of the same search without claims; the same conclusion where they may stay.
    """
    result = conclusion.result
    if not conclusion.curves and conclusion.predicts_worse:
        result = result.without_claims
    elif conclusion.explains_nothing:
        result = result.with_doubtful(conclusion.claims)
    else:
        return conclusion
    return conclude(conclusion.data, result, residual_rms(conclusion.data, result.final), progress)


def more_than_noise_remains(
    data: Data,
    result: SearchResult,
    rms: FloatArray,
    excess: float,
    *,
    certain_excess: float = 2.5,
    doubtful_excess: float = DOUBTFUL_EXCESS,
    supporting_excess: float = MAX_RMS_IN_NOISE,
) -> bool:
    """Decide whether the final model leaves more than noise, by its score and by its residuals.

    Coloured noise is not known well enough from short windows for the residuals to decide alone, unless they
    are larger than any noise makes them; and the score shows nothing where the held-out data are at rest.

    Args:
        data: the data of the search.
        result: its result.
        rms: RMS of the final residuals on search and held-out data, (2, c), in units of the noise.
        excess: RMSE over the noise floor on held-out data, of the worst output.
        certain_excess: RMSE or RMS, in units of the noise, that noise never reaches.
        doubtful_excess: RMSE that counts where terms were named.
        supporting_excess: RMSE that counts where residuals exceed the noise, too.

    Returns:
        True if more than noise remains.
    """
    score_limit = doubtful_excess if result.missing else certain_excess
    max_rms = float(np.max(rms))
    return (
        excess > score_limit
        or max_rms > certain_excess
        or (exceeds_noise(data, rms) and excess > supporting_excess)
    )
