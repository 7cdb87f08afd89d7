"""Least squares with a quadratic penalty: smooth curves estimated together with a model's parameters.

Minimises |r(z)|² + zᵀΠz, r in units of noise. The estimate's covariance

    C = H⁻¹ · (S + σ̂²·Π) · H⁻¹,   H = JᵀJ + Π,

has in S the long-run variance of the scores (``identify.statistics``: residuals may be correlated in time)
and in σ̂²Π what smoothing may have taken away. With white residuals it is Wahba's (1983) σ̂²·H⁻¹, whose
pointwise bands cover on the average over the curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.identify.least_squares import RESCUED, Solution
from labhil.identify.problem import Linearised, Point, Problem
from labhil.identify.statistics import long_run_variance, modelled_variance
from labhil.identify.window_states import States, evaluate, reestimate, refine
from labhil.signals import FloatArray, IntArray

DAMPED, LEAST_DAMPED, MOST_DAMPED = 1e-3, 1e-8, 1e4
"""Damping of the first step, the least and the most, over the curvature."""

TOLERANCE = 3e-4
"""Share of the cost that a step has to gain."""

FOLDS = 10
"""In which windows are left out in turn."""


@dataclass(frozen=True, slots=True)
class Projected:
    """Residuals (N,) and slopes (N, P) at a point ``z`` (P,), without what the windows' states explain.

    ``owner`` (N,) is the window of each row; recordings begin at the samples ``begins``.
    """

    z: FloatArray
    residuals: FloatArray
    slopes: FloatArray
    owner: IntArray
    begins: tuple[int, ...] = (0,)

    @classmethod
    def at(cls, problem: Problem, point: Point, residuals: FloatArray) -> tuple[Projected, Linearised]:
        """Linearise a problem."""
        lin = problem.linearise(point, residuals)
        both = problem.project(lin, np.column_stack([lin.by_parameters, residuals]))
        return cls(point.z, both[:, -1], both[:, :-1], problem.owner, problem.begins), lin

    def solve(self, penalty: FloatArray, damping: float = 0.0) -> FloatArray:
        """The ``z`` (P,) at which the linearised, penalised cost is least, or ``damping`` short of it."""
        normal = self.slopes.T @ self.slopes
        gradient = self.slopes.T @ self.residuals + penalty @ self.z
        curvature = normal + penalty + _regularisation(normal)
        curvature = curvature + damping * np.diag(np.diag(curvature))
        return np.asarray(self.z - np.linalg.solve(curvature, gradient))

    def residuals_at(self, z: FloatArray) -> FloatArray:
        """Residuals (N,) that the linearised model has at ``z``."""
        return np.asarray(self.residuals + self.slopes @ (z - self.z))

    def degrees(self, penalty: FloatArray) -> float:
        """Effective degrees of freedom, the trace of (JᵀJ + Π)⁻¹·JᵀJ (Hastie and Tibshirani 1990)."""
        normal = self.slopes.T @ self.slopes
        return float(np.trace(np.linalg.solve(normal + penalty + _regularisation(normal), normal)))

    def cross_validate(self, penalties: Sequence[FloatArray]) -> FloatArray:
        """Squared residuals of windows that had no part in the estimate, in turn for a tenth of them.

        One sum for each of the ``penalties``.
        """
        folds = min(FOLDS, int(self.owner.max()) + 1)
        both = np.column_stack([self.slopes, self.residuals - self.slopes @ self.z])
        parts = [rows.T @ rows for rows in (both[self.owner % folds == fold] for fold in range(folds))]
        total = np.sum(parts, axis=0)
        totals = np.zeros(len(penalties))
        for i, penalty in enumerate(penalties):
            for part in parts:
                training = total - part
                normal = training[:-1, :-1]
                z = np.linalg.solve(normal + penalty + _regularisation(normal), -training[:-1, -1])
                moved = np.r_[z, 1.0]
                totals[i] += float(moved @ part @ moved)
        return totals

    def covariance(self, penalty: FloatArray, dof: float, channels: int) -> FloatArray:
        """Covariance (P, P) of the estimate, in units of the parameters' scales."""
        n = len(self.residuals)
        normal = self.slopes.T @ self.slopes
        inverse = np.linalg.inv(normal + penalty + _regularisation(normal))
        power = float(self.residuals @ self.residuals) / dof
        scores = (self.slopes * self.residuals[:, None]).reshape(n // channels, channels, -1).sum(axis=1)
        classical = power * inverse
        variances = [
            long_run_variance(scores, self.begins),
            modelled_variance(self.slopes, self.residuals, channels, self.begins),
        ]
        spreads = [inverse @ (s * (n / dof) + power * penalty) @ inverse for s in variances] + [classical]
        widest = np.max([np.diag(spread) for spread in spreads], axis=0)
        robust = spreads[0]
        raised = np.sqrt(widest / np.maximum(np.diag(robust), 1e-300))
        return np.asarray(robust * np.outer(raised, raised))


def _regularisation(normal: FloatArray) -> FloatArray:
    """Enough on the diagonal that directions of which the data know nothing do no harm."""
    return np.diag(1e-9 * np.diag(normal) + 1e-12 * max(float(np.diag(normal).max()), 1e-300))


def minimise(problem: Problem, start: Point, penalty: FloatArray, iterations: int) -> Solution:
    """Levenberg and Marquardt's method on the penalised cost; ``penalty`` is (P, P)."""
    point, residuals, damping = start, problem.residuals(start), DAMPED
    for iteration in range(iterations):
        cost = _cost(point.z, residuals, penalty)
        lower = _lower(problem, point, residuals, penalty, damping)
        if lower is not None:
            point, residuals, damping = lower
        if cost - _cost(point.z, residuals, penalty) < TOLERANCE * cost:
            better = reestimate(problem, point.z, States(point.states, residuals))
            if better.cost > (1.0 - RESCUED) * float(residuals @ residuals):
                return Solution(point, residuals, iteration + 1, True)
            point, residuals, damping = Point(point.z, better.states), better.residuals, DAMPED
    return Solution(point, residuals, iterations, False)


def _lower(
    problem: Problem, point: Point, residuals: FloatArray, penalty: FloatArray, damping: float
) -> tuple[Point, FloatArray, float] | None:
    """A point of lower cost, its residuals and the next damping; None when no damping finds one."""
    projected, lin = Projected.at(problem, point, residuals)
    cost = _cost(point.z, residuals, penalty)
    while damping < MOST_DAMPED:
        z = np.clip(projected.solve(penalty, damping), problem.lower, problem.upper)
        followed = evaluate(problem, z, _follow_states(problem, lin, point, residuals, z))
        trial = refine(problem, z, evaluate(problem, z, point.states), followed)
        if _cost(z, trial.residuals, penalty) < cost:
            return Point(z, trial.states), trial.residuals, max(0.1 * damping, LEAST_DAMPED)
        damping *= 10.0
    return None


def _cost(z: FloatArray, residuals: FloatArray, penalty: FloatArray) -> float:
    return float(residuals @ residuals + z @ penalty @ z)


def _follow_states(
    problem: Problem, lin: Linearised, point: Point, residuals: FloatArray, z: FloatArray
) -> FloatArray:
    """The windows' states (W, S) that the linearised model has best at ``z``."""
    if not point.states.shape[1]:
        return point.states
    linearised = residuals + lin.by_parameters @ (z - point.z)
    pull = problem.products(lin.by_states, linearised[:, None])
    step = np.linalg.solve(problem.state_gram(lin.by_states), pull)[:, :, 0]
    return np.asarray(point.states - step * problem.model.state_scale)
