"""Nonlinear least squares with bounds, over parameters and the initial states of all windows.

The method is Levenberg and Marquardt's (Marquardt 1963). The states are nested (``window_states``): after
every step of the parameters each window may improve its own. ``penalised`` adds a quadratic penalty.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from labhil.identify.problem import Linearised, Point, Problem
from labhil.identify.window_products import without_states
from labhil.identify.window_states import (
    MAX_DAMPING,
    States,
    evaluate,
    fit_states,
    reestimate,
    refine,
    rescue_states,
    search_states,
)
from labhil.signals import FloatArray

TOLERANCE = 1e-6
"""Relative decrease of the cost below which a fit has converged."""


@dataclass(frozen=True, slots=True)
class StepOptions:
    """How Levenberg and Marquardt's method chooses its steps; relative figures without unit.

    Attributes:
        initial_damping: Damping of the first step, relative to the diagonal of the normal equations.
        max_damping: Damping beyond which a step is too short to lower the cost.
        min_decrease_by_states: Relative decrease of the cost by better initial states of windows, for which a
            converged fit goes on.
        min_gain_ratio: Actual over predicted decrease of the cost below which the windows first improve their
            own states, before a step is accepted or rejected.
    """

    initial_damping: float = 1e-3
    max_damping: float = MAX_DAMPING
    min_decrease_by_states: float = 1e-3
    min_gain_ratio: float = 0.5


DEFAULT_STEPS = StepOptions()


@dataclass(frozen=True, slots=True)
class Solution:
    """Where a minimisation ended.

    Attributes:
        point: Estimated parameters and states.
        residuals: (N·c,) in units of noise.
        iterations: Number of steps.
        converged: False where the number of steps ran out.
    """

    point: Point
    residuals: FloatArray
    iterations: int
    converged: bool

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
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
    options: StepOptions = DEFAULT_STEPS,
    slopes: Linearised | None = None,
) -> Solution:
    """Minimise the sum of squared residuals from ``start``; bounds hold throughout.

    Args:
        problem: What is estimated.
        start: Where to begin; its parameters are clipped to the bounds.
        iterations: Largest number of steps.
        tolerance: Relative decrease of the cost by a step below which the fit has converged.
        settled: The states of ``start`` belong to a model close by: they are refined, not estimated anew.
        thorough: Estimate the states of outlying windows anew from other starts, first and at convergence.
        on_step: Called with the cost after each step.
        options: How steps are chosen.
        slopes: Those of this problem near ``start``, which serve as long as steps gain at least half of what
            they predict; None where there are none.

    Returns:
        The solution; it has also converged where no damping finds a lower cost.
    """
    z = np.clip(start.z, problem.lower, problem.upper)
    # The measured states are candidates too: a window whose simulated body rests has no slope
    # by which it would ever move again.
    if settled:
        estimate = refine(problem, z, evaluate(problem, z, start.states), evaluate(problem, z, problem.guess))
    else:
        estimate = evaluate(problem, z, fit_states(problem, z, start.states))
    estimate = rescue_states(problem, z, estimate) if thorough else estimate
    point, residuals = Point(z, estimate.states), estimate.residuals
    damping = options.initial_damping
    for iteration in range(iterations):
        cost = float(residuals @ residuals)
        step = _lower_cost(problem, point, residuals, slopes, damping, tolerance, options)
        if step is None and thorough:
            step = _improve_states(problem, point, residuals, options)
        if step is None:
            return Solution(point, residuals, iteration, True)
        point, residuals, damping, slopes = step.point, step.residuals, step.damping, step.slopes
        decrease = cost - float(residuals @ residuals)
        if on_step is not None:
            on_step(cost - decrease)
        if decrease < tolerance * cost:
            better = _improve_states(problem, point, residuals, options) if thorough else None
            if better is None:
                return Solution(point, residuals, iteration + 1, True)
            point, residuals, damping, slopes = better.point, better.residuals, better.damping, None
    return Solution(point, residuals, iterations, False)


def search_lower_minima(
    problem: Problem,
    solution: Solution,
    spread: FloatArray,
    *,
    seed: int = 0,
    restarts: int = 4,
    min_decrease: float = 0.3,
) -> Solution:
    """Search for a lower minimum within the uncertainty of a solution.

    The cost has many shallow minima where windows begin near a stop. Each window therefore looks for better
    initial states, and the fit restarts from parameters that are drawn around the best ones.

    Args:
        problem: What is estimated.
        solution: A converged fit.
        spread: (P, P) square root of the covariance of the scaled parameters.
        seed: Of the random draws.
        restarts: Number of draws.
        min_decrease: Decrease of the cost that makes a minimum a lower one, in mean squared residuals (and
            in squares of the noise at least).

    Returns:
        The best solution, which may be ``solution`` itself.
    """
    random = np.random.default_rng(seed)
    threshold = min_decrease * max(1.0, solution.cost / max(len(solution.residuals), 1))
    slopes = problem.linearise(solution.point, solution.residuals)
    best = _alternate(problem, solution, slopes, threshold, random)
    for _ in range(restarts):
        z = best.point.z + spread @ random.standard_normal(len(best.point.z))
        begin = Point(np.clip(z, problem.lower, problem.upper), best.point.states)
        trial = _fit_nearby(problem, begin, slopes, 12, threshold / best.cost)
        if trial.cost < best.cost - threshold:
            best = _alternate(problem, trial, slopes, threshold, random)
    return best


def _alternate(
    problem: Problem, solution: Solution, slopes: Linearised, threshold: float, random: np.random.Generator
) -> Solution:
    """Improve states and parameters in turn, until the cost falls by less than ``threshold``.

    ``slopes`` are those of a point nearby.
    """
    best = solution
    for _ in range(6):
        states = search_states(problem, best.point.z, best.point.states, random)
        begin = Point(best.point.z, states)
        trial = _fit_nearby(problem, begin, slopes, 20, threshold / best.cost)
        if trial.cost > best.cost - threshold:
            return trial if trial.cost < best.cost else best
        best = trial
    return best


def _fit_nearby(
    problem: Problem, begin: Point, slopes: Linearised, iterations: int, tolerance: float
) -> Solution:
    """Fit from a point near one whose slopes are known."""
    return least_squares(
        problem,
        begin,
        iterations=iterations,
        tolerance=tolerance,
        settled=True,
        thorough=False,
        slopes=slopes,
    )


@dataclass(frozen=True, slots=True)
class _Step:
    """A step that lowered the cost.

    Attributes:
        point: Where it led.
        residuals: (N·c,) there.
        damping: Of the next step.
        slopes: Those for the next step, None where they are to be taken anew.
    """

    point: Point
    residuals: FloatArray
    damping: float
    slopes: Linearised | None = None


def _improve_states(
    problem: Problem, point: Point, residuals: FloatArray, options: StepOptions
) -> _Step | None:
    """The same parameters with better states of some windows, or None where there are none."""
    better = reestimate(problem, point.z, States(point.states, residuals))
    if better.cost < (1.0 - options.min_decrease_by_states) * float(residuals @ residuals):
        return _Step(Point(point.z, better.states), better.residuals, options.initial_damping)
    return None


def _lower_cost(
    problem: Problem,
    point: Point,
    residuals: FloatArray,
    known: Linearised | None,
    damping: float,
    tolerance: float,
    options: StepOptions,
) -> _Step | None:
    """A step to a lower cost; None where no damping finds one.

    Where a step lowers the cost by much less than predicted, the windows improve their own states before it
    is accepted or rejected; slopes that were taken elsewhere (``known``) are first taken anew.
    """
    lin = replace(known, residuals=residuals) if known else problem.linearise(point, residuals)
    cost = float(residuals @ residuals)
    while damping < options.max_damping:
        trial, predicted = _damped_step(problem, point, lin, damping, tolerance * cost, options)
        if abs(predicted) < tolerance * cost:
            return None
        reached = evaluate(problem, trial.z, trial.states)
        is_good = cost - reached.cost >= options.min_gain_ratio * predicted
        if known is not None and not is_good:
            return _lower_cost(problem, point, residuals, None, damping, tolerance, options)
        if not is_good:
            reached = refine(problem, trial.z, reached, evaluate(problem, trial.z, point.states))
        if reached.cost < cost:
            end = Point(trial.z, reached.states)
            return _Step(end, reached.residuals, max(0.1 * damping, 1e-8), known)
        damping *= 8.0
    return None


def _damped_step(
    problem: Problem, point: Point, lin: Linearised, damping: float, least_gain: float, options: StepOptions
) -> tuple[Point, float]:
    """One damped Gauss-Newton step, and the decrease of the cost that the linearised model predicts.

    States are damped, as parameters are, only after a first step failed: where a window is far from its
    minimum, an undamped step of its state leads nowhere however short the step of the parameters is.
    """
    state_damping = damping if damping > options.initial_damping else 0.0
    z = _parameter_step(problem, point, lin, damping, state_damping, least_gain)
    gram = problem.state_gram(lin.by_states, np.full(len(point.states), state_damping))
    linearised = lin.residuals + lin.by_parameters @ (z - point.z)
    gradient = problem.products(lin.by_states, linearised[:, None])
    step = np.asarray(np.linalg.solve(gram, gradient), dtype=np.float64)
    expected = without_states(linearised[:, None], lin.by_states, step, problem.edges)[:, 0]
    predicted = float(lin.residuals @ lin.residuals - expected @ expected)
    return Point(z, point.states - step[:, :, 0] * problem.model.state_scale), predicted


def _parameter_step(
    problem: Problem, point: Point, lin: Linearised, damping: float, state_damping: float, least_gain: float
) -> FloatArray:
    """Scaled parameters (P,) after the best damped step within the bounds."""
    if not len(point.z):
        return point.z
    projected = problem.project(lin, np.column_stack([lin.by_parameters, lin.residuals]), state_damping)
    gradient = lin.by_parameters.T @ projected[:, -1]
    normal = lin.by_parameters.T @ projected[:, :-1]
    diagonal = np.diag(normal)
    normal = normal + np.diag(damping * diagonal + 1e-9 * diagonal.max() + 1e-12)
    lower, upper = problem.reach(point.z)
    step = _worthwhile_step(normal, gradient, least_gain)
    if np.any((point.z + step < lower) | (point.z + step > upper)):
        step = _bounded_minimum(normal, gradient, lower - point.z, upper - point.z)
    return problem.stepped(point.z, step)


def _worthwhile_step(normal: FloatArray, gradient: FloatArray, least_gain: float) -> FloatArray:
    """Minimum (P,) of ½·dᵀ·normal·d + gradientᵀ·d without the directions that lower it next to nothing.

    Along what the data hardly determine a step would be long for a gain below ``least_gain`` in all, and the
    model is no straight line over such lengths.
    """
    unit = np.sqrt(np.diag(normal))
    curvature, directions = np.linalg.eigh(normal / np.outer(unit, unit))
    slope = directions.T @ (gradient / unit)
    lengths = -slope / np.maximum(curvature, 1e-300)
    lengths[slope * -lengths < least_gain / len(slope)] = 0.0
    return np.asarray(directions @ lengths / unit)


def _bounded_minimum(
    normal: FloatArray, gradient: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Minimum (P,) of ½·dᵀ·normal·d + gradientᵀ·d within bounds (Stark and Parker 1995, BVLS)."""
    unit = np.sqrt(np.diag(normal))
    root = np.linalg.cholesky(normal / np.outer(unit, unit)).T
    target = -solve_triangular(root, gradient / unit, trans="T")
    least = np.minimum(lower, 0.0) * unit
    most = np.maximum(upper, 0.0) * unit
    movable = most > least
    step = np.zeros(len(gradient))
    bounds = (least[movable], most[movable])
    step[movable] = lsq_linear(root[:, movable], target, bounds, method="bvls").x
    return step / unit
