"""What is concluded from a search: do held-out data bear it out, and does it leave more than noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from labhil.diagnose.beyond import MISNAMED, SURELY, beyond, imitated
from labhil.diagnose.found import Found
from labhil.diagnose.judge import Data
from labhil.diagnose.rest import UNEXPLAINED, left_by, unexplained
from labhil.diagnose.search import on_several_windows
from labhil.diagnose.unmodelled import Unmodelled
from labhil.identify.noise import lasting_noise
from labhil.identify.score import Score, score, scored_horizon
from labhil.identify.windows import noise_of
from labhil.physics.model import Metric, Model
from labhil.signals import FloatArray

NOTICED, NOTICEABLY, BEYOND_DOUBT = 1.05, 1.02, -50.0
"""What the metric does not show asks for more evidence: where the baseline leaves fewer than so many noise
floors of held-out data, and no error is so many times larger without what was found, this ΔBIC.

Noise is never quite what it is taken for: the rounding of a part that rests at a stop is the same each time.
"""


@dataclass(frozen=True, slots=True)
class Concluded:
    """Where a search ended: what was found, forces without a name beside it, and what is left.

    ``before`` and ``after`` are scores on the same windows and of the same noise ``sigma`` (c,); ``more``
    says that more than noise is left by what has a name.
    """

    data: Data
    found: Found
    curves: tuple[Unmodelled, ...]
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
    def of(cls, data: Data, found: Found) -> HeldOutScores:
        """Those of a search; ``of_model`` scores any other model likewise."""
        model, theta = data.model, found.final.theta
        horizon = scored_horizon(model, theta, data.test)
        noise = lasting_noise(model, theta, data.test, noise_of(data.test))
        marked = partial(score, record=data.test, sigma=noise.sigma, horizon=horizon, lasts=noise.lasts)
        before = marked(model, found.baseline.theta)
        return cls(before, marked(model, theta) if found.missing else before, noise.sigma, marked)


def concluded(data: Data, found: Found, left: FloatArray, progress: Callable[[str], None]) -> Concluded:
    """Judge what was found on held-out data, and look for a force without a name where that is not enough."""
    progress("scores, intervals and exclusion limits")
    model, marked = data.model, HeldOutScores.of(data, found)
    before, after = marked.before, marked.after
    if found.missing and _unnoticed(found, before, after):
        found, after, left = found.nothing, before, left_by(data, found.baseline)
    more = leaves_more(data, found, left, after.excess)
    if not found.complete:
        return Concluded(data, found, (), more, before, after, marked.sigma)
    if more:
        progress("a force over each coordinate in turn, for no named effect explains the rest")
    look = beyond if more or model.metric is Metric.INVERSE_DYNAMICS else imitated
    several = on_several_windows(data, found)
    kept, curves = look(data, several, after.excess)
    kept = found if kept is several and not curves else kept
    end = Concluded(data, kept, curves, more, before, after, marked.sigma)
    return replace(end, after=marked.of_model(*end.accepted)) if curves or kept is not found else end


def _unnoticed(found: Found, before: Score, after: Score) -> bool:
    """Whether the metric shows no mismatch, and the searched data not beyond doubt."""
    weak = all(step.evidence.delta_bic > BEYOND_DOUBT for step in found.missing)
    pairs = zip(before.channels, after.channels, strict=True)
    better = any(one.rmse > NOTICEABLY * other.rmse for one, other in pairs)
    return weak and not better and before.excess < NOTICED


def leaves_more(data: Data, found: Found, left: FloatArray, excess: float) -> bool:
    """Whether more than noise is left: by the metric alone, or by windows that know their states and it.

    Noise that lasts is not known so well from short windows that these alone could raise an alarm.
    """
    alone = MISNAMED if found.missing else SURELY
    return excess > alone or (unexplained(data, left) and excess > UNEXPLAINED)
