"""Sequence of structure searches on windows of increasing length, then the claims and a nonparametric force.

`search_structures` is the entry point of this package. Read on in search.py, claims.py and curves.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from labhil.diagnose.collapsed import far_from_nominal
from labhil.diagnose.judge import Data, is_strongly_favoured
from labhil.diagnose.refit import refit_on_windows
from labhil.diagnose.search_result import SearchResult
from labhil.diagnose.structures.claims import Stage, conclude_search, predicts_better, refute, validate_claims
from labhil.diagnose.structures.curves import CurveSearch
from labhil.diagnose.structures.disturbance import estimate_spectral_noise
from labhil.diagnose.structures.prior import candidates
from labhil.diagnose.structures.search import Progress, SearchOptions, StructureSearch
from labhil.ending import EndedEarly, accept
from labhil.identify.fitted import Fitted, fit_terms
from labhil.identify.noise import MAX_NOISE_RATIO
from labhil.identify.predictability import predictability_horizon
from labhil.identify.windows import noise_of
from labhil.physics.extra_force import AcceptsExtraForce
from labhil.physics.model import Metric
from labhil.signals import FloatArray


def search_structures(
    data: Data,
    baseline: Fitted,
    progress: Progress,
    options: SearchOptions | None = None,
    *,
    others: Sequence[Fitted] = (),
    rival: Fitted | None = None,
) -> SearchResult:
    """Find the terms that a fitted baseline lacks, by Bayesian model comparison.

    Args:
        data: searched and held-out data, and the model with all terms.
        baseline: fit of the baseline to the searched data.
        progress: is called with a line of text before each step.
        options: options of the search; None for the defaults.
        others: fits of further structures to begin with.
        rival: a fit that the result has to beat. Where the short windows very strongly favour it, the search
            ends with them, without a nonparametric force.

    Returns:
        The claimed terms with evidence, the final fit, rivals, alternatives, and a nonparametric force where
        one is more probable. Incomplete where the search was ended early.
    """
    options = options or SearchOptions()
    data, correlation = _with_estimated_noise(data, baseline)
    finished: list[Stage] = []
    complete, lost = True, False
    try:
        nominal = {size.key: size.nominal for size in far_from_nominal(data, baseline)}
        for wanted in _window_lengths(data, options):
            begin, length = [baseline, *others], wanted
            if finished:
                begin, theta = finished[-1].leading_fits(), finished[-1].best.theta
                data, correlation = _with_estimated_noise(data, finished[-1].best)
                length = predictability_horizon(data.model, theta, data.search, data.sigma, wanted)
                if length <= finished[-1].data.window:
                    break
            stage = replace(data, window=length)
            begin = list(baseline.problem.side_by_side(partial(refit_on_windows, stage), begin))
            search = StructureSearch(stage, baseline.terms, correlation, progress, options, nominal)
            finished.append(Stage(stage, search.run(begin)))
            if finished[-1].best.noise > options.max_residual_in_noise:
                refute(finished[-1])
            lost = rival is not None and _is_beaten(finished[-1], rival)
            # where something is named, longer windows add up what is missing beside it; else they may show it
            named = finished[-1].state.best and finished[-1].best.noise > options.max_residual_in_noise
            if lost or named:
                break
    except EndedEarly:
        accept()
        complete = False
    n_candidates = len(candidates(data.model, baseline.terms))
    if not finished:
        return SearchResult(baseline, baseline, (), (), 1.0, n_candidates, complete=False)
    result = None
    try:
        result = _validated_claims(finished[-1], options, n_candidates)
        if complete and not lost:
            return _with_force_curve(data, result, finished[-1].data.window, correlation, progress)
    except EndedEarly:
        accept()
        complete = False
    return replace(result or _validated_claims(finished[-1], options, n_candidates), complete=complete)


def _is_beaten(stage: Stage, rival: Fitted) -> bool:
    """Whether a rival with all sizes free is very strongly favoured over the best structure of a stage."""
    free = replace(stage.data, held=frozenset())
    return is_strongly_favoured(refit_on_windows(free, rival), stage.best)


def _validated_claims(stage: Stage, options: SearchOptions, n_candidates: int) -> SearchResult:
    """What a stage claims, as far as held-out data bear it out."""
    result = conclude_search(stage, options.min_log_odds, n_candidates)
    before, after = (stage.data.score_held_out(fit.theta) for fit in (result.baseline, result.final))
    if result.missing and not predicts_better(before, after):
        result = result.without_claims
    return validate_claims(stage, result)


def _window_lengths(data: Data, options: SearchOptions) -> list[float]:
    """Length of the windows of each stage in s; one stage for inverse dynamics, which has no states."""
    if not data.model.state_names:
        return [data.window]
    return list(
        dict.fromkeys(min(h * data.model.horizon, data.search.longest) for h in options.window_horizons)
    )


def _with_estimated_noise(data: Data, fitted: Fitted) -> tuple[Data, FloatArray]:
    """The data with noise levels estimated from a fit's residuals, and the noise's autocorrelation (c,)."""
    if not data.model.state_names:
        return data, np.zeros(len(data.sigma))
    noise = estimate_spectral_noise(fitted.problem, fitted.solution.residuals)
    smallest = noise_of(data.search)
    return replace(data, sigma=np.clip(noise.sigma, smallest, MAX_NOISE_RATIO * smallest)), noise.correlation


def _with_force_curve(
    data: Data,
    result: SearchResult,
    longest_window: float,
    correlation: FloatArray,
    progress: Progress,
    *,
    window_in_horizons: float = 1.5,
) -> SearchResult:
    """The result with the most probable nonparametric force; unchanged if terms alone are more probable.

    Args:
        data: the data of the search.
        result: its result.
        longest_window: length in s of the windows of the last stage.
        correlation: (c,), autocorrelation of the noise.
        progress: is called with a line of text.
        window_in_horizons: length of the windows in scored horizons; on longer ones responses are
            rarely linear enough.
    """
    model = data.model
    if not isinstance(model, AcceptsExtraForce) or model.metric is Metric.INVERSE_DYNAMICS:
        return result
    progress("a force over each coordinate in turn, next to the named terms or instead of them")
    shorter = replace(data, window=min(window_in_horizons * model.horizon, longest_window))
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
    # structures without a curve are far less probable, and no alternatives
    return replace(
        result.with_steps(_refit_without_position_state(shorter, curve.beside), steps),
        curve=curve,
        alternatives=(),
    )


def _refit_without_position_state(data: Data, beside: Fitted) -> Fitted:
    """Refit the terms next to a curve with the search's own model, without a state for the position."""
    if len(beside.problem.model.state_names) == len(data.model.state_names):
        return beside
    return fit_terms(
        data.model, data.search, beside.terms, data.window, data.sigma, start=beside.theta, starts=[{}],
        held=data.held,
    )  # fmt: skip
