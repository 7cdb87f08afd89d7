"""Search for other local minima by profiles over parameters whose cost is far from quadratic.

A width such as the Stribeck velocity has no effect where it is too narrow, and acts like viscous friction
where it is too wide; two time constants may swap. There the cost is flat or has another local minimum. So the
parameter is fixed at values across its range while all others are refitted (the profile of the cost), and the
best of these fits are continued with the parameter free. One that ends at a different minimum and explains
the data about as well is a rival: confidence intervals (table.py) include it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from labhil.identify.fitted import INTERMEDIATE_TOLERANCE, Fitted
from labhil.identify.identifiability import (
    MIN_COMPONENT,
    covariance_without,
    pivots,
    relative_svd,
    undetermined_directions,
)
from labhil.identify.intervals import path_of
from labhil.identify.least_squares import Solution, least_squares
from labhil.identify.problem import Linearised, Point, Problem, evenly_spread
from labhil.identify.waves import scan_orders
from labhil.signals import FloatArray, IntArray

POORLY_KNOWN_RELATIVE_ERROR = 0.05
"""Relative standard error from which the cost of a size may have more than one minimum; a heuristic."""


@dataclass(frozen=True, slots=True)
class ProfileOptions:
    """Options of the search for other minima; the values are heuristics.

    Attributes:
        n_values: values at which a parameter is fixed.
        iterations: iterations of least squares at each value.
        further_iterations: iterations that follow at the better half of the values.
        n_freed: fits that are continued with the parameter free.
        min_relative_error: relative standard error from which a size is scanned.
        max_relative_error: relative standard error from which the data do not determine a size at all.
        range_factor: a size is scanned from this factor below to this factor above its value.
        max_cost_difference: largest cost of a rival above the best, in squares of the noise. Intervals apply
            their own level to rivals.
        min_distance_in_errors: distance of two different minima in some parameter, in standard errors.
        max_cost_ratio: cost at a point of a profile over the lowest, up to which a minimum may be near.
        min_barrier: height of a profile between two different minima, in squares of the noise.
        min_decrease: decrease of the cost by a step, in squares of the noise, below which the fit of a rival
            ends.
        n_windows: profiles are taken over so many windows, evenly spread.
    """

    n_values: int = 8
    iterations: int = 2
    further_iterations: int = 5
    n_freed: int = 2
    min_relative_error: float = POORLY_KNOWN_RELATIVE_ERROR
    max_relative_error: float = 5.0
    range_factor: float = 5.0
    max_cost_difference: float = 12.0
    min_distance_in_errors: float = 0.5
    max_cost_ratio: float = 2.0
    min_barrier: float = 1.0
    min_decrease: float = 0.3
    n_windows: int = 12


def profile_shapes(fitted: Fitted, options: ProfileOptions | None = None) -> Fitted:
    """Search for lower and rival minima along every parameter whose cost is far from quadratic.

    Of each direction that the data do not determine, one parameter is held: along it all minima are one.

    Args:
        fitted: a fit.
        options: options of the search; None for the defaults.

    Returns:
        The fit of lowest cost, with its rivals.
    """
    options = options or ProfileOptions()
    best, *others = _scan(fitted, _shape_values(fitted, options), options)
    best, *more = _scan(best, _size_values(best, options), options)
    return replace(best, rivals=tuple(_rivals(best, [best, *others, *more], options)))


Scans = dict[int, FloatArray]
"""Values (SI) of free parameters to scan, by their index."""


def _shape_values(fitted: Fitted, options: ProfileOptions) -> Scans:
    """Values across the bounds of shapes, and orders of periodic terms that explain most."""
    problem, scans = fitted.problem, {}
    for j, place in enumerate(problem.free):
        parameter = problem.model.parameters[place]
        if parameter.waves_over and problem.model.state_names:
            scans[j] = np.sort(scan_orders(fitted, parameter))
        elif parameter.shape and 0.0 < parameter.lower < parameter.upper < np.inf:
            scans[j] = np.geomspace(parameter.lower, parameter.upper, options.n_values)
    return scans


def _size_values(fitted: Fitted, options: ProfileOptions) -> Scans:
    """Values of positive constants of the rig, of one for each direction that the data know poorly.

    Several constants may be known poorly because of one direction: along it they have one profile.
    """
    problem = fitted.problem
    parameters, values = [problem.model.parameters[i] for i in problem.free], fitted.theta[problem.free]
    sizes = np.array(
        [j for j, p in enumerate(parameters) if p.term is None and p.lower > 0.0], dtype=np.int64
    )
    if not len(sizes):
        return {}
    _, singular, rows = relative_svd(parameters, values, fitted.covariances[2])
    errors = fitted.noise / np.maximum(singular, 1e-300)
    poor = (errors > options.min_relative_error) & (errors < options.max_relative_error)
    directions = rows[poor][:, sizes]
    directions = directions[np.abs(directions).max(axis=1, initial=0.0) > MIN_COMPONENT]
    factors = np.geomspace(1.0 / options.range_factor, options.range_factor, options.n_values)
    scans = {int(sizes[k]): values[sizes[k]] * factors for k in pivots(directions)}
    return {j: v[(v > parameters[j].lower) & (v < parameters[j].upper)] for j, v in scans.items()}


def _scan(fitted: Fitted, scans: Scans, options: ProfileOptions) -> list[Fitted]:
    """Fits from other minima along the profiles of some parameters, and the fit itself, the best first."""
    fits, valley = [fitted], None
    for j, values in scans.items():
        best = min(fits, key=lambda fit: fit.solution.cost)
        if len(values):
            valley = valley if valley and valley.fitted is best else Valley.of(best, options)
            fits.extend(_profile(valley, j, values, options))
    return sorted(fits, key=lambda fit: fit.solution.cost)


class Valley:
    """The surroundings of a fit in which profiles are taken: its slopes, and what the data do not determine.

    Args:
        fitted: the fit.
        held: indices of free parameters to hold, one for each direction that the data do not determine.
        n_windows: number of windows that are simulated.

    Attributes:
        fitted: the fit.
        problem: its problem on these windows.
        bottom: its solution there.
    """

    def __init__(self, fitted: Fitted, held: IntArray, n_windows: int) -> None:
        self.fitted = fitted
        self.held = held
        self._chosen = evenly_spread(len(fitted.problem.windows), n_windows)
        self.problem = fitted.problem.select_windows(self._chosen)
        begin = Point(fitted.solution.point.z, fitted.solution.point.states[self._chosen])
        residuals = self.problem.residuals(begin)
        self.bottom = replace(fitted.solution, point=begin, residuals=residuals)
        _, _, jacobian = fitted.covariances
        self._covariance = np.zeros((len(fitted.problem.free),) * 2)
        kept = np.delete(np.arange(len(self._covariance)), held)
        self._covariance[np.ix_(kept, kept)] = covariance_without(jacobian * fitted.problem.scale, held)

    @cached_property
    def slopes(self) -> Linearised:
        """Slopes at the bottom."""
        return self.problem.linearise(self.bottom.point, self.bottom.residuals)

    @classmethod
    def of(cls, fitted: Fitted, options: ProfileOptions) -> Valley:
        """The surroundings of a fit, as far as its data determine them."""
        parameters = [fitted.problem.model.parameters[i] for i in fitted.problem.free]
        values, jacobian = fitted.theta[fitted.problem.free], fitted.covariances[2]
        held, _ = undetermined_directions(parameters, values, jacobian, fitted.noise)
        return cls(fitted, held, options.n_windows)

    def in_all_windows(self, point: Point) -> Point:
        """The same point with the states of all windows of the fit."""
        states = self.fitted.solution.point.states.copy()
        states[self._chosen] = point.states
        return Point(point.z, states)

    def along(self, j: int, value: float) -> FloatArray:
        """Scaled parameters (P,) with free parameter ``j`` at ``value`` (SI), the others following.

        Other parameters follow a size to first order; a term begins without amplitude.
        """
        problem = self.fitted.problem
        z = self.bottom.point.z.copy()
        if problem.model.parameters[problem.free[j]].term is not None:
            amplitudes = _amplitudes(problem, j)
            z[amplitudes] = [problem.model.parameters[problem.free[i]].neutral for i in amplitudes]
            z[amplitudes] /= problem.scale[amplitudes]
            z[j] = value / problem.scale[j]
            return z
        variance = self._covariance[j, j]
        following = self._covariance[:, j] / variance if variance else np.eye(len(z))[j]
        path = path_of(problem, j, following)
        return path(z, value / problem.scale[j])

    def refit(self, begin: Point, j: int, iterations: int) -> tuple[Solution, int]:
        """A short fit with free parameter ``j`` where it is, and its number of simulations.

        It begins with the valley's slopes if ``j`` is a size; a shape changes the slopes by its term.
        """
        places = np.union1d(self.held, [j]).astype(np.int64)
        kept = np.delete(np.arange(len(begin.z)), places)
        pinned = self.problem.pin(places, self.problem.theta(begin.z))
        is_size = self.problem.model.parameters[self.problem.free[j]].term is None
        solution = least_squares(
            pinned,
            Point(begin.z[kept], begin.states),
            iterations=iterations,
            settled=True,
            thorough=False,
            slopes=self.slopes.without(places) if is_size else None,
        )
        z = begin.z.copy()
        z[kept] = solution.point.z
        return replace(solution, point=Point(z, solution.point.states)), pinned.evaluations


def refit_from_rivals(
    fitted: Fitted, starts: tuple[Fitted, ...], options: ProfileOptions | None = None
) -> Fitted:
    """Refit from the parameters of other fits, rivals on shorter windows for example.

    Args:
        fitted: a fit.
        starts: fits of the same parameters.
        options: limits of what counts as a rival; None for the defaults.

    Returns:
        The fit of lowest cost, with its rivals.
    """
    options = options or ProfileOptions()
    problem, fits = fitted.problem, [fitted]
    tolerance = options.min_decrease * fitted.noise**2 / max(fitted.solution.cost, 1e-300)
    for start in starts:
        begin = Point(start.theta[problem.free] / problem.scale, fitted.solution.point.states)
        solution = least_squares(
            problem, begin, iterations=30, tolerance=tolerance, settled=True, thorough=False
        )
        fits.append(fitted.with_solution(solution))
    best = min(fits, key=lambda fit: fit.solution.cost)
    return replace(best, rivals=tuple(_rivals(best, fits, options)))


def _profile(valley: Valley, j: int, values: FloatArray, options: ProfileOptions) -> Iterator[Fitted]:
    """Fits from the minima of the profile over ``values`` (SI) of free parameter ``j`` beside the fit's own.

    Orders of a periodic term are no grid: each lies near a minimum.
    """
    fitted, problem = valley.fitted, valley.fitted.problem
    begins = [Point(valley.along(j, value), valley.bottom.point.states) for value in values.tolist()]
    trials = _refits(valley, begins, j, options.iterations)
    better = sorted(range(len(trials)), key=lambda k: trials[k].cost)[: (len(trials) + 1) // 2]
    further = _refits(valley, [trials[k].point for k in better], j, options.further_iterations)
    for k, trial in zip(better, further, strict=True):
        trials[k] = trial
    own = int(np.searchsorted(values, fitted.theta[problem.free[j]]))
    profile = [*trials[:own], valley.bottom, *trials[own:]]
    is_order = bool(problem.model.parameters[problem.free[j]].waves_over)
    minima = trials if is_order else _other_minima(profile, own, options.min_barrier * fitted.noise**2)
    near = [trial for trial in minima if trial.cost < options.max_cost_ratio * valley.bottom.cost]
    for trial in sorted(near, key=lambda trial: trial.cost)[: options.n_freed]:
        freed = least_squares(
            problem,
            valley.in_all_windows(trial.point),
            iterations=30,
            tolerance=INTERMEDIATE_TOLERANCE,
            settled=True,
            thorough=False,
        )
        yield fitted.with_solution(freed)


def _refits(valley: Valley, begins: Sequence[Point], j: int, iterations: int) -> list[Solution]:
    """Refit from each point with free parameter ``j`` where it is there."""
    problem = valley.fitted.problem
    refits = list(problem.side_by_side(lambda begin: valley.refit(begin, j, iterations), begins))
    problem.evaluations += sum(evaluations for _, evaluations in refits)
    return [solution for solution, _ in refits]


def _other_minima(profile: Sequence[Solution], own: int, barrier: float) -> list[Solution]:
    """Minima among the points of a profile from which the cost rises by ``barrier`` on the way to ``own``."""
    costs = np.array([np.inf, *(solution.cost for solution in profile), np.inf])
    minima = []
    for i, solution in enumerate(profile):
        is_lowest = costs[i + 1] <= costs[i] and costs[i + 1] < costs[i + 2]
        between = costs[min(i, own) + 1 : max(i, own) + 2]
        if i != own and is_lowest and between.max() >= costs[i + 1] + barrier:
            minima.append(solution)
    return minima


def _amplitudes(problem: Problem, j: int) -> IntArray:
    """Indices of the free parameters that are amplitudes of the term of ``j``: they depend on its shape."""
    parameters = [problem.model.parameters[i] for i in problem.free]
    term, recording = parameters[j].term, parameters[j].recording
    return np.array(
        [
            i
            for i, p in enumerate(parameters)
            if term is not None
            and p.term == term
            and not p.shape
            and (recording is None or p.recording in (None, recording))
        ],
        dtype=np.int64,
    )


def _rivals(best: Fitted, fits: list[Fitted], options: ProfileOptions) -> Iterator[Fitted]:
    """The other minima that explain the data about as well, each once."""
    errors = np.sqrt(np.diag(best.covariances[1]))
    known: list[Fitted] = [best]
    for fit in sorted(fits, key=lambda fit: fit.solution.cost):
        if fit.solution.cost > best.solution.cost + options.max_cost_difference * best.noise**2:
            return
        limits = options.min_distance_in_errors * errors
        distant = [np.abs(fit.theta - rival.theta)[best.problem.free] > limits for rival in known]
        if all(np.any(parameters) for parameters in distant):
            known.append(fit)
            yield replace(fit, rivals=())
