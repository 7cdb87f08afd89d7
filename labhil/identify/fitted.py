"""One set of terms fitted on one cut into windows, and the way from short windows to long ones."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from labhil.cores import side_by_side
from labhil.identify import statistics
from labhil.identify.adequacy import MAX_EXPLAINED_RATIO
from labhil.identify.least_squares import TOLERANCE, Solution, least_squares, search_lower_minima
from labhil.identify.problem import Point, Problem
from labhil.identify.sensitivities import sensitivities
from labhil.identify.windows import fit_windows
from labhil.physics.model import Model, Record, index_of, start_values, starts_of, terms_named
from labhil.signals import FloatArray

WORST_GROWTH = 1.3
SCOUT_ITERATIONS = 8
FIRST_ITERATIONS, LED_ON = 3, 2
"""Steps from every start where there are many, and from how many of them a scout goes on."""


ON_THE_WAY = 1e-4
"""Tolerance of a fit that the next one begins from: near a kink of dry friction steps creep on for little."""

BRIEF_ITERATIONS = 5
"""Steps of a fit that is ended before it came to anything: a second or two, and far below its start."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """A model's vector that was fitted on one cut into windows, with what led there.

    The windows are about ``window`` s long; ``rivals`` are other minima on them that explain the data about
    as well.
    """

    terms: tuple[str, ...]
    theta: FloatArray
    problem: Problem
    solution: Solution
    window: float
    rivals: tuple[Fitted, ...] = ()

    @property
    def noise(self) -> float:
        """Standard deviation of the residuals, in units of the noise of the recording."""
        return float(np.sqrt(self.solution.cost / self.dof))

    @property
    def mean_squares(self) -> FloatArray:
        """Mean square (c,) of each output's residuals, in units of the noise of the recording."""
        outputs = self.solution.residuals.reshape(-1, len(self.problem.sigma))
        return np.asarray(np.sum(outputs**2, axis=0) * outputs.shape[1] / self.dof)

    @property
    def estimates(self) -> dict[str, float]:
        """What was estimated, by key."""
        parameters = self.problem.model.parameters
        return {parameters[place].key: float(self.theta[place]) for place in self.problem.free}

    @property
    def held(self) -> frozenset[str]:
        """Keys of the rig's own parameters that were not estimated though these terms have them free."""
        parameters = self.problem.model.parameters
        free = set(free_of(self.problem.model, self.terms).tolist()) - set(self.problem.free.tolist())
        return frozenset(parameters[i].key for i in free)

    @property
    def dof(self) -> int:
        """Residuals less what was fitted."""
        fitted = len(self.problem.free) + self.solution.point.states.size
        return max(len(self.solution.residuals) - fitted, 1)


def free_of(model: Model, terms: Sequence[str], held: Collection[str] = ()) -> np.ndarray:
    """Places of the parameters that a model with these terms estimates: the rig's own and the terms'.

    Those with a key in ``held`` are not among them.
    """
    chosen = {p.key for term in terms_named(model, terms) for p in term.parameters}
    return np.array(
        [
            i
            for i, p in enumerate(model.parameters)
            if (p.term is None or p.key in chosen) and p.key not in held
        ],
        dtype=np.int64,
    )


def start_theta(model: Model, values: Mapping[str, float] | None = None) -> FloatArray:
    """Every term neutral, the rig's own parameters at their first start, then ``values`` by name."""
    theta = start_values(model.parameters)
    places = index_of(model.parameters)
    for name, value in (values or {}).items():
        if name in places:
            theta[places[name]] = value
    return theta


def with_only(model: Model, theta: FloatArray, terms: Collection[str]) -> FloatArray:
    """The vector with everything neutral that belongs to a term which is not among these, by key."""
    kept = theta.copy()
    for i, parameter in enumerate(model.parameters):
        if parameter.term is not None and parameter.term not in terms:
            kept[i] = parameter.neutral
    return kept


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
    starts: Sequence[Mapping[str, float]] | None = None,
    iterations: int = 60,
    tolerance: float = TOLERANCE,
    thorough: bool = True,
    hopeless: float = float("inf"),
    shapes: bool = True,
    held: Collection[str] = (),
) -> Fitted:
    """Fit a set of terms from several starts and keep the best.

    ``start`` is a vector to begin at (default: everything neutral), ``states`` initial states of the
    same windows under a model close by; the ``new_terms`` (default: all) begin at each of their own
    starts, or the vector at each of these ``starts`` by key. Scouts go a few steps from each, the best
    goes on to the end; ``thorough`` gives outlying windows a second chance there. When no scout comes below
    the cost ``hopeless``, the best scout is the answer. Without ``shapes`` widths such as the Stribeck
    velocity stay where they begin, and parameters with a key in ``held`` always do.
    """
    begin = start_theta(model) if start is None else start
    windows = fit_windows(record, window)
    estimated = free_of(model, terms, held)
    free = estimated if shapes else estimated[[not model.parameters[i].shape for i in estimated]]
    if starts is None:
        fresh = terms_named(model, terms if new_terms is None else new_terms)
        starts = starts_of(model, fresh, record) if fresh else [{}]
    places = index_of(model.parameters)
    problems = []
    for values in starts:
        theta = begin.copy()
        theta[[places[key] for key in values]] = list(values.values())
        problems.append(Problem(model, record, windows, free, theta, sigma))
    limit = SCOUT_ITERATIONS if len(starts) > 1 or hopeless < float("inf") else iterations
    problem, solution = _best_scout(problems, states, limit, tolerance)
    if solution.cost <= hopeless and (thorough or not solution.converged):
        solution = least_squares(
            problem,
            solution.point,
            iterations=iterations,
            tolerance=tolerance,
            settled=True,
            thorough=thorough,
        )
    theta = problem.theta(solution.point.z)
    if not shapes:
        full_problem = Problem(model, record, windows, estimated, theta, sigma)
        full_problem.evaluations = problem.evaluations
        solution = replace(solution, point=Point(full_problem.start().z, solution.point.states))
        problem = full_problem
    return Fitted(tuple(terms), theta, problem, solution, window)


def _best_scout(
    problems: Sequence[Problem], states: FloatArray | None, limit: int, tolerance: float
) -> tuple[Problem, Solution]:
    """The best fit of ``limit`` steps from where each problem begins; of many only the better go so far."""
    many = len(problems) > LED_ON
    solve = partial(least_squares, tolerance=tolerance, thorough=False)

    def start_scout(problem: Problem) -> tuple[Problem, Solution]:
        begin = problem.start() if states is None else Point(problem.start().z, states)
        steps = FIRST_ITERATIONS if many else limit
        return problem, solve(problem, begin, iterations=steps, settled=states is not None)

    def continue_scout(scout: tuple[Problem, Solution]) -> tuple[Problem, Solution]:
        problem, solution = scout
        return problem, solve(problem, solution.point, iterations=limit - FIRST_ITERATIONS, settled=True)

    scouts = sorted(side_by_side(start_scout, problems), key=lambda scout: scout[1].cost)
    if many:
        scouts = list(side_by_side(continue_scout, scouts[:LED_ON]))
    return min(scouts, key=lambda scout: scout[1].cost)


def covariances(fitted: Fitted) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Robust and classical covariance in SI units (P, P), and the projected Jacobian (N, P) by SI units."""
    problem, solution = fitted.problem, fitted.solution
    slopes = sensitivities(problem, solution.point, solution.residuals, fitted.noise)
    jacobian = slopes / problem.scale
    if not jacobian.shape[1]:
        return np.empty((0, 0)), np.empty((0, 0)), jacobian
    unit = np.linalg.norm(jacobian, axis=0)
    unit[unit == 0.0] = 1.0
    scaled = jacobian / unit
    channels = len(problem.sigma)
    robust = statistics.robust_covariance(scaled, solution.residuals, fitted.dof, channels, problem.begins)
    inverse = statistics.inverse_information(scaled)
    lost = np.linalg.norm(jacobian, axis=0) == 0.0
    for matrix in (robust, inverse):
        matrix[lost, lost] = np.inf
    classical = inverse * max(solution.cost, 1e-300) / fitted.dof  # what is not known stays so at no cost
    return robust / np.outer(unit, unit), classical / np.outer(unit, unit), jacobian


def fit_by_continuation(
    model: Model,
    record: Record,
    terms: Sequence[str],
    lengths: Sequence[float],
    sigma: FloatArray,
    *,
    start: FloatArray,
    fresh: Sequence[str],
    held: Collection[str] = (),
    reached: list[Fitted] | None = None,
) -> list[Fitted]:
    """Fit on longer and longer windows (s), each from where the one before ended.

    Short windows lead to the neighbourhood whatever the start, long ones to the estimate. The terms
    ``fresh`` begin at each of their own starts on the first. What ends at a bound has lost its way (a mass,
    on windows too short to show it) and begins once more. ``reached``, an empty list, is filled on the way:
    it holds what there is when the fit is ended early.
    """
    rungs: list[Fitted] = [] if reached is None else reached
    for k, length in enumerate(lengths):
        begin = rungs[-1].theta if rungs else start
        fit = partial(
            fit_terms,
            model,
            record,
            terms,
            length,
            sigma,
            new_terms=() if rungs else fresh,
            held=held,
            tolerance=ON_THE_WAY if k + 1 < len(lengths) else TOLERANCE,
        )
        rung = fit(start=begin)
        restart = _restart_off_bounds(rung, begin)
        if restart is not None:
            rung = min(rung, fit(start=restart), key=lambda fitted: fitted.solution.cost)
        rungs.append(rung)
    return rungs


def _restart_off_bounds(rung: Fitted, begin: FloatArray) -> FloatArray | None:
    """The vector with the rig's sizes that ended at a bound at their start; None if they began there."""
    parameters = rung.problem.model.parameters
    at_bound = [
        i for i in rung.problem.free if parameters[i].term is None and parameters[i].at_bound(rung.theta[i])
    ]
    restart = rung.theta.copy()
    restart[at_bound] = start_values(parameters)[at_bound]
    return None if np.array_equal(restart[at_bound], begin[at_bound]) else restart


def trusted_rung(rungs: Sequence[Fitted], lengths: Sequence[float], horizon: float) -> int:
    """Which of the fits on longer and longer windows (``lengths``, s) is the answer.

    Where some windows, mostly the shortest, fit to the noise: the longest whose residuals have grown by less
    than 30 % over those, since noise that drives the plant itself biases longer ones. Where none fit, the
    model is incomplete and none is free of bias; short windows then are no safer, they only fit the misfit
    with their own initial states. The windows nearest to the scored ``horizon`` (s), which was chosen before
    anything was fitted, give the values that predict best what the model is judged by.
    """
    least = min(rung.noise for rung in rungs)
    if least > MAX_EXPLAINED_RATIO:
        return int(np.argmin(np.abs(np.log(np.asarray(lengths[: len(rungs)]) / horizon))))
    trusted = [i for i, rung in enumerate(rungs) if rung.noise <= WORST_GROWTH * least]
    return max(trusted)


def settle_fit(fitted: Fitted) -> Fitted:
    """The same model, settled in the lowest minimum within its own uncertainty."""
    _, classical, _ = covariances(fitted)
    scale = fitted.problem.scale
    relative = np.nan_to_num(classical / np.outer(scale, scale), posinf=1.0)
    variances, directions = np.linalg.eigh(relative) if len(scale) else (np.empty(0), np.empty((0, 0)))
    spread = directions * np.sqrt(np.clip(variances, 0.0, 1.0))
    solution = search_lower_minima(fitted.problem, fitted.solution, spread)
    return replace(fitted, theta=fitted.problem.theta(solution.point.z), solution=solution)


def fit_briefly(
    model: Model,
    record: Record,
    terms: Sequence[str],
    window: float,
    sigma: FloatArray,
    start: FloatArray,
    *,
    fresh: bool,
) -> Fitted:
    """A few steps from one start: what there is where a fit is ended before it came to anything.

    ``fresh`` terms begin at the first of their own starts, else all begin at ``start``.
    """
    new = terms_named(model, terms) if fresh else ()
    starts = starts_of(model, new, record)[:1] if new else [{}]
    return fit_terms(
        model,
        record,
        terms,
        window,
        sigma,
        start=start,
        starts=starts,
        iterations=BRIEF_ITERATIONS,
        thorough=False,
        shapes=False,
    )
