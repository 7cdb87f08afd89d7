"""Shapes have local minima: a width such as the Stribeck velocity is scanned over its whole range.

Too narrow and it is not seen, too wide and it passes for viscous friction; in both places the cost is flat
or has a minimum of its own. So the width is held at values across its bounds while all else is refitted,
and the best of them are let go.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labhil.identify.fitted import Fitted
from labhil.identify.least_squares import Solution, least_squares
from labhil.identify.problem import Point, Problem

VALUES = 8
LET_GO = 2
HELD_ITERATIONS = 6


def over_shapes(fitted: Fitted) -> Fitted:
    """The best of this fit and those that begin at other values of its shape parameters."""
    best = fitted
    for place in fitted.problem.free:
        parameter = fitted.problem.model.parameters[place]
        if parameter.shape and 0.0 < parameter.lower < parameter.upper < np.inf:
            best = _scanned(best, int(place))
    return best


def _scanned(fitted: Fitted, place: int) -> Fitted:
    """Scan the shape parameter at ``place`` of the model's vector."""
    problem, solution = fitted.problem, fitted.solution
    parameter = problem.model.parameters[place]
    j = int(np.flatnonzero(problem.free == place)[0])
    held = [
        _held_at(problem, solution.point, j, float(value))
        for value in np.geomspace(parameter.lower, parameter.upper, VALUES)
    ]
    best = fitted
    for trial in sorted(held, key=lambda found: found.cost)[:LET_GO]:
        let_go = least_squares(problem, trial.point, iterations=30, settled=True, thorough=False)
        if let_go.cost < best.solution.cost:
            best = replace(best, theta=problem.theta(let_go.point.z), solution=let_go)
    return best


def _held_at(problem: Problem, begin: Point, j: int, value: float) -> Solution:
    """All but free parameter ``j`` refitted a little, that one held at ``value`` (SI); as a point of all."""
    theta = problem.theta(begin.z)
    theta[problem.free[j]] = value
    others = np.delete(problem.free, j)
    pinned = Problem(problem.model, problem.record, problem.windows, others, theta, problem.sigma)
    start = Point(np.delete(begin.z, j), begin.states)
    found = least_squares(pinned, start, iterations=HELD_ITERATIONS, settled=True, thorough=False)
    whole = np.insert(found.point.z, j, value / problem.scale[j])
    problem.evaluations += pinned.evaluations
    return replace(found, point=Point(whole, found.point.states))
