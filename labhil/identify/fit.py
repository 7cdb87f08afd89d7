"""Fit of a model to a record, with uncertainties, residual tests, and scores on training and test data.

`fit` is the entry point. Fits on windows of increasing length are in continuation.py, the table of estimates
in table.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.ending import EndedEarly, accept
from labhil.errors import UnknownNameError, UsageError
from labhil.identify import statistics
from labhil.identify.adequacy import MAX_EXPLAINED_RATIO, Adequacy, adequacy_of
from labhil.identify.continuation import (
    FitTask,
    fit_inverse_dynamics,
    fit_on_growing_windows,
    settle_fit,
    trusted_fit_index,
    window_lengths,
)
from labhil.identify.estimators import DEFAULT
from labhil.identify.fitted import Fitted, refit_from, start_theta
from labhil.identify.identifiability import Identifiability, identifiability
from labhil.identify.intervals import Intervals
from labhil.identify.sampling import hold_shifts, sampling_notes
from labhil.identify.score import Score, score, with_forces
from labhil.identify.table import ParameterTable, table_of, widen
from labhil.identify.windows import noise_of, with_noise_scales
from labhil.physics.model import Metric, Model, terms_named
from labhil.physics.record import Record
from labhil.physics.rigs import by_inverse_dynamics
from labhil.signals import FloatArray

Progress = Callable[[str], None]

MAX_LOWER_MINIMA = 3
"""How often a fit begins again from a lower minimum that a profile came upon."""


@dataclass(frozen=True, slots=True)
class WindowEstimate:
    """Estimates on windows of one length.

    Attributes:
        window: length of the windows in s.
        residual: RMS of the residuals in units of noise.
        values: estimates by key, in SI units.
        std_errors: their robust standard errors.
    """

    window: float
    residual: float
    values: Mapping[str, float]
    std_errors: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a fit.

    Attributes:
        window: length of the fitted windows in s; by default the longest trusted one, see
            `continuation.trusted_fit_index`.
        intervals: method of the confidence intervals.
        simultaneous: intervals hold for all parameters together.
        estimator: one of ``estimators.ESTIMATORS``.
        seed: seed of the estimator's random numbers.
        progress: is called with a line of text before each step.
        criterion: what is minimised, by default the model's own metric; scores are always by the latter.
    """

    window: float | None = None
    intervals: Intervals = Intervals.AUTO
    simultaneous: bool = False
    estimator: str = DEFAULT
    seed: int = 0
    progress: Progress = lambda text: None
    criterion: Metric | None = None


def criterion_named(name: str | None) -> Metric | None:
    """Look up a criterion by its name.

    Args:
        name: name of a metric, or None.

    Returns:
        The metric, None for None.

    Raises:
        UnknownNameError: There is no such metric.
    """
    if name is not None and name not in set(Metric):
        raise UnknownNameError("criterion", name, [metric.value for metric in Metric])
    return None if name is None else Metric(name)


@dataclass(frozen=True, slots=True)
class FittedChannel:
    """Simulation error of one channel on the fitted windows: RMSE in the channel's unit."""

    channel: str
    joint: int | None
    unit: str
    rmse: float


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted model with its statistics.

    Attributes:
        terms: keys of the fitted terms.
        estimates: estimates of all free parameters with intervals.
        covariance: (P, P), robust covariance of the estimates, in SI units. For an inadequate model it
            includes the differences to the estimates on the ``compared`` windows.
        identifiability: which parameters the data determine.
        theta: (M,), all parameters of the model, in SI units.
        window: length of the fitted windows in s.
        by_window: estimates on windows of other lengths.
        sigma: (channels,), noise of the channels.
        residuals: (N, channels), residuals on the fitted windows in units of noise.
        channel_errors: RMSE of each channel on the fitted windows.
        criterion: what was minimised.
        fitted: the fit itself.
        intervals: method of the confidence intervals.
        simultaneous: intervals hold for all parameters together.
        train: score on the training data.
        test: score on the test data, if there are any.
        adequacy: whether the model explains the data.
        ljung_box_p: p value of the test that the residuals are white.
        input_crosscorrelation_p: p value of the test that residuals and inputs are uncorrelated.
        evaluations: number of simulations.
        converged: whether the fit converged.
        complete: False where the fit was ended early.
        sampling: notes on the sampling, as a possible reason of inadequacy.
        compared: lengths in s of other windows whose estimates should agree with these.
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
    channel_errors: tuple[FittedChannel, ...]
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
    """Fit a model with these terms to a record, and evaluate it on training and test data.

    Args:
        model: the model with all its terms.
        record: training data, prepared by ``model.prepare``.
        terms: keys or names of the terms to fit.
        test: test data, prepared likewise.
        start: values by parameter key to start from, in SI units.
        options: options of the fit; None for the defaults.

    Returns:
        The fitted model with its statistics.

    Raises:
        UsageError: The rig does not support the selected criterion.
    """
    options = options or Options()
    record = with_noise_scales(model, record)
    test = None if test is None else with_noise_scales(model, test)
    begin = start_theta(model, start)
    if options.criterion is Metric.WINDOWED_SIMULATION and not model.state_names:
        raise UsageError(f"{model.kind} has no states to simulate; its criterion is {model.metric}")
    if Metric.INVERSE_DYNAMICS in (model.metric, options.criterion):
        inverse = by_inverse_dynamics(model)
        keys = tuple(term.key for term in terms_named(inverse, terms))
        prepared = inverse.prepare(record)
        try:
            (fits, lengths), complete = fit_inverse_dynamics(inverse, prepared, keys, begin), True
        except EndedEarly:  # a linear fit has no shorter version: repeat it
            accept()
            (fits, lengths), complete = fit_inverse_dynamics(inverse, prepared, keys, begin), False
    else:
        keys = tuple(term.key for term in terms_named(model, terms))
        lengths = [options.window] if options.window else window_lengths(model, record)
        new_terms = () if start else keys
        fits, complete = fit_on_growing_windows(
            FitTask(model, record, keys, lengths, noise_of(record), begin, new_terms, options)
        )
    try:
        if complete:
            return _evaluate(model, fits, lengths, record, test, options)
    except EndedEarly:
        accept()
    quick = replace(options, intervals=Intervals.WALD)
    return replace(_evaluate(model, fits, lengths, record, test, quick), complete=False)


def _evaluate(
    model: Model,
    fits: Sequence[Fitted],
    lengths: Sequence[float],
    record: Record,
    test: Record | None,
    options: Options,
) -> Fit:
    """Statistics and scores of the fits on windows of these ``lengths`` (s), or on the first few of them."""
    chosen = trusted_fit_index(fits, lengths, model.horizon)
    options.progress(f"statistics and scores, intervals by {options.intervals}")
    fits = list(fits)
    for again in range(MAX_LOWER_MINIMA + 1):
        last = again == MAX_LOWER_MINIMA
        table = table_of(fits[chosen], options.intervals, options.simultaneous, stop_at_lower=not last)
        if table.lower is None or last:
            break
        options.progress("a profile led to a lower minimum: fitting from there")
        fits[chosen] = settle_fit(refit_from(fits[chosen], table.lower))
    by_window = [_window_estimate(r, length) for r, length in zip(fits, lengths, strict=False)]
    scores = tuple(_score_with_forces(model, fits[chosen].theta, r) for r in (record, test) if r is not None)
    return _assemble(scores, fits, chosen, by_window, table, options)


def _score_with_forces(model: Model, theta: FloatArray, record: Record) -> Score:
    """Score by the model's own metric, with the scores of forces that belong to it."""
    sigma = noise_of(record)
    return with_forces(score(model, theta, record, sigma), model, theta, record, sigma)


def _window_estimate(fitted: Fitted, length: float) -> WindowEstimate:
    """Estimates and robust standard errors of a fit on windows of ``length`` s."""
    robust, _, _ = fitted.covariances
    names = [fitted.problem.model.parameters[i].key for i in fitted.problem.free]
    values = fitted.theta[fitted.problem.free]
    errors = np.sqrt(np.maximum(np.diag(robust), 0.0))
    return WindowEstimate(
        length,
        fitted.noise,
        dict(zip(names, values.tolist(), strict=True)),
        dict(zip(names, errors.tolist(), strict=True)),
    )


def _comparable_windows(by_window: Sequence[WindowEstimate], chosen: int) -> list[WindowEstimate]:
    """Estimates on other windows that would agree with the chosen ones if the model were complete.

    Where the residuals on some windows, mostly the shortest, are noise, these are only such windows: process
    noise biases longer ones. Else these are all other windows.
    """
    some_explained = min(estimate.residual for estimate in by_window) <= MAX_EXPLAINED_RATIO
    others = [estimate for k, estimate in enumerate(by_window) if k != chosen]
    return [estimate for estimate in others if not some_explained or estimate.residual <= MAX_EXPLAINED_RATIO]


def _channel_errors(fitted: Fitted) -> tuple[FittedChannel, ...]:
    """RMSE of each channel on the fitted windows."""
    problem = fitted.problem
    residuals = fitted.solution.residuals.reshape(-1, len(problem.sigma)) * problem.sigma
    rmse = np.sqrt(np.mean(residuals**2, axis=0)).tolist()
    units = problem.record.output_units
    return tuple(FittedChannel(*problem.record.channel(j), units[j], error) for j, error in enumerate(rmse))


def _assemble(
    scores: Sequence[Score],
    fits: Sequence[Fitted],
    chosen: int,
    by_window: list[WindowEstimate],
    table: ParameterTable,
    options: Options,
) -> Fit:
    """Assemble the result of the chosen fit; ``scores`` are those on training data and, if any, test data."""
    fitted = fits[chosen]
    problem = fitted.problem
    parameters = [problem.model.parameters[i] for i in problem.free]
    residuals = fitted.solution.residuals.reshape(-1, len(problem.sigma))
    inputs, begins = problem.record.inputs[problem.windows.rows, 0], problem.begins
    values = fitted.theta[problem.free]
    adequacy = adequacy_of(scores)
    others = [] if adequacy.explained else _comparable_windows(by_window, chosen)
    if not adequacy.explained:
        values_of = [estimate.values for estimate in others]
        errors_of = [estimate.std_errors for estimate in others]
        table = widen(table, parameters, values_of, errors_of, hold_shifts(fitted))
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
        channel_errors=_channel_errors(fitted),
        criterion=problem.model.metric,
        fitted=fitted,
        adequacy=adequacy,
        intervals=options.intervals,
        simultaneous=options.simultaneous,
        train=scores[0],
        test=scores[1] if len(scores) > 1 else None,
        ljung_box_p=statistics.smallest_p_value(lambda r, _: statistics.whiteness(r), residuals, begins),
        input_crosscorrelation_p=statistics.smallest_p_value(
            lambda r, rows: statistics.input_crosscorrelation(r, inputs[rows]), residuals, begins
        ),
        evaluations=sum(fitted.problem.evaluations for fitted in fits),
        converged=fitted.solution.converged,
        sampling=sampling_notes(fitted, explained=adequacy.explained),
        compared=tuple(estimate.window for estimate in others),
    )
