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

import numpy as np

from labhil.cores import side_by_side
from labhil.identify.fitted import INTERMEDIATE_TOLERANCE, Fitted, covariances
from labhil.identify.least_squares import Solution, least_squares
from labhil.identify.problem import Point, Problem
from labhil.identify.waves import scan_orders
from labhil.physics.terms import Parameter
from labhil.signals import FloatArray

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
    """

    n_values: int = 8
    iterations: int = 2
    further_iterations: int = 5
    n_freed: int = 2
    min_relative_error: float = POORLY_KNOWN_RELATIVE_ERROR
    max_relative_error: float = 10.0
    range_factor: float = 5.0
    max_cost_difference: float = 12.0
    min_distance_in_errors: float = 0.5


def profile_shapes(fitted: Fitted, options: ProfileOptions | None = None) -> Fitted:
    """Search for lower and rival minima along every parameter whose cost is far from quadratic.

    Args:
        fitted: a fit.
        options: options of the search; None for the defaults.

    Returns:
        The fit of lowest cost, with its rivals.
    """
    options = options or ProfileOptions()
    fits = [fitted]
    errors = _errors(fitted)
    for j, place in enumerate(fitted.problem.free):
        parameter = fitted.problem.model.parameters[place]
        best = min(fits, key=lambda fit: fit.solution.cost)
        if parameter.waves_over and fitted.problem.model.state_names:
            values = scan_orders(best, parameter)
        else:
            values = _profile_values(parameter, float(fitted.theta[place]), float(errors[j]), options)
        fits.extend(_profile(best, j, values, options))
    best = min(fits, key=lambda fit: fit.solution.cost)
    return replace(best, rivals=tuple(_rivals(best, fits, options)))


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
    for start in starts:
        begin = Point(start.theta[problem.free] / problem.scale, fitted.solution.point.states)
        solution = least_squares(problem, begin, iterations=30, settled=True, thorough=False)
        fits.append(replace(fitted, theta=problem.theta(solution.point.z), solution=solution))
    best = min(fits, key=lambda fit: fit.solution.cost)
    return replace(best, rivals=tuple(_rivals(best, fits, options)))


def _profile_values(parameter: Parameter, value: float, error: float, options: ProfileOptions) -> FloatArray:
    """Values at which a parameter is fixed; none if its cost counts as quadratic."""
    if parameter.shape and 0.0 < parameter.lower < parameter.upper < np.inf:
        return np.geomspace(parameter.lower, parameter.upper, options.n_values)
    least, most = options.min_relative_error * value, options.max_relative_error * value
    if parameter.term is None and parameter.lower > 0.0 and least < error < most:
        values = value * np.geomspace(1.0 / options.range_factor, options.range_factor, options.n_values)
        return values[(values > parameter.lower) & (values < parameter.upper)]
    return np.empty(0)


def _profile(fitted: Fitted, j: int, values: FloatArray, options: ProfileOptions) -> Iterator[Fitted]:
    """Fits that start from the best points of the profile over ``values`` (SI) of free parameter ``j``."""
    problem, solution = fitted.problem, fitted.solution
    begin = Point(_without_amplitude(problem, solution.point.z, j), solution.point.states)
    refits = _refit_from(problem, [(begin, value) for value in values.tolist()], j, options.iterations)
    better = sorted(refits, key=lambda refit: refit.cost)[: (len(refits) + 1) // 2]
    scale = problem.scale[j]
    again = [(trial.point, float(trial.point.z[j] * scale)) for trial in better]
    refits = _refit_from(problem, again, j, options.further_iterations)
    for trial in sorted(refits, key=lambda refit: refit.cost)[: options.n_freed]:
        freed = least_squares(
            problem,
            trial.point,
            iterations=30,
            tolerance=INTERMEDIATE_TOLERANCE,
            settled=True,
            thorough=False,
        )
        yield replace(fitted, theta=problem.theta(freed.point.z), solution=freed)


def _without_amplitude(problem: Problem, z: FloatArray, j: int) -> FloatArray:
    """Scaled parameters with the amplitudes of the term of ``j`` at neutral: they depend on its width."""
    parameters = [problem.model.parameters[i] for i in problem.free]
    term, recording = parameters[j].term, parameters[j].recording
    others = [
        i
        for i, p in enumerate(parameters)
        if term is not None
        and p.term == term
        and not p.shape
        and (recording is None or p.recording in (None, recording))
    ]
    begin = z.copy()
    begin[others] = [parameters[i].neutral / problem.scale[i] for i in others]
    return begin


def _refit_from(
    problem: Problem, begins: Sequence[tuple[Point, float]], j: int, iterations: int
) -> list[Solution]:
    """Refit from each point, with free parameter ``j`` fixed at the point's value (SI)."""
    refits = list(side_by_side(lambda begin: _refit_at(problem, *begin, j, iterations), begins))
    problem.evaluations += sum(evaluations for _, evaluations in refits)
    return [solution for solution, _ in refits]


def _refit_at(problem: Problem, begin: Point, value: float, j: int, iterations: int) -> tuple[Solution, int]:
    """A short fit with free parameter ``j`` fixed at ``value`` (SI), and its number of simulations."""
    theta = problem.theta(begin.z)
    theta[problem.free[j]] = value
    held_problem = problem.pin(np.array([j]), theta)
    start = Point(np.delete(begin.z, j), begin.states)
    solution = least_squares(held_problem, start, iterations=iterations, settled=True, thorough=False)
    z = np.insert(solution.point.z, j, value / problem.scale[j])
    return replace(solution, point=Point(z, solution.point.states)), held_problem.evaluations


def _rivals(best: Fitted, fits: list[Fitted], options: ProfileOptions) -> Iterator[Fitted]:
    """The other minima that explain the data about as well, each once."""
    errors = _errors(best)
    known: list[Fitted] = [best]
    for fit in sorted(fits, key=lambda fit: fit.solution.cost):
        if fit.solution.cost > best.solution.cost + options.max_cost_difference * best.noise**2:
            return
        limits = options.min_distance_in_errors * errors
        distant = [np.abs(fit.theta - rival.theta)[best.problem.free] > limits for rival in known]
        if all(np.any(parameters) for parameters in distant):
            known.append(fit)
            yield replace(fit, rivals=())


def _errors(fitted: Fitted) -> FloatArray:
    """Classical standard errors (P,) in SI units."""
    _, classical, _ = covariances(fitted)
    return np.asarray(np.sqrt(np.diag(classical)))
