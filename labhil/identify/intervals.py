"""Intervals beyond Wald's: profiles of the likelihood, a block bootstrap, and all parameters at once.

Wald's interval, value ± q·standard error, is right where the cost is a parabola. A profile follows the
cost itself (every other parameter and all states refitted at each value), which is right at bounds and
where the model bends; the bootstrap draws blocks of residuals, which keeps their correlation.
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
from labhil.identify.statistics import ALPHA, bandwidth, inverse_information, runs
from labhil.identify.window_states import search_states
from labhil.signals import FloatArray

DRAWS = 2000
STEPS = 6
TRIALS = 6
CLOSE = 0.06

FARTHEST = 2.3
"""Logarithm of the largest factor by which a size is moved in one step."""


class Intervals(StrEnum):
    """How intervals are made."""

    AUTO = "auto"
    """Profiles where the cost is no parabola (terms with a shape, poorly known sizes), Wald for the rest."""
    WALD = "wald"
    PROFILE = "profile"
    BOOTSTRAP = "bootstrap"


def interval_method(name: str) -> Intervals:
    """The method of that name; UnknownNameError lists those that exist."""
    if name not in set(Intervals):
        raise UnknownNameError("interval method", name, [method.value for method in Intervals])
    return Intervals(name)


def quantile(level: float = 1.0 - ALPHA) -> float:
    """Two-sided normal quantile of a confidence level."""
    return float(stats.norm.ppf(0.5 + 0.5 * level))


def simultaneous_quantile(covariance: FloatArray, level: float = 1.0 - ALPHA, seed: int = 0) -> float:
    """By how many standard errors all intervals must reach out to hold together with this probability.

    The quantile of the largest of correlated normal deviates with the correlation of ``covariance``
    (P, P), from 100,000 draws; parameters with no finite error do not count.
    """
    known = np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0)
    if not np.any(known):
        return quantile(level)
    chosen = covariance[np.ix_(known, known)]
    error = np.sqrt(np.diag(chosen))
    values, vectors = np.linalg.eigh(chosen / np.outer(error, error))
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    draws = np.random.default_rng(seed).standard_normal((100_000, len(error))) @ root.T
    return float(np.quantile(np.abs(draws).max(axis=1), level))


def bootstrap_intervals(
    jacobian: FloatArray,
    residuals: FloatArray,
    values: FloatArray,
    dof: int,
    reach: float,
    seed: int = 0,
    begins: Sequence[int] = (0,),
) -> list[tuple[float, float]]:
    """Basic intervals from a moving-block bootstrap of the residuals, each refit by one Gauss-Newton step.

    ``jacobian`` (N, P) is the projected one in SI units and ``residuals`` (N,) in units of noise; ``reach``
    is the two-sided normal quantile whose probability the intervals get. Blocks are as long as the
    residuals' correlation asks for (Andrews' bandwidth), and at least 10 samples. None reaches from one
    recording into the next; these begin at the rows ``begins``.
    """
    n = len(residuals)
    unit = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    gain = (inverse_information(jacobian / unit) @ (jacobian / unit).T) / unit[:, None]
    spans = [(run.start, run.stop) for run in runs(begins, n)]
    shortest = min(last - first for first, last in spans)
    scores = jacobian * residuals[:, None]
    length = int(np.clip(4 * bandwidth(scores, begins), 10, max(min(n // 4, shortest), 1)))
    allowed = np.concatenate([np.arange(first, last - length + 1) for first, last in spans])
    centred = (residuals - residuals.mean()) * np.sqrt(n / dof)
    random = np.random.default_rng(seed)
    blocks = -(-n // length)
    within = np.arange(length)
    shifts = np.empty((DRAWS, len(values)))
    for k in range(DRAWS):
        rows = (allowed[random.integers(0, len(allowed), blocks)][:, None] + within).ravel()[:n]
        shifts[k] = gain @ centred[rows]
    tail = float(stats.norm.sf(reach))
    # the basic bootstrap turns the distribution of the errors around
    low, high = np.quantile(shifts, [1.0 - tail, tail], axis=0)
    return [(float(v - a), float(v - b)) for v, a, b in zip(values, low, high, strict=True)]


def profile_interval(
    problem: Problem, solution: Solution, j: int, covariance: FloatArray, inflation: float, reach: float
) -> tuple[float, float]:
    """Where the profile of parameter ``j`` (its place among the free ones) crosses ``reach``² (SI units).

    The classical ``covariance`` (P, P), in scaled units, gives the first step and how the others go
    along; ``inflation`` is the robust over the classical variance, by which the threshold grows where
    residuals are correlated.
    """
    dof = max(len(solution.residuals) - len(problem.free) - solution.point.states.size, 1)
    threshold = reach**2 * inflation * solution.cost / dof
    along = covariance[:, j] / covariance[j, j]
    error = float(np.sqrt(inflation * covariance[j, j]))
    if problem.model.parameters[problem.free[j]].in_steps:
        error = max(error, problem.step[j])  # the slope within a step is unrelated to its width
    path = _path_of(problem, j, along)
    ends = [
        _crossing(problem, solution, j, path, side * reach * error, threshold) * problem.scale[j]
        for side in (-1, 1)
    ]
    return min(ends), max(ends)


Path = Callable[[FloatArray, float], FloatArray]


def _path_of(problem: Problem, j: int, along: FloatArray) -> Path:
    """How all parameters (P,) go along when ``j`` is moved to a value, to first order, within bounds.

    A size that cannot be zero changes by factors, and so do the others with it: products of powers are what
    data know of sizes.
    """

    def straight(z: FloatArray, value: float) -> FloatArray:
        return np.clip(z + (value - z[j]) * along, problem.lower, problem.upper)

    def by_factors(z: FloatArray, value: float) -> FloatArray:
        powers = np.divide(along * z[j], z, out=np.zeros_like(z), where=z != 0.0)
        grown = z * np.exp(np.clip(powers * np.log(value / z[j]), -FARTHEST, FARTHEST))
        return np.clip(grown, problem.lower, problem.upper)

    return by_factors if problem.is_size(j) else straight


def _crossing(
    problem: Problem, solution: Solution, j: int, path: Path, step: float, threshold: float
) -> float:
    """Scaled value of parameter ``j`` at which its profile has risen by ``threshold``; a bound ends it."""
    centre, point = solution.point.z[j], solution.point
    sized = problem.is_size(j)
    if sized:
        step = float(np.clip(step / centre, -FARTHEST, FARTHEST))
    z = centre
    for number in range(STEPS):
        wanted = centre * np.exp(step) if sized else centre + step
        z = float(np.clip(wanted, problem.lower[j], problem.upper[j]))
        point, cost = _refit_at(problem, Point(path(point.z, z), point.states), j, z, thorough=number == 0)
        rise = float(np.sqrt(max(cost - solution.cost, 0.0) / threshold))
        if abs(rise - 1.0) < CLOSE or (z != wanted and rise < 1.0):
            break
        step *= float(np.clip(1.0 / max(rise, 1e-3), 0.4, 2.5))
        # a refit that went too far may have fallen into a worse minimum
        point = solution.point if rise > 1.0 else point
    return z


def _refit_at(problem: Problem, point: Point, j: int, z: float, *, thorough: bool) -> tuple[Point, float]:
    """All other parameters and all states refitted with parameter ``j`` held at ``z``, and the cost there."""
    theta = problem.theta(point.z)
    theta[problem.free[j]] = z * problem.scale[j]
    held_problem = problem.pin(np.array([j]), theta)
    others, states = np.delete(point.z, j), point.states
    if thorough:
        states = search_states(held_problem, others, states, np.random.default_rng(0), trials=TRIALS)
    begin = Point(others, states)
    refit = least_squares(held_problem, begin, iterations=40, tolerance=1e-5, settled=True, thorough=False)
    problem.evaluations += held_problem.evaluations
    return Point(np.insert(refit.point.z, j, z), refit.point.states), refit.cost


def cramer_rao(problem: Problem, point: Point) -> FloatArray:
    """Cramér-Rao bounds of the standard errors (P,), SI units, at ``point`` (the truth) under white noise.

    Residuals are in units of the noise of ``problem.sigma``; free initial states are projected out.
    """
    jacobian = sensitivities(problem, point, problem.residuals(point), 1.0) / problem.scale
    unit = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    return np.asarray(np.sqrt(np.diag(inverse_information(jacobian / unit))) / unit)
