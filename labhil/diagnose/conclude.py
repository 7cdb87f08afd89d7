"""The conclusion of a search: do held-out data bear it out, and does it leave more than noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from labhil.diagnose.adequacy import UNEXPLAINED, exceeds_noise
from labhil.diagnose.force_curve import ForceCurve, state_curve
from labhil.diagnose.joint_curves import joint_curves
from labhil.diagnose.judge import Data
from labhil.diagnose.search_result import SearchResult
from labhil.identify.noise import estimate_coloured_noise
from labhil.identify.score import Score, score, scored_horizon
from labhil.identify.windows import noise_of
from labhil.physics.model import Metric, Model
from labhil.signals import FloatArray

SURELY, MISNAMED = 2.5, 1.5
"""RMSE over the noise floor that no noise makes, and from which named terms are doubted.

The floor of a few windows is not well known: each has only one error of its initial state.
"""


@dataclass(frozen=True, slots=True)
class Conclusion:
    """Where a search ended: its result, forces without a name beside it, and the error that remains.

    ``before`` and ``after`` are scores on the same windows and of the same noise ``sigma`` (c,);
    ``excess_remains`` says that named terms leave more than noise.
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
        """The final model with its vector; the last of the curves was fitted beside all others."""
        if self.curves:
            return self.curves[-1].model, self.curves[-1].fit.theta
        return self.data.model, self.result.final.theta

    @property
    def doubts(self) -> tuple[float, int]:
        """What speaks against a claim: the remaining excess and the number of claims; of an arm neither."""
        if self.data.model.metric is Metric.INVERSE_DYNAMICS:
            return 1.0, 1
        return self.after.excess, len(self.result.missing) + len(self.curves)

    @property
    def on_shorter_windows(self) -> tuple[Score, Score] | None:
        """Scores on windows of the search, if the metric's are worse with the named terms than without.

        Noise that drives the plant itself outgrows every model on long windows.
        """
        data, result = self.data, self.result
        if not result.missing or self.after.rmse < self.before.rmse or not data.model.state_names:
            return None
        return data.judge(result.baseline.theta)[0], data.judge(result.final.theta)[0]


@dataclass(frozen=True, slots=True)
class HeldOutScores:
    """Scores on held-out data ``before`` and ``after``, on the same windows and of the same noise (c,)."""

    before: Score
    after: Score
    sigma: FloatArray
    of_model: Callable[[Model, FloatArray], Score]

    @classmethod
    def of(cls, data: Data, result: SearchResult) -> HeldOutScores:
        """The scores of a search's result; ``of_model`` scores any other model likewise."""
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
    """Score a result on held-out data, before and after on the same windows and of the same noise.

    Of inverse dynamics every joint that still leaves much has a curve of its own, by linear algebra.
    """
    progress("scores, intervals and exclusion limits")
    scores = HeldOutScores.of(data, result)
    more = leaves_more(data, result, rms, scores.after.excess)
    curves: tuple[ForceCurve, ...] = () if result.curve is None else (state_curve(data, result.curve),)
    if data.model.metric is Metric.INVERSE_DYNAMICS and result.complete:
        curves = joint_curves(data, result)
    conclusion = Conclusion(data, result, curves, more, scores.before, scores.after, scores.sigma)
    return replace(conclusion, after=scores.of_model(*conclusion.accepted)) if curves else conclusion


def leaves_more(data: Data, result: SearchResult, rms: FloatArray, excess: float) -> bool:
    """Whether more than noise is left: by the metric alone, or by it and windows with fitted states.

    Noise that lasts is not known so well from short windows that these alone could raise an alarm, unless
    they leave as much as no noise does: the metric is silent where the held-out data are at rest.
    """
    alone = MISNAMED if result.missing else SURELY
    by_windows = float(np.max(rms))
    return excess > alone or by_windows > SURELY or (exceeds_noise(data, rms) and excess > UNEXPLAINED)
