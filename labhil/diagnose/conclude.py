"""What is concluded from a search: do held-out data bear it out, and does it leave more than noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from labhil.diagnose.adequacy import UNEXPLAINED, unexplained
from labhil.diagnose.force_curve import ForceCurve, stated
from labhil.diagnose.joint_curves import joint_curves
from labhil.diagnose.judge import Data
from labhil.diagnose.search_result import SearchResult
from labhil.identify.noise import estimate_coloured_noise
from labhil.identify.score import Score, score, scored_horizon
from labhil.identify.windows import noise_of
from labhil.physics.model import Metric, Model
from labhil.signals import FloatArray

SURELY, MISNAMED = 2.5, 1.5
"""RMSE over the noise floor that no noise makes, and that doubts what was found.

The floor of a few windows is not well known: each has only one error of its initial state.
"""


@dataclass(frozen=True, slots=True)
class Concluded:
    """Where a search ended: what was found, forces without a name beside it, and what is left.

    ``before`` and ``after`` are scores on the same windows and of the same noise ``sigma`` (c,); ``more``
    says that more than noise is left by what has a name.
    """

    data: Data
    found: SearchResult
    curves: tuple[ForceCurve, ...]
    more: bool
    before: Score
    after: Score
    sigma: FloatArray

    @property
    def accepted(self) -> tuple[Model, FloatArray]:
        """The model that is left, with its vector; the last of the curves was found beside all others."""
        if self.curves:
            return self.curves[-1].model, self.curves[-1].fit.theta
        return self.data.model, self.found.final.theta

    @property
    def doubts(self) -> tuple[float, int]:
        """What speaks against a claim: the excess that stays, and how many there are; of an arm neither."""
        if self.data.model.metric is Metric.INVERSE_DYNAMICS:
            return 1.0, 1
        return self.after.excess, len(self.found.missing) + len(self.curves)

    @property
    def on_shorter_windows(self) -> tuple[Score, Score] | None:
        """Scores on windows of the search, if the metric's are worse with what was found than without.

        Noise that drives the plant itself outgrows every model on long windows.
        """
        data, found = self.data, self.found
        if not found.missing or self.after.rmse < self.before.rmse or not data.model.state_names:
            return None
        return data.judge(found.baseline.theta)[0], data.judge(found.final.theta)[0]


@dataclass(frozen=True, slots=True)
class HeldOutScores:
    """Scores on held-out data ``before`` and ``after``, on the same windows and of the same noise (c,)."""

    before: Score
    after: Score
    sigma: FloatArray
    of_model: Callable[[Model, FloatArray], Score]

    @classmethod
    def of(cls, data: Data, found: SearchResult) -> HeldOutScores:
        """Those of a search; ``of_model`` scores any other model likewise."""
        model, theta = data.model, found.final.theta
        horizon = scored_horizon(model, theta, data.test)
        noise = estimate_coloured_noise(model, theta, data.test, noise_of(data.test))
        marked = partial(score, record=data.test, sigma=noise.sigma, horizon=horizon, lasts=noise.lasts)
        before = marked(model, found.baseline.theta)
        return cls(before, marked(model, theta) if found.missing else before, noise.sigma, marked)


def conclude(data: Data, found: SearchResult, left: FloatArray, progress: Callable[[str], None]) -> Concluded:
    """Score what was found on held-out data, before and after on the same windows and of the same noise.

    Of inverse dynamics every joint that still leaves much has a curve of its own, by linear algebra.
    """
    progress("scores, intervals and exclusion limits")
    marked = HeldOutScores.of(data, found)
    more = leaves_more(data, found, left, marked.after.excess)
    curves: tuple[ForceCurve, ...] = () if found.curve is None else (stated(data, found.curve),)
    if data.model.metric is Metric.INVERSE_DYNAMICS and found.complete:
        curves = joint_curves(data, found)
    end = Concluded(data, found, curves, more, marked.before, marked.after, marked.sigma)
    return replace(end, after=marked.of_model(*end.accepted)) if curves else end


def leaves_more(data: Data, found: SearchResult, left: FloatArray, excess: float) -> bool:
    """Whether more than noise is left: by the metric alone, or by windows that know their states and it.

    Noise that lasts is not known so well from short windows that these alone could raise an alarm, unless
    they leave as much as no noise does: the metric is silent where the held-out data are at rest.
    """
    alone = MISNAMED if found.missing else SURELY
    by_windows = float(np.max(left))
    return excess > alone or by_windows > SURELY or (unexplained(data, left) and excess > UNEXPLAINED)
