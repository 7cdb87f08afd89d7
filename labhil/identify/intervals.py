"""Confidence intervals beyond Wald's: profile likelihood, block bootstrap, simultaneous intervals.

Wald's interval, value ± q·standard error, is right where the cost is a parabola. A profile follows the cost
itself, with every other parameter and all states refitted at each value (Venzon and Moolgavkar 1988), which
is right at bounds and for nonlinear models. The bootstrap draws blocks of residuals (Künsch 1989), which
keeps their correlation. ``table`` chooses among them for each parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum

import numpy as np
from scipy import stats

from labhil.errors import UnknownNameError
from labhil.identify.least_squares import Solution, least_squares
from labhil.identify.problem import Point, Problem
from labhil.identify.sensitivities import sensitivities
from labhil.identify.statistics import ALPHA, bandwidth, inverse_information, recording_slices
from labhil.identify.window_states import search_states
from labhil.signals import FloatArray

MAX_LOG_STEP = 2.3
"""Logarithm of the largest factor, 10, by which a positive constant is moved in one step."""


class Intervals(StrEnum):
    """How intervals are made."""

    AUTO = "auto"
    """Profiles where the cost is no parabola (terms with a shape, poorly known constants), else Wald's."""
    WALD = "wald"
    PROFILE = "profile"
    BOOTSTRAP = "bootstrap"


def interval_method(name: str) -> Intervals:
    """Look up a method by its name.

    Raises:
        UnknownNameError: There is no such method; the message lists those that exist.
    """
    if name not in set(Intervals):
        raise UnknownNameError("interval method", name, [method.value for method in Intervals])
    return Intervals(name)


def quantile(level: float = 1.0 - ALPHA) -> float:
    """Two-sided normal quantile of a confidence level: 2.58 for 99 %."""
    return float(stats.norm.ppf(0.5 + 0.5 * level))


def simultaneous_quantile(
    covariance: FloatArray, level: float = 1.0 - ALPHA, seed: int = 0, *, draws: int = 100_000
) -> float:
    """Half the width, in standard errors, with which all intervals hold together with a probability.

    It is the quantile of the largest of correlated normal deviates (sup-t), from random draws.

    Args:
        covariance: (P, P) of the estimates; parameters without a finite error do not count.
        level: The probability.
        seed: Of the random draws.
        draws: Number of them.
    """
    known = np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0)
    if not np.any(known):
        return quantile(level)
    chosen = covariance[np.ix_(known, known)]
    error = np.sqrt(np.diag(chosen))
    values, vectors = np.linalg.eigh(chosen / np.outer(error, error))
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    deviates = np.random.default_rng(seed).standard_normal((draws, len(error))) @ root.T
    return float(np.quantile(np.abs(deviates).max(axis=1), level))


def bootstrap_intervals(
    jacobian: FloatArray,
    residuals: FloatArray,
    values: FloatArray,
    dof: int,
    reach: float,
    seed: int = 0,
    begins: Sequence[int] = (0,),
    *,
    draws: int = 2000,
) -> list[tuple[float, float]]:
    """Basic intervals from a moving-block bootstrap of the residuals, each refit by one Gauss-Newton step.

    Blocks are four times Andrews' bandwidth long and at least 10 samples; none spans two recordings.

    Args:
        jacobian: (N, P) with the states projected out, per SI unit.
        residuals: (N,) in units of noise.
        values: (P,) estimates, SI units.
        dof: Degrees of freedom of the residuals.
        reach: Two-sided normal quantile whose probability the intervals have.
        seed: Of the random draws.
        begins: Rows at which recordings begin.
        draws: Number of bootstrap samples.

    Returns:
        Lower and upper end for each parameter, SI units.
    """
    n = len(residuals)
    unit = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    gain = (inverse_information(jacobian / unit) @ (jacobian / unit).T) / unit[:, None]
    spans = [(rows.start, rows.stop) for rows in recording_slices(begins, n)]
    shortest = min(last - first for first, last in spans)
    scores = jacobian * residuals[:, None]
    length = int(np.clip(4 * bandwidth(scores, begins), 10, max(min(n // 4, shortest), 1)))
    allowed = np.concatenate([np.arange(first, last - length + 1) for first, last in spans])
    centred = (residuals - residuals.mean()) * np.sqrt(n / dof)
    random = np.random.default_rng(seed)
    blocks = -(-n // length)
    within = np.arange(length)
    shifts = np.empty((draws, len(values)))
    for k in range(draws):
        rows = (allowed[random.integers(0, len(allowed), blocks)][:, None] + within).ravel()[:n]
        shifts[k] = gain @ centred[rows]
    tail = float(stats.norm.sf(reach))
    # the basic bootstrap reflects the distribution of the errors
    low, high = np.quantile(shifts, [1.0 - tail, tail], axis=0)
    return [(float(v - a), float(v - b)) for v, a, b in zip(values, low, high, strict=True)]


def profile_interval(
    problem: Problem, solution: Solution, j: int, covariance: FloatArray, inflation: float, reach: float
) -> tuple[float, float]:
    """Find where the likelihood profile of a parameter crosses its threshold.

    Args:
        problem: What was estimated.
        solution: The best fit.
        j: Index of the parameter among the free ones.
        covariance: (P, P) classical covariance of the scaled parameters, for the first step and for the
            direction in which the other parameters follow.
        inflation: Robust over classical variance, by which the threshold grows where residuals are
            correlated.
        reach: Two-sided normal quantile of the level; the threshold is its square.

    Returns:
        Lower and upper end, SI units; a bound where the profile does not cross the threshold.
    """
    dof = max(len(solution.residuals) - len(problem.free) - solution.point.states.size, 1)
    threshold = reach**2 * inflation * solution.cost / dof
    along = covariance[:, j] / covariance[j, j]
    error = float(np.sqrt(inflation * covariance[j, j]))
    if problem.model.parameters[problem.free[j]].in_steps:
        error = max(error, problem.step[j])  # the slope within a step is unrelated to its width
    path = _path_of(problem, j, along)
    ends = [
        _find_crossing(problem, solution, j, path, side * reach * error, threshold) * problem.scale[j]
        for side in (-1, 1)
    ]
    return min(ends), max(ends)


Path = Callable[[FloatArray, float], FloatArray]


def _path_of(problem: Problem, j: int, along: FloatArray) -> Path:
    """How all parameters (P,) change when ``j`` is moved to a value, to first order, within bounds.

    With a positive constant all change by factors: data often determine such constants only up to products
    of powers.
    """

    def straight(z: FloatArray, value: float) -> FloatArray:
        return np.clip(z + (value - z[j]) * along, problem.lower, problem.upper)

    def by_factors(z: FloatArray, value: float) -> FloatArray:
        powers = np.divide(along * z[j], z, out=np.zeros_like(z), where=z != 0.0)
        scaled = z * np.exp(np.clip(powers * np.log(value / z[j]), -MAX_LOG_STEP, MAX_LOG_STEP))
        return np.clip(scaled, problem.lower, problem.upper)

    return by_factors if problem.is_positive_constant(j) else straight


def _find_crossing(
    problem: Problem,
    solution: Solution,
    j: int,
    path: Path,
    step: float,
    threshold: float,
    *,
    max_steps: int = 6,
    tolerance: float = 0.06,
) -> float:
    """Scaled value of parameter ``j`` at which its profile has risen by ``threshold``, or its bound.

    ``tolerance`` is that of the rise's square root, relative to the threshold's.
    """
    centre, point = solution.point.z[j], solution.point
    by_factors = problem.is_positive_constant(j)
    if by_factors:
        step = float(np.clip(step / centre, -MAX_LOG_STEP, MAX_LOG_STEP))
    z = centre
    for number in range(max_steps):
        wanted = centre * np.exp(step) if by_factors else centre + step
        z = float(np.clip(wanted, problem.lower[j], problem.upper[j]))
        point, cost = _refit_at(problem, Point(path(point.z, z), point.states), j, z, thorough=number == 0)
        rise = float(np.sqrt(max(cost - solution.cost, 0.0) / threshold))
        if abs(rise - 1.0) < tolerance or (z != wanted and rise < 1.0):
            break
        step *= float(np.clip(1.0 / max(rise, 1e-3), 0.4, 2.5))
        # a refit beyond the crossing may have ended in a worse minimum
        point = solution.point if rise > 1.0 else point
    return z


def _refit_at(
    problem: Problem, point: Point, j: int, z: float, *, thorough: bool, trials: int = 6
) -> tuple[Point, float]:
    """Refit all other parameters and all states with parameter ``j`` held at ``z``; the cost comes second.

    ``thorough`` also searches each window's state from so many random ``trials``.
    """
    theta = problem.theta(point.z)
    theta[problem.free[j]] = z * problem.scale[j]
    held_problem = problem.pin(np.array([j]), theta)
    others, states = np.delete(point.z, j), point.states
    if thorough:
        states = search_states(held_problem, others, states, np.random.default_rng(0), trials=trials)
    begin = Point(others, states)
    refit = least_squares(held_problem, begin, iterations=40, tolerance=1e-5, settled=True, thorough=False)
    problem.evaluations += held_problem.evaluations
    return Point(np.insert(refit.point.z, j, z), refit.point.states), refit.cost


def cramer_rao_bounds(problem: Problem, point: Point) -> FloatArray:
    """Cramér-Rao bounds of the standard errors under white noise.

    Args:
        problem: What is estimated; its ``sigma`` is the standard deviation of the noise.
        point: The true parameters and initial states; free states are projected out.

    Returns:
        (P,) SI units.
    """
    jacobian = sensitivities(problem, point, problem.residuals(point), 1.0) / problem.scale
    unit = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    return np.asarray(np.sqrt(np.diag(inverse_information(jacobian / unit))) / unit)
