"""From a record to a fitted, tested model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.identify import statistics
from labhil.identify.identifiability import Identifiability, identifiability, weak_parameters
from labhil.identify.intervals import (
    Intervals,
    bootstrap_intervals,
    profile_interval,
    quantile,
    simultaneous_quantile,
)
from labhil.identify.least_squares import Solution, least_squares, settle
from labhil.identify.problem import Point, Problem
from labhil.identify.score import Score, score
from labhil.identify.windows import fit_windows, noise_of
from labhil.physics.model import Model, Record, index_of, start_values, starts_of, terms_named
from labhil.signals import FloatArray

Progress = Callable[[str], None]

WINDOW_IN_HORIZONS = 1.5
LADDER = (0.125, 0.25, 0.5, 1.0)
WORST_GROWTH = 1.3
SETTLED = 1.15
SCOUT_ITERATIONS = 8


@dataclass(frozen=True, slots=True)
class Fitted:
    """A model's vector that was fitted on one cut into windows, with what led there."""

    terms: tuple[str, ...]
    theta: FloatArray
    problem: Problem
    solution: Solution

    @property
    def noise(self) -> float:
        """Standard deviation of the residuals, in units of the noise of the recording."""
        return float(np.sqrt(self.solution.cost / self.dof))

    @property
    def dof(self) -> int:
        """Residuals less what was fitted."""
        fitted = len(self.problem.free) + self.solution.point.states.size
        return max(len(self.solution.residuals) - fitted, 1)


@dataclass(frozen=True, slots=True)
class WindowEstimate:
    """What a fit with windows of ``window`` s says: residual RMS in noise units, values and their errors."""

    window: float
    residual: float
    values: Mapping[str, float]
    std_errors: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted model with its statistics; ``covariance`` (P, P) is the robust one, in SI units."""

    terms: tuple[str, ...]
    estimates: list[statistics.Estimate]
    covariance: FloatArray
    identifiability: Identifiability
    theta: FloatArray
    window: float
    by_window: list[WindowEstimate]
    sigma: FloatArray
    train: Score
    test: Score | None
    ljung_box_p: float
    input_crosscorrelation_p: float
    evaluations: int
    converged: bool


def free_of(model: Model, terms: Sequence[str]) -> np.ndarray:
    """Places of the parameters that a model with these terms estimates: the rig's own and the terms'."""
    chosen = {p.key for term in terms_named(model, terms) for p in term.parameters}
    return np.array(
        [i for i, p in enumerate(model.parameters) if p.term is None or p.key in chosen], dtype=np.int64
    )


def start_theta(model: Model, values: Mapping[str, float] | None = None) -> FloatArray:
    """Every term neutral, the rig's own parameters at their first start, then ``values`` by name."""
    theta = start_values(model.parameters)
    places = index_of(model.parameters)
    for name, value in (values or {}).items():
        if name in places:
            theta[places[name]] = value
    return theta


def fit_terms(
    model: Model,
    record: Record,
    terms: Sequence[str],
    window: float,
    sigma: FloatArray,
    *,
    start: FloatArray | None = None,
    states: FloatArray | None = None,
    new_terms: Sequence[str] | None = None,
    iterations: int = 60,
    thorough: bool = True,
    hopeless: float = float("inf"),
) -> Fitted:
    """Fit a set of terms from several starts and keep the best.

    ``start`` is a vector to begin at (default: everything neutral), ``states`` initial states of the
    same windows under a model close by; the ``new_terms`` (default: all) begin at each of their own
    starts. Scouts go a few steps from each, the best goes on to the end; ``thorough`` gives outlying
    windows a second chance there. When no scout comes below the cost ``hopeless``, the best scout is
    the answer.
    """
    begin = start_theta(model) if start is None else start
    windows = fit_windows(record, window)
    free = free_of(model, terms)
    best: tuple[Problem, Solution] | None = None
    starts = _starts(model, record, begin, terms if new_terms is None else new_terms)
    for theta in starts:
        problem = Problem(model, record, windows, free, theta, sigma)
        limit = SCOUT_ITERATIONS if len(starts) > 1 or hopeless < float("inf") else iterations
        begin_at = problem.start() if states is None else Point(problem.start().z, states)
        settled = states is not None
        solution = least_squares(problem, begin_at, iterations=limit, settled=settled, thorough=False)
        if best is None or solution.cost < best[1].cost:
            best = problem, solution
    assert best is not None
    problem, solution = best
    if solution.cost <= hopeless and (thorough or not solution.converged):
        solution = least_squares(
            problem, solution.point, iterations=iterations, settled=True, thorough=thorough
        )
    return Fitted(tuple(terms), problem.theta(solution.point.z), problem, solution)


def _starts(model: Model, record: Record, begin: FloatArray, terms: Sequence[str]) -> list[FloatArray]:
    """``begin`` with each set of starts of these terms put in."""
    places = index_of(model.parameters)
    vectors = []
    for values in starts_of(model, terms_named(model, terms), record) if terms else [{}]:
        theta = begin.copy()
        for name, value in values.items():
            theta[places[name]] = value
        vectors.append(theta)
    return vectors


def covariances(fitted: Fitted) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Robust and classical covariance in SI units (P, P), and the projected Jacobian (N, P) by SI units."""
    problem, solution = fitted.problem, fitted.solution
    lin = problem.linearise(solution.point, solution.residuals, central=True)
    jacobian = problem.project(lin, lin.by_parameters) / problem.scale
    if not jacobian.shape[1]:
        return np.empty((0, 0)), np.empty((0, 0)), jacobian
    unit = np.linalg.norm(jacobian, axis=0)
    unit[unit == 0.0] = 1.0
    scaled = jacobian / unit
    robust = statistics.robust_covariance(scaled, solution.residuals, fitted.dof)
    inverse = statistics.inverse_information(scaled)
    lost = np.linalg.norm(jacobian, axis=0) == 0.0
    for matrix in (robust, inverse):
        matrix[lost, lost] = np.inf
    classical = inverse * solution.cost / fitted.dof
    return robust / np.outer(unit, unit), classical / np.outer(unit, unit), jacobian


def fit(
    model: Model,
    record: Record,
    terms: Sequence[str],
    *,
    test: Record | None = None,
    window: float | None = None,
    start: Mapping[str, float] | None = None,
    intervals: Intervals = Intervals.WALD,
    simultaneous: bool = False,
    progress: Progress = lambda text: None,
) -> Fit:
    """Fit a model with these terms to a record, test it, and say how much to believe.

    ``intervals`` says how they are made; ``simultaneous`` ones hold for all parameters together.

    ``window`` (s) is the length of the fitted windows; by default the longest of a ladder whose
    residuals have not grown: where noise drives the plant itself, long windows bias the estimates.
    """
    sigma = noise_of(record)
    lengths = [window] if window else [f * WINDOW_IN_HORIZONS * model.horizon for f in LADDER]
    fresh = terms if start is None else ()
    progress(f"fitting {len(terms)} terms on windows of {', '.join(f'{x:.3g}' for x in lengths)} s")
    rungs = climb(model, record, terms, lengths, sigma, start=start_theta(model, start), fresh=fresh)
    if rungs[-1].noise > SETTLED:
        rungs[-1] = _from_other_shapes(model, record, rungs, lengths, sigma, progress)
    chosen = longest_trusted(rungs)
    progress("looking for lower minima nearby")
    rungs[chosen] = settled(rungs[chosen])
    progress(f"statistics and scores, intervals by {intervals}")
    by_window = [_window_estimate(r, length) for r, length in zip(rungs, lengths, strict=True)]
    table = table_of(rungs[chosen], intervals, simultaneous)
    return _finish(model, record, test, rungs, chosen, lengths[chosen], by_window, sigma, table)


def climb(
    model: Model,
    record: Record,
    terms: Sequence[str],
    lengths: Sequence[float],
    sigma: FloatArray,
    *,
    start: FloatArray,
    fresh: Sequence[str],
) -> list[Fitted]:
    """Fit on longer and longer windows (s), each from where the one before ended.

    Short windows lead to the neighbourhood whatever the start, long ones to the estimate. The terms
    ``fresh`` begin at each of their own starts on the first.
    """
    rungs: list[Fitted] = []
    for length in lengths:
        begin = rungs[-1].theta if rungs else start
        new_terms = () if rungs else fresh
        rungs.append(fit_terms(model, record, terms, length, sigma, start=begin, new_terms=new_terms))
    return rungs


def _from_other_shapes(
    model: Model,
    record: Record,
    rungs: Sequence[Fitted],
    lengths: Sequence[float],
    sigma: FloatArray,
    progress: Progress,
) -> Fitted:
    """Begin the last rungs anew from other starts of terms that have a shape, and keep the best.

    A width such as the Stribeck velocity has local minima: too narrow to be seen, or so wide that it
    passes for viscous friction.
    """
    best = rungs[-1]
    shaped = [t for t in best.terms if any(p.shape for p in model.terms[t].parameters)]
    for theta in _starts(model, record, best.theta, shaped) if shaped else []:
        progress(f"another start for {', '.join(shaped)}")
        trial, begin = best, theta
        for length in lengths[-2:]:
            trial = fit_terms(model, record, best.terms, length, sigma, start=begin, new_terms=())
            begin = trial.theta
        best = trial if trial.solution.cost < best.solution.cost else best
    return best


def longest_trusted(rungs: Sequence[Fitted]) -> int:
    """The longest windows whose residuals have grown by less than 30 % over those of the shortest."""
    trusted = [i for i, rung in enumerate(rungs) if rung.noise <= WORST_GROWTH * rungs[0].noise]
    return max(trusted)


def settled(fitted: Fitted) -> Fitted:
    """The same model where it has settled in the lowest minimum within its own uncertainty."""
    _, classical, _ = covariances(fitted)
    scale = fitted.problem.scale
    relative = np.nan_to_num(classical / np.outer(scale, scale), posinf=1.0)
    variances, directions = np.linalg.eigh(relative) if len(scale) else (np.empty(0), np.empty((0, 0)))
    spread = directions * np.sqrt(np.clip(variances, 0.0, 1.0))
    solution = settle(fitted.problem, fitted.solution, spread)
    return replace(fitted, theta=fitted.problem.theta(solution.point.z), solution=solution)


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


def table_of(
    fitted: Fitted, method: Intervals = Intervals.WALD, simultaneous: bool = False
) -> tuple[list[statistics.Estimate], FloatArray, FloatArray]:
    """Estimates with their statistics, the robust covariance and the projected Jacobian."""
    robust, classical, jacobian = covariances(fitted)
    chosen = [fitted.problem.model.parameters[i] for i in fitted.problem.free]
    values = fitted.theta[fitted.problem.free]
    n = len(fitted.solution.residuals)
    unknown = weak_parameters(chosen, values, jacobian, fitted.noise)
    reach = simultaneous_quantile(robust) if simultaneous else quantile()
    ends = _intervals(fitted, method, robust, classical, jacobian, reach)
    return statistics.estimates(chosen, values, robust, classical, n, unknown, ends), robust, jacobian


def _intervals(
    fitted: Fitted,
    method: Intervals,
    robust: FloatArray,
    classical: FloatArray,
    jacobian: FloatArray,
    reach: float,
) -> list[tuple[float, float]]:
    """Intervals of all parameters (SI) that reach out to ``reach`` normal standard errors."""
    problem, solution = fitted.problem, fitted.solution
    values, errors = fitted.theta[problem.free], np.sqrt(np.maximum(np.diag(robust), 0.0))
    wald = [(float(v - reach * e), float(v + reach * e)) for v, e in zip(values, errors, strict=True)]
    if method is Intervals.BOOTSTRAP:
        return bootstrap_intervals(jacobian, solution.residuals, values, fitted.dof, reach)
    if method is Intervals.WALD:
        return wald
    inflation = np.diag(robust) / np.maximum(np.diag(classical), 1e-300)
    scaled = classical / np.outer(problem.scale, problem.scale)
    return [
        profile_interval(problem, solution, j, scaled, float(inflation[j]), reach)
        if np.isfinite(errors[j])
        else wald[j]
        for j in range(len(values))
    ]


def _finish(
    model: Model,
    record: Record,
    test: Record | None,
    rungs: Sequence[Fitted],
    chosen_rung: int,
    window: float,
    by_window: list[WindowEstimate],
    sigma: FloatArray,
    table: tuple[list[statistics.Estimate], FloatArray, FloatArray],
) -> Fit:
    fitted = rungs[chosen_rung]
    rows, robust, jacobian = table
    chosen = [model.parameters[i] for i in fitted.problem.free]
    residuals = fitted.solution.residuals
    inputs = np.repeat(record.inputs[fitted.problem.windows.rows, 0], record.outputs.shape[1])
    return Fit(
        terms=fitted.terms,
        estimates=rows,
        covariance=robust,
        identifiability=identifiability(chosen, fitted.theta[fitted.problem.free], jacobian, fitted.noise),
        theta=fitted.theta,
        window=window,
        by_window=by_window,
        sigma=sigma,
        train=score(model, fitted.theta, record, sigma),
        test=score(model, fitted.theta, test, noise_of(test)) if test is not None else None,
        ljung_box_p=statistics.whiteness(residuals),
        input_crosscorrelation_p=statistics.input_crosscorrelation(residuals, inputs),
        evaluations=sum(rung.problem.evaluations for rung in rungs),
        converged=fitted.solution.converged,
    )


__all__ = ["Fit", "Fitted", "Point", "covariances", "fit", "fit_terms", "free_of", "start_theta", "table_of"]
