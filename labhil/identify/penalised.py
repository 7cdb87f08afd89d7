"""Penalised least squares: smooth curves (P-splines) estimated together with a model's parameters.

Minimises |r(z)|² + zᵀΠz, r in units of noise. The estimate's covariance

    C = H⁻¹ · (S + σ̂²·Π) · H⁻¹,   H = JᵀJ + Π,

has in S the long-run variance of the scores (``identify.statistics``: residuals may be correlated in time)
and in σ̂²Π the bias that smoothing may cause. With white residuals it is Wahba's (1983) σ̂²·H⁻¹, whose
pointwise bands cover on the average over the curve. ``diagnose.curve`` uses it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.identify.least_squares import DEFAULT_STEPS, Solution, StepOptions
from labhil.identify.problem import Linearised, Point, Problem
from labhil.identify.statistics import autoregressive_variance, long_run_variance
from labhil.identify.window_states import States, evaluate, reestimate, refine
from labhil.signals import FloatArray, IntArray

MIN_DAMPING = 1e-8
"""Smallest damping of a step, relative to the curvature."""


@dataclass(frozen=True, slots=True)
class Projected:
    """A linearised problem with the windows' initial states projected out.

    Attributes:
        z: (P,) scaled parameters at which it is linearised.
        residuals: (N,) in units of noise.
        slopes: (N, P) of the residuals by the scaled parameters.
        owner: (N,) index of the window that a residual belongs to.
        begins: Samples at which recordings begin.
    """

    z: FloatArray
    residuals: FloatArray
    slopes: FloatArray
    owner: IntArray
    begins: tuple[int, ...] = (0,)

    @classmethod
    def at(cls, problem: Problem, point: Point, residuals: FloatArray) -> tuple[Projected, Linearised]:
        """Linearise a problem at ``point``, where its residuals are ``residuals`` (N,).

        Returns:
            The projected problem, and the same before projection.
        """
        lin = problem.linearise(point, residuals)
        columns = problem.project(lin, np.column_stack([lin.by_parameters, residuals]))
        return cls(point.z, columns[:, -1], columns[:, :-1], problem.owner, problem.begins), lin

    def solve(self, penalty: FloatArray, damping: float = 0.0) -> FloatArray:
        """Minimise the linearised, penalised cost.

        Args:
            penalty: (P, P) matrix Π of the penalty.
            damping: By which the curvature is damped, relative to its diagonal.

        Returns:
            The scaled parameters, (P,).
        """
        normal = self.slopes.T @ self.slopes
        gradient = self.slopes.T @ self.residuals + penalty @ self.z
        curvature = normal + penalty + _regularisation(normal)
        curvature = curvature + damping * np.diag(np.diag(curvature))
        return np.asarray(self.z - np.linalg.solve(curvature, gradient))

    def residuals_at(self, z: FloatArray) -> FloatArray:
        """Residuals (N,) of the linearised model at ``z`` (P,)."""
        return np.asarray(self.residuals + self.slopes @ (z - self.z))

    def effective_dof(self, penalty: FloatArray) -> float:
        """Effective degrees of freedom, the trace of (JᵀJ + Π)⁻¹·JᵀJ (Hastie and Tibshirani 1990)."""
        normal = self.slopes.T @ self.slopes
        return float(np.trace(np.linalg.solve(normal + penalty + _regularisation(normal), normal)))

    def cross_validate(self, penalties: Sequence[FloatArray], *, max_folds: int = 10) -> FloatArray:
        """Cross-validate the linearised problem over its windows.

        Args:
            penalties: Candidate penalty matrices (P, P).
            max_folds: Number of folds, where there are as many windows.

        Returns:
            For each candidate the sum of squared residuals of the windows that were left out.
        """
        folds = min(max_folds, int(self.owner.max()) + 1)
        columns = np.column_stack([self.slopes, self.residuals - self.slopes @ self.z])
        grams = [rows.T @ rows for rows in (columns[self.owner % folds == fold] for fold in range(folds))]
        total = np.sum(grams, axis=0)
        costs = np.zeros(len(penalties))
        for i, penalty in enumerate(penalties):
            for test in grams:
                training = total - test
                normal = training[:-1, :-1]
                z = np.linalg.solve(normal + penalty + _regularisation(normal), -training[:-1, -1])
                extended = np.r_[z, 1.0]
                costs[i] += float(extended @ test @ extended)
        return costs

    def covariance(self, penalty: FloatArray, dof: float, channels: int) -> FloatArray:
        """Covariance of the penalised estimate; residuals may be correlated in time.

        Args:
            penalty: (P, P) matrix Π of the penalty.
            dof: Degrees of freedom of the residuals.
            channels: Number of output channels, which follow each other in each sample.

        Returns:
            (P, P) in units of the parameters' scales.
        """
        n = len(self.residuals)
        normal = self.slopes.T @ self.slopes
        inverse = np.linalg.inv(normal + penalty + _regularisation(normal))
        power = float(self.residuals @ self.residuals) / dof
        scores = (self.slopes * self.residuals[:, None]).reshape(n // channels, channels, -1).sum(axis=1)
        classical = power * inverse
        variances = [
            long_run_variance(scores, self.begins),
            autoregressive_variance(self.slopes, self.residuals, channels, self.begins),
        ]
        spreads = [inverse @ (s * (n / dof) + power * penalty) @ inverse for s in variances] + [classical]
        widest = np.max([np.diag(spread) for spread in spreads], axis=0)
        robust = spreads[0]
        factors = np.sqrt(widest / np.maximum(np.diag(robust), 1e-300))
        return np.asarray(robust * np.outer(factors, factors))


def _regularisation(normal: FloatArray) -> FloatArray:
    """A small diagonal matrix that makes the normal equations solvable along undetermined directions."""
    return np.diag(1e-9 * np.diag(normal) + 1e-12 * max(float(np.diag(normal).max()), 1e-300))


def minimise(
    problem: Problem,
    start: Point,
    penalty: FloatArray,
    iterations: int,
    *,
    tolerance: float = 3e-4,
    options: StepOptions = DEFAULT_STEPS,
) -> Solution:
    """Minimise the penalised cost |r(z)|² + zᵀΠz by Levenberg and Marquardt's method.

    Args:
        problem: What is estimated.
        start: Where to begin.
        penalty: (P, P) matrix Π of the penalty, for scaled parameters.
        iterations: Largest number of steps.
        tolerance: Relative decrease of the cost by a step below which the fit has converged.
        options: How steps are chosen; the gain ratio is not used.
    """
    point, residuals, damping = start, problem.residuals(start), options.initial_damping
    for iteration in range(iterations):
        cost = _cost(point.z, residuals, penalty)
        lower = _lower_cost(problem, point, residuals, penalty, damping, options.max_damping)
        if lower is not None:
            point, residuals, damping = lower
        if cost - _cost(point.z, residuals, penalty) < tolerance * cost:
            better = reestimate(problem, point.z, States(point.states, residuals))
            if better.cost > (1.0 - options.min_decrease_by_states) * float(residuals @ residuals):
                return Solution(point, residuals, iteration + 1, True)
            point, residuals = Point(point.z, better.states), better.residuals
            damping = options.initial_damping
    return Solution(point, residuals, iterations, False)


def _lower_cost(
    problem: Problem,
    point: Point,
    residuals: FloatArray,
    penalty: FloatArray,
    damping: float,
    max_damping: float,
) -> tuple[Point, FloatArray, float] | None:
    """A point of lower cost, its residuals and the next damping; None where no damping finds one."""
    projected, lin = Projected.at(problem, point, residuals)
    cost = _cost(point.z, residuals, penalty)
    while damping < max_damping:
        z = np.clip(projected.solve(penalty, damping), problem.lower, problem.upper)
        followed = evaluate(problem, z, _follow_states(problem, lin, point, residuals, z))
        trial = refine(problem, z, evaluate(problem, z, point.states), followed)
        if _cost(z, trial.residuals, penalty) < cost:
            return Point(z, trial.states), trial.residuals, max(0.1 * damping, MIN_DAMPING)
        damping *= 10.0
    return None


def _cost(z: FloatArray, residuals: FloatArray, penalty: FloatArray) -> float:
    """The penalised cost |r|² + zᵀΠz."""
    return float(residuals @ residuals + z @ penalty @ z)


def _follow_states(
    problem: Problem, lin: Linearised, point: Point, residuals: FloatArray, z: FloatArray
) -> FloatArray:
    """The windows' states (W, S) that are best for the linearised model at ``z``."""
    if not point.states.shape[1]:
        return point.states
    linearised = residuals + lin.by_parameters @ (z - point.z)
    gradient = problem.products(lin.by_states, linearised[:, None])
    step = np.linalg.solve(problem.state_gram(lin.by_states), gradient)[:, :, 0]
    return np.asarray(point.states - step * problem.model.state_scale)
