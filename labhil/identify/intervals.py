"""Confidence intervals beyond Wald's: profile likelihood, block bootstrap, simultaneous intervals.

Wald's interval, value ± q·standard error, is right where the cost is a parabola. A profile follows the cost
itself, with every other parameter and all states refitted at each value (Venzon and Moolgavkar 1988), which
is right at bounds and for nonlinear models. The bootstrap draws blocks of residuals (Künsch 1989), which
keeps their correlation. ``table`` chooses among them for each parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy import stats

from labhil.errors import UnknownNameError
from labhil.identify.least_squares import Solution, least_squares
from labhil.identify.problem import Linearised, Point, Problem
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


@dataclass(frozen=True, slots=True)
class Profile:
    """Likelihood profile of one parameter.

    Attributes:
        low: Where it crosses its threshold below the estimate, SI units; a bound where it does not.
        high: The same above the estimate.
        lower: A minimum clearly below the fit's that was found on the way; the ends then mean nothing.
    """

    low: float
    high: float
    lower: Solution | None = None


@dataclass(frozen=True, slots=True)
class CrossingOptions:
    """How the crossing of a profile with its threshold is found.

    Attributes:
        max_steps: Largest number of refits to each side.
        tolerance: Of the square root of the profile's rise, relative to the threshold's.
        refit_tolerance: Decrease of the cost, over the threshold, below which a refit has converged.
        max_rise_to_search: Rise over the threshold up to which the windows' states are searched, in case that
            windows were left in worse minima.
        iterations: Largest number of steps of a refit.
        min_decrease: Decrease of the cost that makes a minimum a lower one, in squares of the noise.
    """

    max_steps: int = 8
    tolerance: float = 0.06
    refit_tolerance: float = 0.03
    max_rise_to_search: float = 9.0
    iterations: int = 40
    min_decrease: float = 0.3


def profile_of(
    problem: Problem,
    solution: Solution,
    slopes: Linearised,
    j: int,
    covariance: FloatArray,
    inflation: float,
    reach: float,
    options: CrossingOptions | None = None,
) -> Profile:
    """Find where the likelihood profile of a parameter crosses its threshold.

    Args:
        problem: What was estimated.
        solution: The best fit.
        slopes: Those of the problem at the best fit.
        j: Index of the parameter among the free ones.
        covariance: (P, P) classical covariance of the scaled parameters, for the first step and for the
            direction in which the other parameters follow.
        inflation: Robust over classical variance, by which the threshold grows where residuals are
            correlated.
        reach: Two-sided normal quantile of the level; the threshold is its square.
        options: How the crossing is found; None for the defaults.
    """
    dof = max(len(solution.residuals) - len(problem.free) - solution.point.states.size, 1)
    threshold = reach**2 * inflation * solution.cost / dof
    along = covariance[:, j] / covariance[j, j]
    error = float(np.sqrt(inflation * covariance[j, j]))
    if problem.model.parameters[problem.free[j]].in_steps:
        error = max(error, problem.step[j])  # the slope within a step is unrelated to its width
    walk = _ProfileWalk(
        problem,
        solution,
        slopes.without(np.array([j])),
        j,
        path_of(problem, j, along),
        threshold,
        options or CrossingOptions(),
    )
    ends = [walk.crossing(side * reach * error) * problem.scale[j] for side in (-1, 1)]
    is_lower = walk.lowest.cost < solution.cost - walk.options.min_decrease * solution.cost / dof
    return Profile(min(ends), max(ends), walk.lowest if is_lower else None)


Path = Callable[[FloatArray, float], FloatArray]


def path_of(problem: Problem, j: int, along: FloatArray) -> Path:
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


class _ProfileWalk:
    """Walks along the profile of free parameter ``j``, every other parameter and all states refitted.

    Args:
        problem: What was estimated.
        solution: The best fit.
        slopes: Those by the other parameters at the best fit.
        j: Index of the parameter.
        path: How the others follow it.
        threshold: Rise of the cost at which the profile is crossed.
        options: How the crossing is found.
    """

    def __init__(
        self,
        problem: Problem,
        solution: Solution,
        slopes: Linearised,
        j: int,
        path: Path,
        threshold: float,
        options: CrossingOptions,
    ) -> None:
        self.problem = problem
        self.solution = solution
        self.slopes = slopes
        self.j = j
        self.path = path
        self.threshold = threshold
        self.options = options
        self.lowest = solution

    def crossing(self, step: float) -> float:
        """Scaled value at which the profile has risen by the threshold, or the bound; ``step`` comes first.

        The square root of the rise is about proportional to the distance. A positive constant is moved by
        factors.
        """
        problem, options = self.problem, self.options
        centre, point = self.solution.point.z[self.j], self.solution.point
        by_factors = problem.is_positive_constant(self.j)
        if by_factors:
            step = float(np.clip(step / centre, -MAX_LOG_STEP, MAX_LOG_STEP))
        z, below, beyond = centre, (0.0, 0.0), None
        for _ in range(options.max_steps):
            wanted = centre * np.exp(step) if by_factors else centre + step
            z = float(np.clip(wanted, problem.lower[self.j], problem.upper[self.j]))
            refit = self._refit(Point(self.path(point.z, z), point.states), z)
            rise = float(np.sqrt(max(refit.cost - self.solution.cost, 0.0) / self.threshold))
            if abs(rise - 1.0) < options.tolerance or (z != wanted and rise < 1.0):
                break
            if rise < 1.0:
                below, point = (step, rise), refit.point
            else:  # this refit may have ended in a worse minimum: the next one does not start there
                beyond = (step, rise)
            if beyond is None:
                longer = step * float(np.clip(1.0 / max(rise, 1e-3), 1.0, 2.5))
                # other parameters follow by a factor of ten at most
                step = (
                    float(np.clip(longer, step - MAX_LOG_STEP, step + MAX_LOG_STEP)) if by_factors else longer
                )
            else:
                share = (1.0 - below[1]) / max(beyond[1] - below[1], 1e-9)
                step = below[0] + float(np.clip(share, 0.1, 0.9)) * (beyond[0] - below[0])
        return z

    def _refit(self, begin: Point, z: float) -> Solution:
        """Refit everything else at the value ``z``, again from other states where the cost rose far."""
        refit = self._refit_from(begin, z, trials=0)
        rise = (refit.cost - self.solution.cost) / self.threshold
        if (1.0 + self.options.tolerance) ** 2 < rise < self.options.max_rise_to_search:
            searched = self._refit_from(begin, z, trials=6)
            refit = min(refit, searched, key=lambda either: either.cost)
        self.lowest = min(self.lowest, refit, key=lambda either: either.cost)
        return refit

    def _refit_from(self, begin: Point, z: float, trials: int) -> Solution:
        """Refit from a point; each window's state is first searched from so many random ``trials``."""
        problem, j = self.problem, self.j
        theta = problem.theta(begin.z)
        theta[problem.free[j]] = z * problem.scale[j]
        held_problem = problem.pin(np.array([j]), theta)
        others, states = np.delete(begin.z, j), begin.states
        if trials:
            states = search_states(held_problem, others, states, np.random.default_rng(0), trials=trials)
        refit = least_squares(
            held_problem,
            Point(others, states),
            iterations=self.options.iterations,
            tolerance=self.options.refit_tolerance * self.threshold / max(self.solution.cost, 1e-300),
            settled=True,
            thorough=False,
            slopes=self.slopes,
        )
        problem.evaluations += held_problem.evaluations
        return replace(refit, point=Point(np.insert(refit.point.z, j, z), refit.point.states))


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
