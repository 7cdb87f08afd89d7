"""Intervals beyond Wald's: profiles of the likelihood, a block bootstrap, and all parameters at once.

Wald's interval, value ± q·standard error, is right where the cost is a parabola. A profile follows the
cost itself (every other parameter and all states refitted at each value), which is right at bounds and
where the model bends; the bootstrap draws blocks of residuals, which keeps their correlation.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from scipy import stats

from labhil.errors import UnknownNameError
from labhil.identify.least_squares import Solution, least_squares, search_states
from labhil.identify.problem import Point, Problem
from labhil.identify.statistics import ALPHA, bandwidth, inverse_information
from labhil.signals import FloatArray

DRAWS = 2000
STEPS = 6
TRIALS = 6
CLOSE = 0.06


class Intervals(StrEnum):
    """How intervals are made."""

    AUTO = "auto"
    """Profiles for terms with a shape (Stribeck friction), whose cost is no parabola; Wald for the rest."""
    WALD = "wald"
    PROFILE = "profile"
    BOOTSTRAP = "bootstrap"


def interval_method(name: str) -> Intervals:
    """The method of that name; UnknownNameError lists those that exist."""
    if name not in set(Intervals):
        raise UnknownNameError("interval method", name, list(Intervals))
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
    jacobian: FloatArray, residuals: FloatArray, values: FloatArray, dof: int, reach: float, seed: int = 0
) -> list[tuple[float, float]]:
    """Basic intervals from a moving-block bootstrap of the residuals, each refit by one Gauss-Newton step.

    ``jacobian`` (N, P) is the projected one in SI units and ``residuals`` (N,) in units of noise; ``reach``
    is the two-sided normal quantile whose probability the intervals get. Blocks are as long as the
    residuals' correlation asks for (Andrews' bandwidth), and at least 10 samples.
    """
    n = len(residuals)
    unit = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    gain = (inverse_information(jacobian / unit) @ (jacobian / unit).T) / unit[:, None]
    length = int(np.clip(4 * bandwidth(jacobian * residuals[:, None]), 10, max(n // 4, 1)))
    centred = (residuals - residuals.mean()) * np.sqrt(n / dof)
    random = np.random.default_rng(seed)
    blocks = -(-n // length)
    within = np.arange(length)
    shifts = np.empty((DRAWS, len(values)))
    for k in range(DRAWS):
        rows = (random.integers(0, n - length + 1, blocks)[:, None] + within).ravel()[:n]
        shifts[k] = gain @ centred[rows]
    tail = float(stats.norm.sf(reach))
    # the basic bootstrap turns the distribution of the errors around
    low, high = np.quantile(shifts, [1.0 - tail, tail], axis=0)
    return [(float(v - a), float(v - b)) for v, a, b in zip(values, low, high, strict=True)]


def profile_interval(
    problem: Problem, solution: Solution, j: int, covariance: FloatArray, inflation: float, reach: float
) -> tuple[float, float]:
    """Where the profile of parameter ``j`` (its place among the free ones) crosses ``reach``² (SI units).

    The classical ``covariance`` (P, P), in scaled units, tells how far to look and how the others go
    along; ``inflation`` is the robust over the classical variance, by which the threshold grows where
    residuals are correlated.
    """
    dof = max(len(solution.residuals) - len(problem.free) - solution.point.states.size, 1)
    threshold = reach**2 * inflation * solution.cost / dof
    scale = problem.scale[j]
    error = float(np.sqrt(covariance[j, j]))
    along = covariance[:, j] / covariance[j, j]
    steps = [side * reach * np.sqrt(inflation) * error for side in (-1, 1)]
    ends = [_crossing(problem, solution, j, along, step, threshold) * scale for step in steps]
    return min(ends), max(ends)


def _crossing(
    problem: Problem, solution: Solution, j: int, along: FloatArray, step: float, threshold: float
) -> float:
    """Scaled value of parameter ``j`` at which its profile has risen by ``threshold``; a bound ends it."""
    centre = solution.point.z[j]
    for _ in range(STEPS):
        z = float(np.clip(centre + step, problem.lower[j], problem.upper[j]))
        moved = np.clip(solution.point.z + (z - centre) * along, problem.lower, problem.upper)
        pinned = _refit_at(problem, Point(moved, solution.point.states), j, z)
        rise = float(np.sqrt(max(pinned.cost - solution.cost, 0.0) / threshold))
        if abs(rise - 1.0) < CLOSE or (z != centre + step and rise < 1.0):
            return z
        step *= float(np.clip(1.0 / max(rise, 1e-3), 0.4, 2.5))
    return float(np.clip(centre + step, problem.lower[j], problem.upper[j]))


def _refit_at(problem: Problem, near: Point, j: int, z: float) -> Solution:
    """All other parameters and all states refitted with parameter ``j`` held at ``z``."""
    theta = problem.theta(near.z)
    theta[problem.free[j]] = z * problem.scale[j]
    pinned = Problem(
        problem.model, problem.record, problem.windows, np.delete(problem.free, j), theta, problem.sigma
    )
    others = np.delete(near.z, j)
    states = search_states(pinned, others, near.states, np.random.default_rng(0), trials=TRIALS)
    begin = Point(others, states)
    return least_squares(pinned, begin, iterations=12, settled=True, thorough=False)


def cramer_rao(problem: Problem, point: Point) -> FloatArray:
    """Cramér-Rao bounds of the standard errors (P,), SI units, at ``point`` (the truth) under white noise.

    Residuals are in units of the noise of ``problem.sigma``; free initial states are projected out.
    """
    residuals = problem.residuals(point)
    lin = problem.linearise(point, residuals, central=True)
    jacobian = problem.project(lin, lin.by_parameters) / problem.scale
    unit = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    return np.asarray(np.sqrt(np.diag(inverse_information(jacobian / unit))) / unit)
