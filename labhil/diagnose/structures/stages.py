"""From short windows to long ones: a search on each, the claims at the end, and a curve."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from labhil.cores import side_by_side
from labhil.diagnose.collapsed import far_from_nominal
from labhil.diagnose.judge import Data
from labhil.diagnose.refit import refit_on_windows
from labhil.diagnose.search_result import SearchResult
from labhil.diagnose.structures.claims import Stage, conclude_search, predicts_better, validate_claims
from labhil.diagnose.structures.curves import CurveSearch
from labhil.diagnose.structures.disturbance import noise_beside
from labhil.diagnose.structures.enumerate import candidates
from labhil.diagnose.structures.search import OUTWEIGHED, Options, Progress, StructureSearch
from labhil.ending import EndedEarly, accept
from labhil.identify.fitted import Fitted, fit_terms
from labhil.identify.noise import MOST
from labhil.identify.windows import noise_of
from labhil.physics.extra_force import AcceptsExtraForce
from labhil.physics.model import Metric
from labhil.signals import FloatArray

CURVE_WINDOW = 1.5
"""Scored horizons of the windows on which curves are weighed: on longer ones few are linear enough."""


def search_structures(
    data: Data, baseline: Fitted, progress: Progress, options: Options | None = None
) -> SearchResult:
    """Find the likeliest terms beside a fitted baseline, by one evidence."""
    options = options or Options()
    data, correlation = _in_noise_beside(data, baseline)
    finished: list[Stage] = []
    complete = True
    try:
        nominal = {size.key: size.nominal for size in far_from_nominal(data, baseline)}
        for length in _lengths(data, options):
            begin = [baseline]
            if finished:
                begin = finished[-1].leading
                data, correlation = _in_noise_beside(data, finished[-1].best)
            stage = replace(data, window=length)
            begin = list(side_by_side(partial(refit_on_windows, stage), begin))
            search = StructureSearch(stage, baseline.terms, correlation, progress, options, nominal)
            finished.append(Stage(stage, search.run(begin)))
            if finished[-1].best.noise > OUTWEIGHED:
                break
    except EndedEarly:
        accept()
        complete = False
    looks = len(candidates(data.model, baseline.terms))
    if not finished:
        return SearchResult(baseline, baseline, (), (), 1.0, looks, complete=False)
    result = replace(conclude_search(finished[-1], options.claim, looks), complete=complete)
    if result.missing and not predicts_better(
        *(data.score_held_out(f.theta) for f in (result.baseline, result.final))
    ):
        result = result.without_claims
    result = validate_claims(finished[-1], result)
    return _with_curve(data, result, finished[-1].data.window, correlation, progress) if complete else result


def _lengths(data: Data, options: Options) -> list[float]:
    """Length (s) of the windows of each stage; inverse dynamics has no windows and one stage."""
    if not data.model.state_names:
        return [data.window]
    return list(dict.fromkeys(min(h * data.model.horizon, data.search.longest) for h in options.horizons))


def _in_noise_beside(data: Data, fitted: Fitted) -> tuple[Data, FloatArray]:
    """The data in units of the noise beside what a fit lacks, and the noise's correlation (c,)."""
    if not data.model.state_names:
        return data, np.zeros(len(data.sigma))
    noise = noise_beside(fitted.problem, fitted.solution.residuals)
    least = noise_of(data.search)
    return replace(data, sigma=np.clip(noise.sigma, least, MOST * least)), noise.correlation


def _with_curve(
    data: Data, result: SearchResult, longest: float, correlation: FloatArray, progress: Progress
) -> SearchResult:
    """The terms beside the likeliest curve, and the curve; all terms where no curve is likelier."""
    model = data.model
    if not isinstance(model, AcceptsExtraForce) or model.metric is Metric.INVERSE_DYNAMICS:
        return result
    progress("a force over each coordinate in turn, instead of what is named and beside it")
    shorter = replace(data, window=min(CURVE_WINDOW * model.horizon, longest))
    curve = CurveSearch(shorter, result.baseline.terms, correlation).run(
        refit_on_windows(shorter, result.final)
    )
    if curve is None:
        return result
    extended = replace(data, model=curve.curve_fit.model)
    if not predicts_better(
        data.score_held_out(result.final.theta), extended.score_held_out(curve.curve_fit.fitted.theta)
    ):
        return result
    steps = tuple(step for step in result.missing if step.terms[0] in curve.beside.terms)
    # structures without a curve are no alternatives to one that is so much likelier
    return replace(
        result.with_steps(_refit_without_places(shorter, curve.beside), steps), curve=curve, alternatives=()
    )


def _refit_without_places(data: Data, beside: Fitted) -> Fitted:
    """Refit the terms beside a curve with the search's own model, whose windows do not know the place."""
    if len(beside.problem.model.state_names) == len(data.model.state_names):
        return beside
    return fit_terms(
        data.model, data.search, beside.terms, data.window, data.sigma, start=beside.theta, starts=[{}],
        held=data.held,
    )  # fmt: skip
