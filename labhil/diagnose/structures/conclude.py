"""What a search over structures ends in: named terms, curves that are likelier, and scores on held-out data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from labhil.diagnose.conclude import Concluded, leaves_more
from labhil.diagnose.found import Found
from labhil.diagnose.judge import Data
from labhil.diagnose.structures.curves import CurveSearch, FittedCurve
from labhil.diagnose.structures.search import on_windows
from labhil.diagnose.unmodelled import Unmodelled, stated, with_placed
from labhil.identify.fitted import Fitted, fit_terms
from labhil.identify.noise import lasting_noise
from labhil.identify.score import score, scored_horizon
from labhil.identify.windows import noise_of
from labhil.physics.extra_force import Yielding
from labhil.signals import FloatArray

CURVE_WINDOW = 1.5
"""Scored horizons of the windows on which curves are weighed: on longer ones few are linear enough."""


def conclude(data: Data, found: Found, left: FloatArray, progress: Callable[[str], None]) -> Concluded:
    """Weigh forces without a name against what was named, and score both on held-out data."""
    curves = tuple[Unmodelled, ...]()
    if found.complete:
        progress("a force over each coordinate in turn, instead of what is named and beside it")
        found, curves = _with_curves(data, found)
    progress("scores, intervals and exclusion limits")
    model, theta = data.model, found.final.theta
    horizon = scored_horizon(model, theta, data.test)
    noise = lasting_noise(model, theta, data.test, noise_of(data.test))
    marked = partial(score, record=data.test, sigma=noise.sigma, horizon=horizon, lasts=noise.lasts)
    before = marked(model, found.baseline.theta)
    after = marked(model, theta) if found.missing else before
    more = leaves_more(data, found, left, after.excess)
    end = Concluded(data, found, curves, more, before, after, noise.sigma)
    return replace(end, after=marked(*end.accepted)) if curves else end


def _with_curves(data: Data, found: Found) -> tuple[Found, tuple[Unmodelled, ...]]:
    """What is named beside the likeliest curve, and that curve; all that is named where none is likelier."""
    model = data.model
    if not isinstance(model, Yielding) or not model.state_names:
        return found, ()
    correlation = lasting_noise(model, found.baseline.theta, data.search, data.sigma).correlation
    shorter = replace(data, window=min(CURVE_WINDOW * model.horizon, data.search.longest))
    search = CurveSearch(shorter, found.baseline.terms, correlation)
    fitted = on_windows(shorter, found.final)
    best: FittedCurve | None = None
    for begin in with_placed(fitted):
        seen = begin.problem.model
        assert isinstance(seen, Yielding)
        for part in seen.moved:
            trial = search.run(begin, part)
            if trial is not None and (best is None or trial.log_odds > best.log_odds):
                best = trial
    if best is None:
        return found, ()
    steps = tuple(step for step in found.missing if step.terms[0] in best.beside.terms)
    kept = found.ending(_unplaced(shorter, best.beside), steps)
    return kept, (stated(shorter, best.beside, best.curved, best.log_odds),)


def _unplaced(data: Data, beside: Fitted) -> Fitted:
    """The fit beside a curve, of the model that other results are of."""
    if beside.problem.model is data.model:
        return beside
    return fit_terms(
        data.model, data.search, beside.terms, data.window, data.sigma, start=beside.theta, starts=[{}],
        held=data.held,
    )  # fmt: skip
