"""From a record to a fitted, tested model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from labhil.ending import EndedEarly, accept
from labhil.errors import UnknownNameError, UsageError
from labhil.identify import statistics
from labhil.identify.adequacy import EXPLAINED_TO, Adequacy, adequacy_of
from labhil.identify.estimators import DEFAULT, INTERRUPTED, search
from labhil.identify.fitted import (
    ON_THE_WAY,
    Fitted,
    covariances,
    fit_briefly,
    fit_by_continuation,
    fit_terms,
    free_of,
    settled,
    start_theta,
    trusted_rung,
)
from labhil.identify.identifiability import Identifiability, identifiability
from labhil.identify.intervals import Intervals
from labhil.identify.least_squares import TOLERANCE
from labhil.identify.problem import Problem
from labhil.identify.sampling import moved_estimates, sampling_notes
from labhil.identify.score import Score, score, with_forces
from labhil.identify.shapes import beside_rivals, over_shapes
from labhil.identify.table import ParameterTable, table_of, widened
from labhil.identify.windows import fit_windows, noise_of, with_noise_scales
from labhil.physics.model import Metric, Model, Record, terms_named
from labhil.physics.rigs import by_inverse_dynamics
from labhil.signals import FloatArray

Progress = Callable[[str], None]

WINDOW_IN_HORIZONS = 1.5
LADDER = (0.125, 0.25, 0.5, 1.0)
LONGER = 2.0

EXPLAINED = 1.1
"""Residuals of a searched fit, in units of noise, below which no other start could do notably better."""

SEARCHES = 4
"""Searches from other seeds, at most, where residuals stay above that: one may end in a wrong valley."""

CONFIRMED = 1.02
"""Two searches whose residuals differ by less than this factor found the same valley."""


@dataclass(frozen=True, slots=True)
class WindowEstimate:
    """What a fit with windows of ``window`` s says: residual RMS in noise units, values and their errors."""

    window: float
    residual: float
    values: Mapping[str, float]
    std_errors: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Options:
    """How a fit is made.

    ``window`` (s) is the length of the fitted windows; by default one of a ladder, see
    ``fitted.trusted_rung``. ``intervals``
    says how they are made; ``simultaneous`` ones hold for all parameters together. ``estimator`` is one
    of ``estimators.ESTIMATORS``, ``seed`` that of its draws. ``criterion`` is what is made small; scores
    are by the model's own metric whatever it is.
    """

    window: float | None = None
    intervals: Intervals = Intervals.AUTO
    simultaneous: bool = False
    estimator: str = DEFAULT
    seed: int = 0
    progress: Progress = lambda text: None
    criterion: Metric | None = None


def criterion_named(name: str | None) -> Metric | None:
    """The metric of that name, None for none; UnknownNameError lists those that exist."""
    if name is not None and name not in set(Metric):
        raise UnknownNameError("criterion", name, [metric.value for metric in Metric])
    return None if name is None else Metric(name)


@dataclass(frozen=True, slots=True)
class FittedChannel:
    """What the fitted windows leave of one channel: RMSE in its unit, open loop from each one's own state."""

    channel: str
    joint: int | None
    unit: str
    rmse: float


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted model with its statistics; ``covariance`` (P, P) is the robust one, in SI units.

    ``residuals`` (N, channels) are those of the fitted windows, in units of noise; ``left`` is their size.
    ``criterion`` is what was made small. ``adequacy`` says whether it explains the data; where it does not,
    errors and covariance hold how far the estimates are from those on ``compared`` windows (s), and
    ``sampling`` says whether the sampling may be why. ``complete`` is False where it was ended early.
    """

    terms: tuple[str, ...]
    estimates: list[statistics.Estimate]
    covariance: FloatArray
    identifiability: Identifiability
    theta: FloatArray
    window: float
    by_window: list[WindowEstimate]
    sigma: FloatArray
    residuals: FloatArray
    left: tuple[FittedChannel, ...]
    criterion: Metric
    fitted: Fitted
    intervals: Intervals
    simultaneous: bool
    train: Score
    test: Score | None
    adequacy: Adequacy
    ljung_box_p: float
    input_crosscorrelation_p: float
    evaluations: int
    converged: bool
    complete: bool = True
    sampling: tuple[str, ...] = ()
    compared: tuple[float, ...] = ()


def fit(
    model: Model,
    record: Record,
    terms: Sequence[str],
    *,
    test: Record | None = None,
    start: Mapping[str, float] | None = None,
    options: Options | None = None,
) -> Fit:
    """Fit a model with these terms to a record, test it, and say how much to believe.

    ``start`` are values by parameter key to begin at; records are ``model.prepare``d ones. UsageError where
    the rig has no such criterion.
    """
    how = options or Options()
    record = with_noise_scales(model, record)
    test = None if test is None else with_noise_scales(model, test)
    begin = start_theta(model, start)
    if how.criterion is Metric.WINDOWED_SIMULATION and not model.state_names:
        raise UsageError(f"{model.kind} has no states to simulate; its criterion is {model.metric}")
    if Metric.INVERSE_DYNAMICS in (model.metric, how.criterion):
        inverse = by_inverse_dynamics(model)
        keys = tuple(term.key for term in terms_named(inverse, terms))
        prepared = inverse.prepare(record)
        try:
            (rungs, lengths), complete = _regressed(inverse, prepared, keys, begin), True
        except EndedEarly:  # linear: no way there is shorter
            accept()
            (rungs, lengths), complete = _regressed(inverse, prepared, keys, begin), False
    else:
        keys = tuple(term.key for term in terms_named(model, terms))
        lengths = [how.window] if how.window else _ladder(model, record)
        rungs, complete = _climbed(
            model, record, keys, lengths, noise_of(record), begin, () if start else keys, how
        )
    try:
        if complete:
            return _finished(model, rungs, lengths, record, test, how)
    except EndedEarly:
        accept()
    quick = replace(how, intervals=Intervals.WALD)
    return replace(_finished(model, rungs, lengths, record, test, quick), complete=False)


def _finished(
    model: Model,
    rungs: Sequence[Fitted],
    lengths: Sequence[float],
    record: Record,
    test: Record | None,
    how: Options,
) -> Fit:
    """Statistics and scores of the fits on these ``lengths`` of windows (s); fewer where it ended early."""
    chosen = trusted_rung(rungs, lengths, model.horizon)
    how.progress(f"statistics and scores, intervals by {how.intervals}")
    by_window = [_window_estimate(r, length) for r, length in zip(rungs, lengths, strict=False)]
    table = table_of(rungs[chosen], how.intervals, how.simultaneous)
    scores = tuple(_scored(model, rungs[chosen].theta, r) for r in (record, test) if r is not None)
    return _finish(scores, rungs, chosen, by_window, table, how)


def _scored(model: Model, theta: FloatArray, record: Record) -> Score:
    """By the model's own metric, with what stands beside it."""
    sigma = noise_of(record)
    return with_forces(score(model, theta, record, sigma), model, theta, record, sigma)


def _ladder(model: Model, record: Record) -> list[float]:
    """Lengths of windows (s), short to long; to the whole record where the plant forgets how it began."""
    lengths = [share * WINDOW_IN_HORIZONS * model.horizon for share in LADDER]
    whole = record.longest
    if model.fading_memory and whole > LONGER * lengths[-1]:
        lengths = [*lengths[1:], float(np.sqrt(lengths[-1] * whole)), whole]
    return lengths


def _climbed(
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

    Also whether all of that was done: those that there are by then where it is ended early.
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
        found = beside_rivals(rungs[chosen], first.rivals) if chosen else first
        rungs[chosen] = settled(found)
    except EndedEarly as early:
        accept()
        if not rungs:
            start = begin if early.theta is None else early.theta
            new = early.theta is None and bool(fresh)
            rungs.append(fit_briefly(model, record, terms, lengths[0], sigma, start, fresh=new))
        return rungs, False
    return rungs, True


def _regressed(
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
    begun = partial(fit_terms, model, record, terms, lengths[0], sigma, shapes=False, tolerance=tolerance)
    scout = _scouted(problem, begun, how)
    if how.estimator == DEFAULT and scout.noise >= EXPLAINED:
        own = begun(start=begin, new_terms=fresh, hopeless=scout.solution.cost)
        if own.solution.cost < scout.solution.cost:
            return own
    searched = begun(start=scout.theta, states=scout.solution.point.states, new_terms=())
    searched.problem.evaluations += problem.evaluations + scout.problem.evaluations
    return searched


def _scouted(problem: Problem, begun: Callable[..., Fitted], how: Options) -> Fitted:
    """A short fit from where a search ended.

    It tells whether that was the right valley, before long work is spent there. The default searches again
    until it found the best valley twice, or one that leaves nothing but noise.
    """
    scouts: list[Fitted] = []
    for again in range(SEARCHES if how.estimator == DEFAULT else 1):
        how.progress(f"searching by {how.estimator}" + (", another seed" if again else ""))
        found = search(problem, how.estimator, seed=how.seed + again, progress=how.progress)
        try:
            scouts.append(begun(start=found.theta, new_terms=(), hopeless=0.0))
        except EndedEarly as early:
            early.theta = scouts[0].theta if scouts else found.theta
            raise
        least = sorted(scout.noise for scout in scouts)
        agreed = again and least[1] < CONFIRMED * least[0]
        if least[0] < EXPLAINED or agreed or found.found.stopped_because == INTERRUPTED:
            break
    return min(scouts, key=lambda scout: scout.solution.cost)


def _window_estimate(fitted: Fitted, length: float) -> WindowEstimate:
    robust, _, _ = covariances(fitted)
    names = [fitted.problem.model.parameters[i].key for i in fitted.problem.free]
    values = fitted.theta[fitted.problem.free]
    errors = np.sqrt(np.maximum(np.diag(robust), 0.0))
    return WindowEstimate(
        length,
        fitted.noise,
        dict(zip(names, values.tolist(), strict=True)),
        dict(zip(names, errors.tolist(), strict=True)),
    )


def _comparable(by_window: Sequence[WindowEstimate], chosen: int) -> list[WindowEstimate]:
    """Fits on other windows that should agree with the chosen one, were the model complete.

    Where some windows, mostly the shortest, fit to the noise, only those that do: longer ones are biased by
    what disturbs the plant, which is no fault of the estimate on short ones. Else all.
    """
    disturbed = min(rung.residual for rung in by_window) <= EXPLAINED_TO
    others = [rung for k, rung in enumerate(by_window) if k != chosen]
    return [rung for rung in others if not disturbed or rung.residual <= EXPLAINED_TO]


def _left(fitted: Fitted) -> tuple[FittedChannel, ...]:
    """What the fitted windows leave of each channel."""
    problem = fitted.problem
    residuals = fitted.solution.residuals.reshape(-1, len(problem.sigma)) * problem.sigma
    rmse = np.sqrt(np.mean(residuals**2, axis=0)).tolist()
    units = problem.record.output_units
    return tuple(FittedChannel(*problem.record.channel(j), units[j], each) for j, each in enumerate(rmse))


def _finish(
    scores: Sequence[Score],
    rungs: Sequence[Fitted],
    chosen: int,
    by_window: list[WindowEstimate],
    table: ParameterTable,
    how: Options,
) -> Fit:
    """The fit on the chosen windows; ``scores`` are those on the data of the fit and, if any, on others."""
    fitted = rungs[chosen]
    problem = fitted.problem
    parameters = [problem.model.parameters[i] for i in problem.free]
    residuals = fitted.solution.residuals.reshape(-1, len(problem.sigma))
    inputs, begins = problem.record.inputs[problem.windows.rows, 0], problem.begins
    values = fitted.theta[problem.free]
    adequacy = adequacy_of(scores)
    others = [] if adequacy.explained else _comparable(by_window, chosen)
    if not adequacy.explained:
        values_of, errors_of = [rung.values for rung in others], [rung.std_errors for rung in others]
        table = widened(table, parameters, values_of, errors_of, moved_estimates(fitted))
    return Fit(
        terms=fitted.terms,
        estimates=table.rows,
        covariance=table.covariance,
        identifiability=identifiability(parameters, values, table.jacobian, fitted.noise),
        theta=fitted.theta,
        window=by_window[chosen].window,
        by_window=by_window,
        sigma=problem.sigma,
        residuals=residuals,
        left=_left(fitted),
        criterion=problem.model.metric,
        fitted=fitted,
        adequacy=adequacy,
        intervals=how.intervals,
        simultaneous=how.simultaneous,
        train=scores[0],
        test=scores[1] if len(scores) > 1 else None,
        ljung_box_p=statistics.of_channels(lambda r, _: statistics.whiteness(r), residuals, begins),
        input_crosscorrelation_p=statistics.of_channels(
            lambda r, rows: statistics.input_crosscorrelation(r, inputs[rows]), residuals, begins
        ),
        evaluations=sum(rung.problem.evaluations for rung in rungs),
        converged=fitted.solution.converged,
        sampling=sampling_notes(fitted, explained=adequacy.explained),
        compared=tuple(rung.window for rung in others),
    )
