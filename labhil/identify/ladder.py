"""From a start to fits on longer and longer windows: the ladder that a fit climbs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from labhil.ending import EndedEarly, accept
from labhil.identify.estimators import DEFAULT, INTERRUPTED, search
from labhil.identify.fitted import (
    ON_THE_WAY,
    Fitted,
    fit_briefly,
    fit_by_continuation,
    fit_terms,
    free_of,
    settle_fit,
    trusted_rung,
)
from labhil.identify.least_squares import TOLERANCE
from labhil.identify.problem import Problem
from labhil.identify.shapes import beside_rivals, over_shapes
from labhil.identify.windows import fit_windows, noise_of
from labhil.physics.model import Model, Record
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.identify.fit import Options

WINDOW_IN_HORIZONS = 1.5
LADDER = (0.125, 0.25, 0.5, 1.0)
LONGER = 2.0

EXPLAINED = 1.1
"""Residuals of a searched fit, in units of noise, below which no other start could do notably better."""

SEARCHES = 4
"""Searches from other seeds, at most, where residuals stay above that: one may end in a wrong valley."""

CONFIRMED = 1.02
"""Two searches whose residuals differ by less than this factor ended in the same valley."""


def window_lengths(model: Model, record: Record) -> list[float]:
    """Lengths of windows (s), short to long; to the whole record where the plant forgets how it began."""
    lengths = [share * WINDOW_IN_HORIZONS * model.horizon for share in LADDER]
    longest = record.longest
    if model.fading_memory and longest > LONGER * lengths[-1]:
        lengths = [*lengths[1:], float(np.sqrt(lengths[-1] * longest)), longest]
    return lengths


def climb(
    model: Model,
    record: Record,
    terms: Sequence[str],
    lengths: Sequence[float],
    sigma: FloatArray,
    begin: FloatArray,
    fresh: Sequence[str],
    how: Options,
) -> tuple[list[Fitted], bool]:
    """Fits on longer and longer windows, the longest trusted one settled in its lowest minimum.

    Also whether all of that was done: a climb that is ended early gives the fits that it has by then.
    """
    how.progress(f"fitting {len(terms)} terms on windows of {', '.join(f'{x:.3g}' for x in lengths)} s")
    rungs: list[Fitted] = []
    try:
        rungs.append(_first_rung(model, record, terms, lengths, sigma, begin, fresh, how))
        how.progress("looking for other minima")
        rungs[0] = first = over_shapes(rungs[0])
        longer: list[Fitted] = []
        try:
            fit_by_continuation(
                model, record, terms, lengths[1:], sigma, start=first.theta, fresh=(), reached=longer
            )
        finally:
            rungs += longer
        how.progress("looking for lower minima on the longest trusted windows")
        chosen = trusted_rung(rungs, lengths, model.horizon)
        best = beside_rivals(rungs[chosen], first.rivals) if chosen else first
        rungs[chosen] = settle_fit(best)
    except EndedEarly as early:
        accept()
        if not rungs:
            start = begin if early.theta is None else early.theta
            new = early.theta is None and bool(fresh)
            rungs.append(fit_briefly(model, record, terms, lengths[0], sigma, start, fresh=new))
        return rungs, False
    return rungs, True


def regress(
    model: Model, record: Record, terms: Sequence[str], begin: FloatArray
) -> tuple[list[Fitted], list[float]]:
    """One fit of inverse dynamics on the whole record, channels weighted by their own residuals."""
    length = record.longest
    sigma = noise_of(record)
    channels = len(sigma)
    fitted = fit_terms(model, record, terms, length, sigma, start=begin)
    for _ in range(2):
        spread = np.sqrt(np.mean(fitted.solution.residuals.reshape(-1, channels) ** 2, axis=0))
        sigma = sigma * np.maximum(spread, 1e-6)
        fitted = fit_terms(model, record, terms, length, sigma, start=fitted.theta, new_terms=())
    return [fitted], [length]


def _first_rung(
    model: Model,
    record: Record,
    terms: Sequence[str],
    lengths: Sequence[float],
    sigma: FloatArray,
    begin: FloatArray,
    fresh: Sequence[str],
    how: Options,
) -> Fitted:
    """The fit on the shortest windows: from the model's own starts, from a global search, or the better.

    The default goes on from the model's own starts only where they promise more than the search gave.
    """
    tolerance = ON_THE_WAY if len(lengths) > 1 else TOLERANCE
    if how.estimator == "nlse":
        return fit_terms(
            model, record, terms, lengths[0], sigma, start=begin, new_terms=fresh, tolerance=tolerance
        )
    windows = fit_windows(record, lengths[-1] if model.fading_memory else lengths[0])
    problem = Problem(model, record, windows, free_of(model, terms), begin, sigma)
    # widths are hardly known on short windows; they are scanned afterwards
    fit_from = partial(fit_terms, model, record, terms, lengths[0], sigma, shapes=False, tolerance=tolerance)
    scout = _scout(problem, fit_from, how)
    if how.estimator == DEFAULT and scout.noise >= EXPLAINED:
        unsearched = fit_from(start=begin, new_terms=fresh, hopeless=scout.solution.cost)
        if unsearched.solution.cost < scout.solution.cost:
            return unsearched
    searched = fit_from(start=scout.theta, states=scout.solution.point.states, new_terms=())
    searched.problem.evaluations += problem.evaluations + scout.problem.evaluations
    return searched


def _scout(problem: Problem, fit_from: Callable[..., Fitted], how: Options) -> Fitted:
    """A short fit from where a search ended.

    It shows whether that was the right valley, before long work is spent there. The default searches again
    until two searches end in the best valley, or one in a valley that leaves nothing but noise.
    """
    scouts: list[Fitted] = []
    for again in range(SEARCHES if how.estimator == DEFAULT else 1):
        how.progress(f"searching by {how.estimator}" + (", another seed" if again else ""))
        begin = search(problem, how.estimator, seed=how.seed + again, progress=how.progress)
        try:
            scouts.append(fit_from(start=begin.theta, new_terms=(), hopeless=0.0))
        except EndedEarly as early:
            early.theta = scouts[0].theta if scouts else begin.theta
            raise
        least = sorted(scout.noise for scout in scouts)
        agreed = again and least[1] < CONFIRMED * least[0]
        if least[0] < EXPLAINED or agreed or begin.search.stopped_because == INTERRUPTED:
            break
    return min(scouts, key=lambda scout: scout.solution.cost)
