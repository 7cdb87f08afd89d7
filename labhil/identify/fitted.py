"""Fit of one set of terms on windows of one length, and continuation from short windows to long ones.

The solver is in least_squares.py. continuation.py makes complete fits of these steps.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from labhil.identify import statistics
from labhil.identify.least_squares import TOLERANCE, Solution, least_squares
from labhil.identify.problem import Point, Problem
from labhil.identify.sensitivities import sensitivities
from labhil.identify.windows import fit_windows
from labhil.physics.model import Model, index_of, start_values, starts_of, terms_named
from labhil.physics.record import Record
from labhil.signals import FloatArray

MAX_RESIDUAL_GROWTH = 1.3
"""Largest ratio of residuals on longer windows to the smallest residuals at which a fit is trusted."""

INTERMEDIATE_TOLERANCE = 1e-4
"""Relative tolerance of a fit that is only a start of the next one. Near a kink of dry friction many more
steps would gain little."""


@dataclass(frozen=True, slots=True)
class ScoutOptions:
    """Iterations of short fits that select one of several starts.

    Attributes:
        iterations: iterations of a short fit.
        first_iterations: iterations from every start, where there are more than ``n_continued``.
        n_continued: number of starts that are then continued to the full number of iterations.
    """

    iterations: int = 8
    first_iterations: int = 3
    n_continued: int = 2


@dataclass(frozen=True)
class Fitted:
    """A fit of one set of terms on windows of one length.

    Attributes:
        terms: keys of the terms.
        theta: (P,), all parameters of the model in SI units.
        problem: the least-squares problem.
        solution: its solution.
        window: approximate length of the windows in s.
        rivals: fits at other minima that explain the data about as well.
    """

    terms: tuple[str, ...]
    theta: FloatArray
    problem: Problem
    solution: Solution
    window: float
    rivals: tuple[Fitted, ...] = ()

    @property
    def noise(self) -> float:
        """Standard deviation of the residuals, in units of the recording's noise."""
        return float(np.sqrt(self.solution.cost / self.dof))

    @property
    def mean_squares(self) -> FloatArray:
        """Mean square (c,) of each output's residuals, in squares of the recording's noise."""
        outputs = self.solution.residuals.reshape(-1, len(self.problem.sigma))
        return np.asarray(np.sum(outputs**2, axis=0) * outputs.shape[1] / self.dof)

    @property
    def estimates(self) -> dict[str, float]:
        """Estimated parameters by key, in SI units."""
        parameters = self.problem.model.parameters
        return {parameters[place].key: float(self.theta[place]) for place in self.problem.free}

    @property
    def held(self) -> frozenset[str]:
        """Keys of parameters that these terms have free but that were held fixed."""
        parameters = self.problem.model.parameters
        free = set(free_parameter_indices(self.problem.model, self.terms).tolist()) - set(
            self.problem.free.tolist()
        )
        return frozenset(parameters[i].key for i in free)

    @property
    def dof(self) -> int:
        """Degrees of freedom: residuals less fitted parameters and initial states, at least 1."""
        fitted = len(self.problem.free) + self.solution.point.states.size
        return max(len(self.solution.residuals) - fitted, 1)

    def with_solution(self, solution: Solution) -> Fitted:
        """The same fit with another solution of its problem."""
        return replace(self, theta=self.problem.theta(solution.point.z), solution=solution)

    @cached_property
    def covariances(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Covariances of the estimates, and the slopes behind them.

        Robust (sandwich) covariance (P, P) and classical covariance (P, P) in SI units; Jacobian (N, P) of
        the residuals by parameters in SI units, the initial states projected out. Variances of parameters
        without effect are infinite.
        """
        problem, solution = self.problem, self.solution
        slopes = sensitivities(problem, solution.point, solution.residuals, self.noise)
        jacobian = slopes / problem.scale
        if not jacobian.shape[1]:
            return np.empty((0, 0)), np.empty((0, 0)), jacobian
        unit = np.linalg.norm(jacobian, axis=0)
        unit[unit == 0.0] = 1.0
        scaled = jacobian / unit
        channels = len(problem.sigma)
        robust = statistics.robust_covariance(scaled, solution.residuals, self.dof, channels, problem.begins)
        inverse = statistics.inverse_information(scaled)
        without_effect = np.linalg.norm(jacobian, axis=0) == 0.0
        for matrix in (robust, inverse):
            matrix[without_effect, without_effect] = np.inf
        # also at zero cost an infinite variance stays infinite
        classical = inverse * max(solution.cost, 1e-300) / self.dof
        return robust / np.outer(unit, unit), classical / np.outer(unit, unit), jacobian


def free_parameter_indices(model: Model, terms: Sequence[str], held: Collection[str] = ()) -> np.ndarray:
    """Indices of the parameters to estimate: the rig's own and those of the terms.

    Args:
        model: the model.
        terms: keys or names of the terms.
        held: keys of parameters to hold fixed.

    Returns:
        Indices into the model's parameters, ascending.
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
    """Parameter vector to start from.

    Args:
        model: the model.
        values: values by key in SI units; others start neutral (terms) or at their first start (the rig's
            own).

    Returns:
        The vector (P,) in SI units.
    """
    theta = start_values(model.parameters)
    places = index_of(model.parameters)
    for name, value in (values or {}).items():
        if name in places:
            theta[places[name]] = value
    return theta


def with_only(model: Model, theta: FloatArray, terms: Collection[str]) -> FloatArray:
    """Copy of a parameter vector (P,) with all terms neutral except those with these keys."""
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
    max_scout_cost: float = float("inf"),
    shapes: bool = True,
    held: Collection[str] = (),
    scouts: ScoutOptions | None = None,
) -> Fitted:
    """Fit a set of terms from several starts, and keep the best.

    A short fit runs from every start; the best one is continued to convergence.

    Args:
        model: the model with all its terms.
        record: the data.
        terms: keys of the terms.
        window: approximate length of the windows in s.
        sigma: (channels,), noise of the channels.
        start: (P,), parameters to start from; by default all terms neutral.
        states: (W, S), initial states of the same windows from a similar model.
        new_terms: terms that start at each of their own start values; by default all.
        starts: sets of values by key to start from, instead of those of ``new_terms``.
        iterations: largest number of iterations.
        tolerance: relative decrease of the cost at which the fit ends.
        thorough: estimate the initial states of outlying windows anew.
        max_scout_cost: cost above which the best short fit is returned as it is.
        shapes: estimate also shape parameters, such as the Stribeck velocity.
        held: keys of parameters to hold fixed.
        scouts: iterations of the short fits; None for the defaults.

    Returns:
        The best fit.
    """
    scouts = scouts or ScoutOptions()
    begin = start_theta(model) if start is None else start
    windows = fit_windows(record, window)
    estimated = free_parameter_indices(model, terms, held)
    free = estimated if shapes else estimated[[not model.parameters[i].shape for i in estimated]]
    if starts is None:
        starting = terms_named(model, terms if new_terms is None else new_terms)
        starts = starts_of(model, starting, record) if starting else [{}]
    thetas = _distinct_starts(model, begin, starts)
    problems = [Problem(model, record, windows, free, theta, sigma) for theta in thetas]
    limit = scouts.iterations if len(problems) > 1 or max_scout_cost < float("inf") else iterations
    problem, solution = _best_scout(problems, states, limit, tolerance, scouts)
    if solution.cost <= max_scout_cost and (thorough or not solution.converged):
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


def _distinct_starts(
    model: Model, begin: FloatArray, starts: Sequence[Mapping[str, float]]
) -> list[FloatArray]:
    """Parameter vectors (P,) of different starts: ``begin`` with each set of values by key."""
    places = index_of(model.parameters)
    thetas = {}
    for values in starts:
        theta = begin.copy()
        theta[[places[key] for key in values]] = list(values.values())
        thetas[theta.tobytes()] = theta
    return list(thetas.values())


def _best_scout(
    problems: Sequence[Problem],
    states: FloatArray | None,
    limit: int,
    tolerance: float,
    options: ScoutOptions,
) -> tuple[Problem, Solution]:
    """The best short fit of ``limit`` iterations; of many starts only the better ones go so far."""
    many = len(problems) > options.n_continued
    solve = partial(least_squares, tolerance=tolerance, thorough=False)

    def start_scout(problem: Problem) -> tuple[Problem, Solution]:
        begin = problem.start() if states is None else Point(problem.start().z, states)
        steps = options.first_iterations if many else limit
        return problem, solve(problem, begin, iterations=steps, settled=states is not None)

    def continue_scout(scout: tuple[Problem, Solution]) -> tuple[Problem, Solution]:
        problem, solution = scout
        further = limit - options.first_iterations
        return problem, solve(problem, solution.point, iterations=further, settled=True)

    scouts = sorted(problems[0].side_by_side(start_scout, problems), key=lambda scout: scout[1].cost)
    if many:
        scouts = list(problems[0].side_by_side(continue_scout, scouts[: options.n_continued]))
    return min(scouts, key=lambda scout: scout[1].cost)


def fit_by_continuation(
    model: Model,
    record: Record,
    terms: Sequence[str],
    lengths: Sequence[float],
    sigma: FloatArray,
    *,
    start: FloatArray,
    new_terms: Sequence[str],
    held: Collection[str] = (),
    reached: list[Fitted] | None = None,
) -> list[Fitted]:
    """Fit on windows of increasing length, each fit from the parameters of the one before.

    Fits on short windows converge from poor starts, fits on long ones are accurate. A parameter of the rig
    that ends at a bound (a mass, on windows too short to determine it) is started once more.

    The first arguments are those of `fit_terms`.

    Args:
        lengths: lengths of the windows in s, ascending.
        start: (P,), parameters to start from.
        new_terms: terms that start at each of their own start values on the first windows.
        held: keys of parameters to hold fixed.
        reached: an empty list that is filled with the fits; it holds the finished ones when the fit is ended
            early.

    Returns:
        One fit for each length.
    """
    fits: list[Fitted] = [] if reached is None else reached
    for k, length in enumerate(lengths):
        begin = fits[-1].theta if fits else start
        fit = partial(
            fit_terms,
            model,
            record,
            terms,
            length,
            sigma,
            new_terms=() if fits else new_terms,
            held=held,
            tolerance=INTERMEDIATE_TOLERANCE if k + 1 < len(lengths) else TOLERANCE,
        )
        fitted = fit(start=begin)
        restart = _restart_off_bounds(fitted, begin)
        if restart is not None:
            fitted = min(fitted, fit(start=restart), key=lambda candidate: candidate.solution.cost)
        fits.append(fitted)
    return fits


def refit_from(fitted: Fitted, begin: Point) -> Fitted:
    """Repeat a fit from another point, on the same windows."""
    return fitted.with_solution(least_squares(fitted.problem, begin, settled=True, thorough=False))


def _restart_off_bounds(fitted: Fitted, begin: FloatArray) -> FloatArray | None:
    """Move the rig's parameters that ended at a bound to their start; None if they began there."""
    parameters = fitted.problem.model.parameters
    at_bound = [
        i
        for i in fitted.problem.free
        if parameters[i].term is None and parameters[i].at_bound(fitted.theta[i])
    ]
    restart = fitted.theta.copy()
    restart[at_bound] = start_values(parameters)[at_bound]
    return None if np.array_equal(restart[at_bound], begin[at_bound]) else restart


def fit_briefly(
    model: Model,
    record: Record,
    terms: Sequence[str],
    window: float,
    sigma: FloatArray,
    start: FloatArray,
    *,
    from_own_starts: bool,
    iterations: int = 5,
) -> Fitted:
    """Fit by a few iterations from one start, for the result of a fit that is ended early.

    The first arguments are those of `fit_terms`.

    Args:
        from_own_starts: terms start at the first of their own start values, not at ``start``.
        iterations: number of iterations; five take a second or two and lower the cost far below its start.
    """
    new = terms_named(model, terms) if from_own_starts else ()
    starts = starts_of(model, new, record)[:1] if new else [{}]
    return fit_terms(
        model,
        record,
        terms,
        window,
        sigma,
        start=start,
        starts=starts,
        iterations=iterations,
        thorough=False,
        shapes=False,
    )
