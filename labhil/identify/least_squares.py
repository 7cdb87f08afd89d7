"""Levenberg and Marquardt's least squares with bounds, over parameters and the states of all windows.

The states are nested (``window_states``): after every step of the parameters each window may improve its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labhil.identify.problem import Linearised, Point, Problem
from labhil.identify.window_products import without_states
from labhil.identify.window_states import (
    States,
    evaluate,
    fit_states,
    reestimate,
    refine,
    rescue_states,
    search_states,
)
from labhil.signals import FloatArray

SHAKES = 4
"""Times that a settled fit is pushed away, by about its own uncertainty, to see where it comes back to."""

SAME = 0.3
"""Costs that differ by less, in mean squared residuals (at least in squares of noise), are one minimum."""

DAMPING = 1e-3
"""Of the first step, in diagonals of the normal equations."""

MOST_DAMPING = 1e4
"""A step as short as this lowers no cost any more."""

TOLERANCE = 1e-6
"""Share of the cost that a step has to gain for another one to follow."""

RESCUED = 1e-3
"""Share of the cost that better states of windows have to gain for a fit to go on."""

WORTH = 0.5
"""A step that lowers the cost by less than this share of what it promised is polished."""


@dataclass(frozen=True, slots=True)
class Solution:
    """Where the least squares ended, with the residuals in units of noise."""

    point: Point
    residuals: FloatArray
    iterations: int
    converged: bool

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.residuals @ self.residuals)


def least_squares(
    problem: Problem,
    start: Point,
    *,
    iterations: int = 60,
    tolerance: float = TOLERANCE,
    settled: bool = False,
    thorough: bool = True,
    on_step: Callable[[float], None] | None = None,
) -> Solution:
    """Minimise the sum of squares from ``start``; bounds hold throughout.

    ``settled`` says that the states of ``start`` belong to a model close by, so they are not sought anew;
    ``thorough`` gives outlying windows a second chance.
    Stops when an accepted step lowers the cost by less than ``tolerance`` of it, or when no damping
    finds a lower one.
    """
    z = np.clip(start.z, problem.lower, problem.upper)
    # The measurement is a candidate too: a window that once was taken for a body at rest has no slope
    # by which it would ever move again.
    if settled:
        estimate = refine(problem, z, evaluate(problem, z, start.states), evaluate(problem, z, problem.guess))
    else:
        estimate = evaluate(problem, z, fit_states(problem, z, start.states))
    estimate = rescue_states(problem, z, estimate) if thorough else estimate
    point, residuals = Point(z, estimate.states), estimate.residuals
    damping = DAMPING
    for iteration in range(iterations):
        cost = float(residuals @ residuals)
        step = _lower(problem, point, residuals, damping, tolerance)
        if step is None and thorough:
            step = _rescue(problem, point, residuals)
        if step is None:
            return Solution(point, residuals, iteration, True)
        point, residuals, damping = step
        gained = cost - float(residuals @ residuals)
        if on_step is not None:
            on_step(cost - gained)
        if gained < tolerance * cost:
            rescue = _rescue(problem, point, residuals) if thorough else None
            if rescue is None:
                return Solution(point, residuals, iteration + 1, True)
            point, residuals, damping = rescue
    return Solution(point, residuals, iterations, False)


def settle(problem: Problem, solution: Solution, spread: FloatArray, *, seed: int = 0) -> Solution:
    """Look for lower minima around a solution; the better one of both is returned.

    The cost has many shallow minima where windows begin near a stop: each window looks for a better
    state, and the parameters are pushed away by about their uncertainty, which the columns of
    ``spread`` (P, P) span, in scaled units. ``seed`` fixes the draws.
    """
    random = np.random.default_rng(seed)
    same = SAME * max(1.0, solution.cost / max(len(solution.residuals), 1))
    best = _deepen(problem, solution, same, random)
    for _ in range(SHAKES):
        z = best.point.z + spread @ random.standard_normal(len(best.point.z))
        begin = Point(np.clip(z, problem.lower, problem.upper), best.point.states)
        trial = least_squares(problem, begin, iterations=12, settled=True, thorough=False)
        if trial.cost < best.cost - same:
            best = _deepen(problem, trial, same, random)
    return best


def _deepen(problem: Problem, solution: Solution, same: float, random: np.random.Generator) -> Solution:
    """Better states and better parameters in turn, until neither lowers the cost any more."""
    best = solution
    for _ in range(6):
        states = search_states(problem, best.point.z, best.point.states, random)
        begin = Point(best.point.z, states)
        trial = least_squares(problem, begin, iterations=20, settled=True, thorough=False)
        if trial.cost > best.cost - same:
            return trial if trial.cost < best.cost else best
        best = trial
    return best


def _rescue(problem: Problem, point: Point, residuals: FloatArray) -> tuple[Point, FloatArray, float] | None:
    """The same parameters with better states of some windows, or None when there are none."""
    better = reestimate(problem, point.z, States(point.states, residuals))
    if better.cost < (1.0 - RESCUED) * float(residuals @ residuals):
        return Point(point.z, better.states), better.residuals, DAMPING
    return None


def _lower(
    problem: Problem, point: Point, residuals: FloatArray, damping: float, tolerance: float
) -> tuple[Point, FloatArray, float] | None:
    """A point of lower cost, its residuals and the next damping; None when no damping finds one.

    Where the step by itself does not keep most of what it promised, the windows get the chance to
    improve their own states before it is judged.
    """
    lin = problem.linearise(point, residuals)
    cost = float(residuals @ residuals)
    while damping < MOST_DAMPING:
        trial, promised = _step(problem, point, lin, damping)
        if abs(promised) < tolerance * cost:
            return None
        reached = evaluate(problem, trial.z, trial.states)
        if cost - reached.cost < WORTH * promised:
            reached = refine(problem, trial.z, reached, evaluate(problem, trial.z, point.states))
        if reached.cost < cost:
            return Point(trial.z, reached.states), reached.residuals, max(0.1 * damping, 1e-8)
        damping *= 8.0
    return None


def _step(problem: Problem, point: Point, lin: Linearised, damping: float) -> tuple[Point, float]:
    """One damped Gauss-Newton step, and by how much it promises to lower the cost.

    After a first step that failed, states are damped as parameters are: where a window is far off, its whole
    step leads nowhere however short that of the parameters is. Parameters that press against a bound stay
    there.
    """
    of_states = damping if damping > DAMPING else 0.0
    z = _parameter_step(problem, point, lin, damping, of_states)
    gram = problem.state_gram(lin.by_states, np.full(len(point.states), of_states))
    remaining = lin.residuals + lin.by_parameters @ (z - point.z)
    pull = problem.products(lin.by_states, remaining[:, None])
    states = np.asarray(np.linalg.solve(gram, pull), dtype=np.float64)
    expected = without_states(remaining[:, None], lin.by_states, states, problem.edges)[:, 0]
    promised = float(lin.residuals @ lin.residuals - expected @ expected)
    return Point(z, point.states - states[:, :, 0] * problem.model.state_scale), promised


def _parameter_step(
    problem: Problem, point: Point, lin: Linearised, damping: float, of_states: float
) -> FloatArray:
    if not len(point.z):
        return point.z
    both = problem.project(lin, np.column_stack([lin.by_parameters, lin.residuals]), of_states)
    gradient = lin.by_parameters.T @ both[:, -1]
    normal = lin.by_parameters.T @ both[:, :-1]
    diagonal = np.diag(normal)
    normal = normal + np.diag(damping * diagonal + 1e-9 * diagonal.max() + 1e-12)
    pressed = ((point.z <= problem.lower) & (gradient > 0)) | ((point.z >= problem.upper) & (gradient < 0))
    z = point.z.copy()
    moving = np.flatnonzero(~pressed)
    if len(moving):
        z[moving] -= np.linalg.solve(normal[np.ix_(moving, moving)], gradient[moving])
    return np.clip(z, problem.lower, problem.upper)
