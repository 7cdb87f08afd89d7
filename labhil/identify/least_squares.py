"""Levenberg and Marquardt's least squares with bounds, over parameters and the states of all windows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labhil.identify.problem import Linearised, Point, Problem
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class Solution:
    """Where the least squares ended: ``cost`` is the sum of squared residuals in units of noise."""

    point: Point
    residuals: FloatArray
    evaluations: int
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
    tolerance: float = 1e-7,
    on_step: Callable[[float], None] | None = None,
) -> Solution:
    """Minimise the sum of squares from ``start``; bounds hold throughout.

    Stops when an accepted step lowers the cost by less than ``tolerance`` of it, or when no damping
    finds a lower one.
    """
    point = Point(np.clip(start.z, problem.lower, problem.upper), start.states)
    residuals = problem.residuals(point)
    damping, evaluations = 1e-3, 1
    for _ in range(iterations):
        lin = problem.linearise(point, residuals)
        evaluations += len(point.z) + point.states.shape[1]
        cost = float(residuals @ residuals)
        lowered = False
        while damping < 1e8 and not lowered:
            trial = _step(problem, point, lin, damping)
            trial_residuals = problem.residuals(trial)
            evaluations += 1
            trial_cost = float(trial_residuals @ trial_residuals)
            lowered = trial_cost < cost
            damping = max(0.2 * damping, 1e-9) if lowered else 5.0 * damping
        if not lowered:
            return Solution(point, residuals, evaluations, True)
        point, residuals = trial, trial_residuals
        if on_step is not None:
            on_step(trial_cost)
        if cost - trial_cost < tolerance * cost:
            return Solution(point, residuals, evaluations, True)
    return Solution(point, residuals, evaluations, False)


def _step(problem: Problem, point: Point, lin: Linearised, damping: float) -> Point:
    """One damped Gauss-Newton step; parameters that press against a bound stay there."""
    z = _parameter_step(problem, point, lin, damping)
    gram = problem.state_gram(lin.by_states, damping)
    remaining = lin.residuals + lin.by_parameters @ (z - point.z)
    pull = problem.per_window(lin.by_states * remaining[:, None])
    states = np.linalg.solve(gram, pull[:, :, None])[:, :, 0]
    return Point(z, point.states - states * problem.model.state_scale)


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


def fit_states(problem: Problem, states: FloatArray, *, iterations: int = 15) -> FloatArray:
    """Find each window's initial state by itself with the parameters held, (W, S).

    Rest is one hypothesis: where a window is explained about as well by a body that is not moving,
    its velocity is zero.
    """
    free = _damped_states(problem, states, iterations, np.ones(states.shape[1], dtype=bool))
    velocity = [i for i, name in enumerate(problem.model.state_names) if name.endswith("_velocity")]
    at_rest = free.copy()
    at_rest[:, velocity] = 0.0
    fixed = np.ones(states.shape[1], dtype=bool)
    fixed[velocity] = False
    at_rest = _damped_states(problem, at_rest, iterations, fixed)
    moving_cost, resting_cost = _window_costs(problem, free), _window_costs(problem, at_rest)
    counts = np.diff(np.r_[problem.edges, len(problem.owner)])
    rest = resting_cost <= moving_cost + len(velocity) * np.log(counts)
    return np.where(rest[:, None], at_rest, free)


def _window_costs(problem: Problem, states: FloatArray) -> FloatArray:
    residuals = problem.residuals(Point(_z(problem), states))
    return problem.per_window(residuals**2)


def _z(problem: Problem) -> FloatArray:
    return problem.base[problem.free] / problem.scale


def _damped_states(
    problem: Problem, states: FloatArray, iterations: int, which: np.ndarray
) -> FloatArray:
    """Levenberg-Marquardt of all windows at once, each with its own damping."""
    damping = np.full(len(states), 1e-3)
    z = _z(problem)
    residuals = problem.residuals(Point(z, states))
    cost = problem.per_window(residuals**2)
    for _ in range(iterations):
        lin = problem.linearise(Point(z, states), residuals)
        slopes = lin.by_states * which
        gram = problem.state_gram(slopes)
        np.einsum("wss->ws", gram)[:] *= 1.0 + damping[:, None]
        pull = problem.per_window(slopes * residuals[:, None])
        step = np.linalg.solve(gram, pull[:, :, None])[:, :, 0] * which
        trial = states - step * problem.model.state_scale
        trial_cost = problem.per_window(problem.residuals(Point(z, trial)) ** 2)
        better = trial_cost < cost
        states = np.where(better[:, None], trial, states)
        damping = np.where(better, np.maximum(0.2 * damping, 1e-9), 8.0 * damping)
        settled = np.abs(cost - np.minimum(trial_cost, cost)) <= 1e-6 * cost
        cost = np.minimum(trial_cost, cost)
        residuals = problem.residuals(Point(z, states))
        if np.all(settled & (better | (damping > 1e3))):
            break
    return states
