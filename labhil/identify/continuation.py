"""Complete fits: start values, a global search where one is selected, and continuation over window lengths.

Single steps of these fits are in fitted.py; fit.py evaluates the results.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from labhil.ending import EndedEarly, accept
from labhil.identify.adequacy import MAX_EXPLAINED_RATIO
from labhil.identify.estimators import DEFAULT, INTERRUPTED, search
from labhil.identify.fitted import (
    INTERMEDIATE_TOLERANCE,
    MAX_RESIDUAL_GROWTH,
    Fitted,
    fit_briefly,
    fit_by_continuation,
    fit_terms,
    free_parameter_indices,
)
from labhil.identify.least_squares import TOLERANCE, search_lower_minima
from labhil.identify.predictability import predictability_horizon
from labhil.identify.problem import Problem
from labhil.identify.shapes import profile_shapes, refit_from_rivals
from labhil.identify.windows import fit_windows, noise_of
from labhil.physics.model import Model
from labhil.physics.record import Record
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.identify.fit import Options

SEARCHED_WINDOWS = 12
"""Number of windows, evenly spread, over which the default searches for a start; least squares take all."""

WINDOW_IN_HORIZONS = 1.5
"""Length of the longest fitted windows, in scored horizons."""


@dataclass(frozen=True, slots=True)
class RestartOptions:
    """Restarts of a global search, which may end in a local minimum.

    Attributes:
        max_searches: largest number of searches, each with another seed.
        explained_in_noise: RMS of the residuals in noise levels below which no other start could improve the
            fit notably, so that no further search is made.
        same_minimum_ratio: two searches whose residuals differ by less than this factor ended in the same
            minimum, so that no further search is made.
    """

    max_searches: int = 4
    explained_in_noise: float = 1.1
    same_minimum_ratio: float = 1.005


@dataclass(frozen=True, slots=True)
class FitTask:
    """A fit to make on windows of increasing length.

    Attributes:
        model: the model with all its terms.
        record: the data.
        terms: keys of the terms to fit.
        lengths: lengths of the windows in s, ascending.
        sigma: (channels,), noise of the channels.
        begin: (P,), parameters to start from, in SI units.
        new_terms: keys of terms that start at each of their own start values instead.
        options: estimator, seed and progress.
        restarts: restarts of a global search.
    """

    model: Model
    record: Record
    terms: Sequence[str]
    lengths: Sequence[float]
    sigma: FloatArray
    begin: FloatArray
    new_terms: Sequence[str]
    options: Options
    restarts: RestartOptions = RestartOptions()


def window_lengths(
    model: Model,
    record: Record,
    *,
    shares: tuple[float, ...] = (0.125, 0.25, 0.5, 1.0),
    min_extension: float = 2.0,
) -> list[float]:
    """Lengths of the windows on which a model is fitted in turn.

    Args:
        model: the model.
        record: the data.
        shares: lengths, in those of the longest windows, 1.5 scored horizons.
        min_extension: ratio of the longest recording to these from which a model with fading memory is fitted
            to whole recordings, too.

    Returns:
        Lengths in s, ascending.
    """
    lengths = [share * WINDOW_IN_HORIZONS * model.horizon for share in shares]
    longest = record.longest
    if model.fading_memory and longest > min_extension * lengths[-1]:
        lengths = [*lengths[1:], float(np.sqrt(lengths[-1] * longest)), longest]
    return lengths


def fit_on_growing_windows(task: FitTask) -> tuple[list[Fitted], bool]:
    """Fit on windows of increasing length, and refine the longest trusted fit in its lowest minimum.

    Args:
        task: what to fit.

    Returns:
        One fit for each length within which the model predicts its outputs (``predictability.py``), and True;
        the fits so far, and False, where the fit was ended early.
    """
    model, record, terms, lengths = task.model, task.record, task.terms, task.lengths
    progress = task.options.progress
    progress(f"fitting {len(terms)} terms on windows of {', '.join(f'{x:.3g}' for x in lengths)} s")
    fits: list[Fitted] = []
    try:
        fits.append(_fit_shortest_windows(task))
        progress("looking for other minima")
        fits[0] = first = profile_shapes(fits[0])
        horizon = predictability_horizon(model, first.theta, record, task.sigma, lengths[-1])
        longer: list[Fitted] = []
        try:
            fit_by_continuation(
                model,
                record,
                terms,
                [length for length in lengths[1:] if length <= horizon],
                task.sigma,
                start=first.theta,
                new_terms=(),
                reached=longer,
            )
        finally:
            fits += longer
        progress("looking for lower minima on the longest trusted windows")
        chosen = trusted_fit_index(fits, lengths, model.horizon)
        best = refit_from_rivals(fits[chosen], first.rivals) if chosen else first
        fits[chosen] = settle_fit(best)
    except EndedEarly as early:
        accept()
        if not fits:
            start = task.begin if early.theta is None else early.theta
            new = early.theta is None and bool(task.new_terms)
            fits.append(fit_briefly(model, record, terms, lengths[0], task.sigma, start, from_own_starts=new))
        return fits, False
    return fits, True


def fit_inverse_dynamics(
    model: Model, record: Record, terms: Sequence[str], begin: FloatArray
) -> tuple[list[Fitted], list[float]]:
    """Fit inverse dynamics to whole recordings, with channels weighted by their residuals.

    Args:
        model: a model of inverse dynamics.
        record: the data.
        terms: keys of the terms.
        begin: (P,), parameters to start from, in SI units.

    Returns:
        The fit and the length in s of its one window, each in a list.
    """
    length = record.longest
    sigma = noise_of(record)
    channels = len(sigma)
    fitted = fit_terms(model, record, terms, length, sigma, start=begin)
    for _ in range(2):
        spread = np.sqrt(np.mean(fitted.solution.residuals.reshape(-1, channels) ** 2, axis=0))
        sigma = sigma * np.maximum(spread, 1e-6)
        fitted = fit_terms(model, record, terms, length, sigma, start=fitted.theta, new_terms=())
    return [fitted], [length]


def _fit_shortest_windows(task: FitTask) -> Fitted:
    """The fit on the shortest windows: from the model's own starts, from a global search, or the better.

    The default estimator searches only where the model's own starts leave more than noise.
    """
    model, record, options = task.model, task.record, task.options
    shortest, longest = task.lengths[0], task.lengths[-1]
    tolerance = INTERMEDIATE_TOLERANCE if len(task.lengths) > 1 else TOLERANCE
    fit_from = partial(fit_terms, model, record, task.terms, shortest, task.sigma, tolerance=tolerance)
    if options.estimator == "nlse":
        return fit_from(start=task.begin, new_terms=task.new_terms)
    # short windows hardly determine widths; they are profiled afterwards
    fit_from = partial(fit_from, shapes=False)
    fits: list[Fitted] = []
    if options.estimator == DEFAULT:
        fits.append(fit_from(start=task.begin, new_terms=task.new_terms))
        if fits[0].noise < task.restarts.explained_in_noise:
            return fits[0]
    windows = fit_windows(record, longest if model.fading_memory else shortest)
    free = free_parameter_indices(model, task.terms)
    problem = Problem(model, record, windows, free, task.begin, task.sigma)
    try:
        scout = _search_and_scout(problem, fit_from, task)
        fits.append(fit_from(start=scout.theta, states=scout.solution.point.states, new_terms=()))
    except EndedEarly as early:
        early.theta = fits[0].theta if fits else early.theta
        raise
    best = min(fits, key=lambda fitted: fitted.solution.cost)
    best.problem.evaluations = (
        sum(fitted.problem.evaluations for fitted in (*fits, scout)) + problem.evaluations
    )
    return best


def _search_and_scout(problem: Problem, fit_from: Callable[..., Fitted], task: FitTask) -> Fitted:
    """Search globally, and make a short fit from the result, which shows whether the minimum is a good one.

    The default estimator repeats the search until two searches end in the best minimum, or one leaves only
    noise.
    """
    options, restarts = task.options, task.restarts
    scouts: list[Fitted] = []
    searched = problem.on_some_windows(SEARCHED_WINDOWS) if options.estimator == DEFAULT else problem
    for again in range(restarts.max_searches if options.estimator == DEFAULT else 1):
        options.progress(f"searching by {options.estimator}" + (", another seed" if again else ""))
        begin = search(searched, options.estimator, seed=options.seed + again, progress=options.progress)
        try:
            scouts.append(fit_from(start=begin.theta, new_terms=(), max_scout_cost=0.0))
        except EndedEarly as early:
            early.theta = scouts[0].theta if scouts else begin.theta
            raise
        noise = sorted(scout.noise for scout in scouts)
        agreed = again and noise[1] < restarts.same_minimum_ratio * noise[0]
        explained = noise[0] < restarts.explained_in_noise
        if explained or agreed or begin.search.stopped_because == INTERRUPTED:
            break
    if searched is not problem:
        problem.evaluations += searched.evaluations
    return min(scouts, key=lambda scout: scout.solution.cost)


def trusted_fit_index(fits: Sequence[Fitted], lengths: Sequence[float], horizon: float) -> int:
    """Index of the fit to report, of fits on windows of increasing length.

    Where the residuals of some fit, mostly on the shortest windows, are noise, it is the longest whose
    residuals are at most ``MAX_RESIDUAL_GROWTH`` times the smallest: process noise biases longer ones. Else
    the model is incomplete and all fits are biased; short windows absorb the misfit in their initial states
    and are no better. Then it is the fit with the windows nearest to the scored horizon, which was chosen
    before any fit and by which the model is judged.

    Args:
        fits: the fits.
        lengths: lengths of their windows in s.
        horizon: scored horizon in s.
    """
    least = min(fitted.noise for fitted in fits)
    if least > MAX_EXPLAINED_RATIO:
        return int(np.argmin(np.abs(np.log(np.asarray(lengths[: len(fits)]) / horizon))))
    trusted = [i for i, fitted in enumerate(fits) if fitted.noise <= MAX_RESIDUAL_GROWTH * least]
    return max(trusted)


def settle_fit(fitted: Fitted) -> Fitted:
    """Refine a fit to the lowest minimum within its uncertainty, by restarts from perturbed parameters."""
    _, classical, _ = fitted.covariances
    scale = fitted.problem.scale
    relative = np.nan_to_num(classical / np.outer(scale, scale), posinf=1.0)
    variances, directions = np.linalg.eigh(relative) if len(scale) else (np.empty(0), np.empty((0, 0)))
    spread = directions * np.sqrt(np.clip(variances, 0.0, 1.0))
    return fitted.with_solution(search_lower_minima(fitted.problem, fitted.solution, spread))
