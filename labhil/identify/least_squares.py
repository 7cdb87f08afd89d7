"""Levenberg and Marquardt's least squares with bounds, over parameters and the states of all windows.

The states are nested: after every step of the parameters each window improves its own state with a
damping of its own, so that one window at a stop or a reversal does not hold back all the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labhil.identify.problem import Linearised, Point, Problem
from labhil.signals import FloatArray

POLISH = 1
"""Steps that each window takes by itself after a step of the parameters."""

OUTLYING = 2.0
"""Windows that cost this many times the median are looked at again."""

OTHER_VELOCITIES = (-0.8, -0.4, -0.2, 0.2, 0.4, 0.8)
"""Where they begin anew, in scales of the state beside the measured velocity."""

TRIALS = 12
"""States that are tried anew in every window when a fit settles."""

NEAR, FAR = 0.05, 0.5
"""How far from the best so far they begin, in scales of the state: two thirds near, one third far."""

SHAKES = 4
"""Times that a settled fit is pushed away, by about its own uncertainty, to see where it comes back to."""

SAME = 0.3
"""Costs that differ by less, in mean squared residuals (at least in squares of noise), are one minimum."""

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
    tolerance: float = 1e-6,
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
        states = polish_states(problem, z, start.states, problem.guess)
    else:
        states = fit_states(problem, z, start.states)
    states = rescue_states(problem, z, states) if thorough else states
    point = Point(z, states)
    residuals = problem.residuals(point)
    damping = 1e-3
    for iteration in range(iterations):
        cost = float(residuals @ residuals)
        found = _lower(problem, point, residuals, damping)
        if found is None and thorough:
            found = _rescued(problem, point, residuals)
        if found is None:
            return Solution(point, residuals, iteration, True)
        point, residuals, damping = found
        gained = cost - float(residuals @ residuals)
        if on_step is not None:
            on_step(cost - gained)
        if gained < tolerance * cost:
            rescued = _rescued(problem, point, residuals) if thorough else None
            if rescued is None:
                return Solution(point, residuals, iteration + 1, True)
            point, residuals, damping = rescued
    return Solution(point, residuals, iterations, False)


def settle(problem: Problem, solution: Solution, spread: FloatArray, *, seed: int = 0) -> Solution:
    """Look for lower minima around a solution; the better one of both is returned.

    The cost has many shallow minima where windows begin near a stop: each window looks for a better
    state, and the parameters are pushed away by about their uncertainty, which the columns of
    ``spread`` (P, P) span, in scaled units. ``seed`` fixes the draws.
    """
    random = np.random.default_rng(seed)
    same = SAME * max(1.0, solution.cost / max(len(solution.residuals), 1))
    best = _deepened(problem, solution, same, random)
    for _ in range(SHAKES):
        z = best.point.z + spread @ random.standard_normal(len(best.point.z))
        begin = Point(np.clip(z, problem.lower, problem.upper), best.point.states)
        trial = least_squares(problem, begin, iterations=12, settled=True, thorough=False)
        if trial.cost < best.cost - same:
            best = _deepened(problem, trial, same, random)
    return best


def _deepened(problem: Problem, solution: Solution, same: float, random: np.random.Generator) -> Solution:
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


def search_states(
    problem: Problem, z: FloatArray, states: FloatArray, random: np.random.Generator, trials: int = TRIALS
) -> FloatArray:
    """Every window's best initial state among many local minima near it, (W, S); parameters held."""
    every = np.ones(states.shape[1], dtype=bool)
    best, costs = states, _window_costs(problem, z, states)
    for k in range(trials if states.shape[1] else 0):
        centre = problem.guess if k % 2 else best
        reach = (FAR if k % 3 == 0 else NEAR) * problem.model.state_scale
        trial = centre + random.standard_normal(best.shape) * reach
        trial = _damped_states(problem, z, trial, 4, every)
        trial_costs = _window_costs(problem, z, trial)
        better = trial_costs < costs
        best, costs = np.where(better[:, None], trial, best), np.where(better, trial_costs, costs)
    return best


def _rescued(problem: Problem, point: Point, residuals: FloatArray) -> tuple[Point, FloatArray, float] | None:
    """The same parameters with better states of outlying windows, or None when there are none."""
    trial = Point(point.z, rescue_states(problem, point.z, point.states))
    trial_residuals = problem.residuals(trial)
    if trial_residuals @ trial_residuals < 0.999 * (residuals @ residuals):
        return trial, trial_residuals, 1e-3
    return None


def _lower(
    problem: Problem, point: Point, residuals: FloatArray, damping: float
) -> tuple[Point, FloatArray, float] | None:
    """A point of lower cost, its residuals and the next damping; None when no damping finds one.

    Where the step by itself does not keep most of what it promised, the windows get the chance to
    improve their own states before it is judged.
    """
    lin = problem.linearise(point, residuals)
    cost = float(residuals @ residuals)
    while damping < 1e6:
        trial, promised = _step(problem, point, lin, damping)
        trial_residuals = problem.residuals(trial)
        lowered = cost - float(trial_residuals @ trial_residuals)
        if lowered < WORTH * promised:
            trial = Point(trial.z, polish_states(problem, trial.z, trial.states, point.states))
            trial_residuals = problem.residuals(trial)
            lowered = cost - float(trial_residuals @ trial_residuals)
        if lowered > 0.0:
            return trial, trial_residuals, max(0.1 * damping, 1e-8)
        damping *= 8.0
    return None


def _step(problem: Problem, point: Point, lin: Linearised, damping: float) -> tuple[Point, float]:
    """One damped Gauss-Newton step, and by how much it promises to lower the cost.

    Parameters that press against a bound stay there.
    """
    z = _parameter_step(problem, point, lin, damping)
    gram = problem.state_gram(lin.by_states)
    remaining = lin.residuals + lin.by_parameters @ (z - point.z)
    pull = problem.per_window(lin.by_states * remaining[:, None])
    states = np.linalg.solve(gram, pull[:, :, None])[:, :, 0]
    expected = remaining - np.einsum("ns,ns->n", lin.by_states, states[problem.owner])
    promised = float(lin.residuals @ lin.residuals - expected @ expected)
    return Point(z, point.states - states * problem.model.state_scale), promised


def _parameter_step(problem: Problem, point: Point, lin: Linearised, damping: float) -> FloatArray:
    if not len(point.z):
        return point.z
    both = problem.project(lin, np.column_stack([lin.by_parameters, lin.residuals]))
    jacobian, residuals = both[:, :-1], both[:, -1]
    gradient = jacobian.T @ residuals
    normal = jacobian.T @ jacobian
    diagonal = np.diag(normal)
    normal = normal + np.diag(damping * diagonal + 1e-9 * diagonal.max() + 1e-12)
    pressed = ((point.z <= problem.lower) & (gradient > 0)) | ((point.z >= problem.upper) & (gradient < 0))
    z = point.z.copy()
    moving = np.flatnonzero(~pressed)
    if len(moving):
        z[moving] -= np.linalg.solve(normal[np.ix_(moving, moving)], gradient[moving])
    return np.clip(z, problem.lower, problem.upper)


def polish_states(problem: Problem, z: FloatArray, *candidates: FloatArray) -> FloatArray:
    """Begin each window at the best of these states, and improve it by itself."""
    if not problem.model.state_names:
        return candidates[0]
    choices = np.stack(candidates)
    costs = np.stack([_window_costs(problem, z, candidate) for candidate in choices])
    begin = choices[np.argmin(costs, axis=0), np.arange(choices.shape[1])]
    return _damped_states(problem, z, begin, POLISH, np.ones(begin.shape[1], dtype=bool))


def fit_states(problem: Problem, z: FloatArray, states: FloatArray, *, iterations: int = 8) -> FloatArray:
    """Find each window's initial state by itself with the parameters held at ``z``, (W, S).

    Rest is one hypothesis: where a window is explained about as well by a body that is not moving,
    its velocity is zero.
    """
    if not states.shape[1]:
        return states
    every = np.ones(states.shape[1], dtype=bool)
    free = _damped_states(problem, z, states, iterations, every)
    moving = np.array([name.endswith("_velocity") for name in problem.model.state_names], dtype=bool)
    at_rest = _damped_states(problem, z, np.where(moving, 0.0, states), iterations, ~moving)
    counts = np.diff(np.r_[problem.edges, len(problem.owner)])
    allowance = np.sum(moving) * np.log(counts)
    rest = _window_costs(problem, z, at_rest) <= _window_costs(problem, z, free) + allowance
    return np.where(rest[:, None], at_rest, free)


def rescue_states(problem: Problem, z: FloatArray, states: FloatArray) -> FloatArray:
    """Give windows that fit far worse than most a fresh start from other velocities.

    Near a stop the state has several local minima, and one window in a wrong one can bend all
    parameters.
    """
    costs = _window_costs(problem, z, states) / np.diff(np.r_[problem.edges, len(problem.owner)])
    bad = np.flatnonzero(costs > OUTLYING * np.median(costs))
    moving = [i for i, name in enumerate(problem.model.state_names) if name.endswith("_velocity")]
    if not len(bad) or not moving:
        return states
    part = problem.of_windows(bad)
    best, best_costs = states[bad], _window_costs(part, z, states[bad])
    for offset in OTHER_VELOCITIES:
        trial = part.guess.copy()
        trial[:, moving] += offset * problem.model.state_scale[moving]
        trial = _damped_states(part, z, trial, 6, np.ones(states.shape[1], dtype=bool))
        trial_costs = _window_costs(part, z, trial)
        better = trial_costs < best_costs
        best, best_costs = np.where(better[:, None], trial, best), np.where(better, trial_costs, best_costs)
    rescued = states.copy()
    rescued[bad] = best
    return rescued


def _window_costs(problem: Problem, z: FloatArray, states: FloatArray) -> FloatArray:
    return problem.per_window(problem.residuals(Point(z, states)) ** 2)


def _damped_states(
    problem: Problem, z: FloatArray, states: FloatArray, iterations: int, which: np.ndarray
) -> FloatArray:
    """Levenberg-Marquardt of all windows at once, each with its own damping."""
    damping = np.full(len(states), 1e-3)
    residuals = problem.residuals(Point(z, states))
    cost = problem.per_window(residuals**2)
    for _ in range(iterations):
        slopes = problem.state_slopes(Point(z, states), residuals) * which
        gram = problem.state_gram(slopes, damping)
        pull = problem.per_window(slopes * residuals[:, None])
        step = np.linalg.solve(gram, pull[:, :, None])[:, :, 0] * which
        trial = states - step * problem.model.state_scale
        trial_residuals = problem.residuals(Point(z, trial))
        trial_cost = problem.per_window(trial_residuals**2)
        better = trial_cost < cost
        states = np.where(better[:, None], trial, states)
        residuals = np.where(better[problem.owner], trial_residuals, residuals)
        damping = np.where(better, np.maximum(0.1 * damping, 1e-8), 10.0 * damping)
        gained = np.where(better, cost - trial_cost, 0.0)
        cost = np.where(better, trial_cost, cost)
        if np.all(gained <= 1e-6 * cost + 1e-12) and np.all(better | (damping > 1.0)):
            break
    return states
