"""From a record to a fitted, tested model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.ending import EndedEarly, accept
from labhil.errors import UnknownNameError, UsageError
from labhil.identify import statistics
from labhil.identify.adequacy import MAX_EXPLAINED_RATIO, Adequacy, adequacy_of
from labhil.identify.estimators import DEFAULT
from labhil.identify.fitted import Fitted, covariances, start_theta, trusted_rung
from labhil.identify.identifiability import Identifiability, identifiability
from labhil.identify.intervals import Intervals
from labhil.identify.ladder import climb, regress, window_lengths
from labhil.identify.sampling import hold_shifts, sampling_notes
from labhil.identify.score import Score, score, with_forces
from labhil.identify.table import ParameterTable, table_of, widen
from labhil.identify.windows import noise_of, with_noise_scales
from labhil.physics.model import Metric, Model, Record, terms_named
from labhil.physics.rigs import by_inverse_dynamics
from labhil.signals import FloatArray

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class WindowEstimate:
    """A fit on windows of ``window`` s in figures: residual RMS in noise units, values and their errors."""

    window: float
    residual: float
    values: Mapping[str, float]
    std_errors: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Options:
    """How a fit is made.

    ``window`` (s) is the length of the fitted windows; by default one of a ladder, see
    ``fitted.trusted_rung``. ``intervals`` is the method for them; ``simultaneous`` ones hold for all
    parameters together. ``estimator`` is one of ``estimators.ESTIMATORS``, ``seed`` that of its draws.
    ``criterion`` is what is made small; scores are by the model's own metric whatever it is.
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
    """Fit a model with these terms to a record, test it, and judge how far to believe it.

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
            (rungs, lengths), complete = regress(inverse, prepared, keys, begin), True
        except EndedEarly:  # linear: no way there is shorter
            accept()
            (rungs, lengths), complete = regress(inverse, prepared, keys, begin), False
    else:
        keys = tuple(term.key for term in terms_named(model, terms))
        lengths = [how.window] if how.window else window_lengths(model, record)
        rungs, complete = climb(
            model, record, keys, lengths, noise_of(record), begin, () if start else keys, how
        )
    try:
        if complete:
            return _evaluate(model, rungs, lengths, record, test, how)
    except EndedEarly:
        accept()
    quick = replace(how, intervals=Intervals.WALD)
    return replace(_evaluate(model, rungs, lengths, record, test, quick), complete=False)


def _evaluate(
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
    scores = tuple(_score_with_forces(model, rungs[chosen].theta, r) for r in (record, test) if r is not None)
    return _assemble(scores, rungs, chosen, by_window, table, how)


def _score_with_forces(model: Model, theta: FloatArray, record: Record) -> Score:
    """By the model's own metric, with what stands beside it."""
    sigma = noise_of(record)
    return with_forces(score(model, theta, record, sigma), model, theta, record, sigma)


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


def _comparable_windows(by_window: Sequence[WindowEstimate], chosen: int) -> list[WindowEstimate]:
    """Fits on other windows that should agree with the chosen one, were the model complete.

    Where some windows, mostly the shortest, fit to the noise, only those that do: longer ones are biased by
    what disturbs the plant, which is no fault of the estimate on short ones. Else all.
    """
    disturbed = min(rung.residual for rung in by_window) <= MAX_EXPLAINED_RATIO
    others = [rung for k, rung in enumerate(by_window) if k != chosen]
    return [rung for rung in others if not disturbed or rung.residual <= MAX_EXPLAINED_RATIO]


def _channels_of(fitted: Fitted) -> tuple[FittedChannel, ...]:
    """What the fitted windows leave of each channel."""
    problem = fitted.problem
    residuals = fitted.solution.residuals.reshape(-1, len(problem.sigma)) * problem.sigma
    rmse = np.sqrt(np.mean(residuals**2, axis=0)).tolist()
    units = problem.record.output_units
    return tuple(FittedChannel(*problem.record.channel(j), units[j], error) for j, error in enumerate(rmse))


def _assemble(
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
    others = [] if adequacy.explained else _comparable_windows(by_window, chosen)
    if not adequacy.explained:
        values_of, errors_of = [rung.values for rung in others], [rung.std_errors for rung in others]
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
        left=_channels_of(fitted),
        criterion=problem.model.metric,
        fitted=fitted,
        adequacy=adequacy,
        intervals=how.intervals,
        simultaneous=how.simultaneous,
        train=scores[0],
        test=scores[1] if len(scores) > 1 else None,
        ljung_box_p=statistics.smallest_p_value(lambda r, _: statistics.whiteness(r), residuals, begins),
        input_crosscorrelation_p=statistics.smallest_p_value(
            lambda r, rows: statistics.input_crosscorrelation(r, inputs[rows]), residuals, begins
        ),
        evaluations=sum(rung.problem.evaluations for rung in rungs),
        converged=fitted.solution.converged,
        sampling=sampling_notes(fitted, explained=adequacy.explained),
        compared=tuple(rung.window for rung in others),
    )
