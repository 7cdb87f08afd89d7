"""Other minima: parameters whose cost is no parabola are scanned over their whole range.

A width such as the Stribeck velocity is not seen where it is too narrow and passes for viscous friction
where it is too wide; two time constants may change places. In such places the cost is flat or has a minimum
of its own. So the parameter is held at values across its range while all else is refitted, and the best of
them are let go. What ends elsewhere and explains the data about as well is a rival: intervals reach over it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from labhil.cores import side_by_side
from labhil.identify.fitted import ON_THE_WAY, Fitted, covariances
from labhil.identify.least_squares import Solution, least_squares
from labhil.identify.problem import Point, Problem
from labhil.identify.waves import orders_instead
from labhil.physics.terms import Parameter
from labhil.signals import FloatArray

VALUES = 8
AT_FIRST, AFTERWARDS = 2, 5
"""Steps of least squares at every value, and further ones at the better half of them."""

LET_GO = 2

POORLY_KNOWN = 0.05
"""Relative standard error from which the cost of a size may have more than one minimum."""

UNKNOWN = 10.0
"""Relative standard error from which the cost does not know the size at all."""

REACH = 5.0
"""How many times larger and smaller such a size is tried."""

ABOUT_AS_WELL = 12.0
"""Squares of noise by which a rival's cost may exceed the best; intervals judge by their own level."""

ELSEWHERE = 0.5
"""Standard errors from which a minimum is another one."""


def over_shapes(fitted: Fitted) -> Fitted:
    """The best of this fit and those that begin at other values of what is scanned, with its rivals."""
    fits = [fitted]
    errors = _errors(fitted)
    for j, place in enumerate(fitted.problem.free):
        parameter = fitted.problem.model.parameters[place]
        best = min(fits, key=lambda fit: fit.solution.cost)
        if parameter.waves_over and fitted.problem.model.state_names:
            values = orders_instead(best, parameter)
        else:
            values = _values(parameter, float(fitted.theta[place]), float(errors[j]))
        fits.extend(_scan(best, j, values))
    best = min(fits, key=lambda fit: fit.solution.cost)
    return replace(best, rivals=tuple(_rivals(best, fits)))


def beside_rivals(fitted: Fitted, places: tuple[Fitted, ...]) -> Fitted:
    """The best of this fit and those that begin where these other fits stand, with its rivals."""
    problem, fits = fitted.problem, [fitted]
    for place in places:
        begin = Point(place.theta[problem.free] / problem.scale, fitted.solution.point.states)
        solution = least_squares(problem, begin, iterations=30, settled=True, thorough=False)
        fits.append(replace(fitted, theta=problem.theta(solution.point.z), solution=solution))
    best = min(fits, key=lambda fit: fit.solution.cost)
    return replace(best, rivals=tuple(_rivals(best, fits)))


def _values(parameter: Parameter, value: float, error: float) -> FloatArray:
    """Where a parameter is tried; nowhere if its cost is taken for a parabola."""
    if parameter.shape and 0.0 < parameter.lower < parameter.upper < np.inf:
        return np.geomspace(parameter.lower, parameter.upper, VALUES)
    if parameter.term is None and parameter.lower > 0.0 and POORLY_KNOWN * value < error < UNKNOWN * value:
        tried = value * np.geomspace(1.0 / REACH, REACH, VALUES)
        return tried[(tried > parameter.lower) & (tried < parameter.upper)]
    return np.empty(0)


def _scan(fitted: Fitted, j: int, values: FloatArray) -> Iterator[Fitted]:
    """Where the fit ends from the most promising ``values`` (SI) of free parameter ``j``."""
    problem, solution = fitted.problem, fitted.solution
    begin = Point(_without_amplitude(problem, solution.point.z, j), solution.point.states)
    refits = _refit_from(problem, [(begin, value) for value in values.tolist()], j, AT_FIRST)
    better = sorted(refits, key=lambda refit: refit.cost)[: (len(refits) + 1) // 2]
    scale = problem.scale[j]
    again = [(trial.point, float(trial.point.z[j] * scale)) for trial in better]
    refits = _refit_from(problem, again, j, AFTERWARDS)
    for trial in sorted(refits, key=lambda refit: refit.cost)[:LET_GO]:
        freed = least_squares(
            problem, trial.point, iterations=30, tolerance=ON_THE_WAY, settled=True, thorough=False
        )
        yield replace(fitted, theta=problem.theta(freed.point.z), solution=freed)


def _without_amplitude(problem: Problem, z: FloatArray, j: int) -> FloatArray:
    """Scaled parameters with the rest of the term of ``j`` at neutral: a level depends on its width."""
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
    """Fits from each of these points, free parameter ``j`` held at the value beside it (SI)."""
    refits = list(side_by_side(lambda begin: _refit_at(problem, *begin, j, iterations), begins))
    problem.evaluations += sum(evaluations for _, evaluations in refits)
    return [solution for solution, _ in refits]


def _refit_at(problem: Problem, begin: Point, value: float, j: int, iterations: int) -> tuple[Solution, int]:
    """A short fit with free parameter ``j`` held at ``value`` (SI), and how many simulations it took."""
    theta = problem.theta(begin.z)
    theta[problem.free[j]] = value
    held_problem = problem.pin(np.array([j]), theta)
    start = Point(np.delete(begin.z, j), begin.states)
    solution = least_squares(held_problem, start, iterations=iterations, settled=True, thorough=False)
    z = np.insert(solution.point.z, j, value / problem.scale[j])
    return replace(solution, point=Point(z, solution.point.states)), held_problem.evaluations


def _rivals(best: Fitted, fits: list[Fitted]) -> Iterator[Fitted]:
    """The other minima that explain the data about as well, each once."""
    errors = _errors(best)
    known: list[Fitted] = [best]
    for fit in sorted(fits, key=lambda fit: fit.solution.cost):
        if fit.solution.cost > best.solution.cost + ABOUT_AS_WELL * best.noise**2:
            return
        apart = [np.abs(fit.theta - rival.theta)[best.problem.free] > ELSEWHERE * errors for rival in known]
        if all(np.any(places) for places in apart):
            known.append(fit)
            yield replace(fit, rivals=())


def _errors(fitted: Fitted) -> FloatArray:
    _, classical, _ = covariances(fitted)
    return np.asarray(np.sqrt(np.diag(classical)))
