"""What a search over structures ends in: named terms or a curve, with scores on held-out data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from labhil.diagnose.conclude import Concluded, concluded, leaves_more
from labhil.diagnose.found import Found
from labhil.diagnose.judge import Data
from labhil.diagnose.unmodelled import stated
from labhil.identify.noise import lasting_noise
from labhil.identify.score import score, scored_horizon
from labhil.identify.windows import noise_of
from labhil.signals import FloatArray


def conclude(data: Data, found: Found, left: FloatArray, progress: Callable[[str], None]) -> Concluded:
    """Score what was found on held-out data, before and after on the same windows and of the same noise."""
    if not data.model.state_names:  # of inverse dynamics every joint has its own curve, by linear algebra
        return concluded(data, found, left, progress)
    progress("scores, intervals and exclusion limits")
    model, theta = data.model, found.final.theta
    horizon = scored_horizon(model, theta, data.test)
    noise = lasting_noise(model, theta, data.test, noise_of(data.test))
    marked = partial(score, record=data.test, sigma=noise.sigma, horizon=horizon, lasts=noise.lasts)
    before = marked(model, found.baseline.theta)
    after = marked(model, theta) if found.missing else before
    more = leaves_more(data, found, left, after.excess)
    curves = () if found.curve is None else (stated(data, found.curve),)
    end = Concluded(data, found, curves, more, before, after, noise.sigma)
    return replace(end, after=marked(*end.accepted)) if curves else end
