"""The tests by which a recording contradicts a model, each with a p value."""

from __future__ import annotations

import numpy as np
from scipy import stats

from labhil.identify.problem import Point, Problem
from labhil.identify.score import Score
from labhil.identify.window_products import without_states
from labhil.physics.model import Metric, Record
from labhil.signals import FloatArray

LAGS = 20
MOST_ORDER = 10
"""Of the autoregression that whitens residuals."""

ROUNDING = 1e-10
"""Eigenvalues of a correlation matrix below this share of the largest are rounding."""


def excess_p_value(
    score: Score, j: int, slopes: FloatArray, covariance: FloatArray, allowed: float, known_twice: bool
) -> tuple[float, float]:
    """p value that output ``j`` is simulated worse than noise and parameter errors explain, and the limit.

    ``slopes`` (n, P) are those of its scored errors by the parameters, ``covariance`` (P, P) that of
    their values; ``allowed`` is the ratio of RMSE to floor that counts as noise. The mean square of
    correlated errors is taken as a scaled χ² of its first two moments (Satterthwaite). With
    ``known_twice`` the allowance itself was measured on as many data. The limit is the ratio of RMSE to
    floor that noise exceeds once in a thousand times.
    """
    channel = score.channels[j]
    level = (channel.noise_floor * allowed) ** 2
    spread = slopes.T @ slopes @ covariance / (len(slopes) * level) if len(covariance) else np.zeros((0, 0))
    mean = 1.0 + float(np.trace(spread))
    noise = 2.0 / _effective(score.errors[:, j], score.window) * (2.0 if known_twice else 1.0)
    variance = noise + 2.0 * float(np.trace(spread @ spread))
    shape, scale = mean**2 / variance, variance / mean
    limit = float(np.sqrt(stats.gamma.isf(1e-3, shape, scale=scale))) * allowed
    if not np.isfinite(channel.mse):
        return 0.0, limit
    return float(stats.gamma.sf(channel.mse / level, shape, scale=scale)), limit


def _effective(errors: FloatArray, window: np.ndarray) -> float:
    """How many independent squares correlated errors (n,) are worth: n / (1 + 2·Σρ²)."""
    n, total = len(errors), 1.0
    power = float(errors @ errors)
    longest = int(np.bincount(window).max(initial=1))
    for lag in range(1, min(longest, n // 2)):
        rho = float(errors[lag:] @ errors[:-lag]) / max(power, 1e-300)
        total += 2.0 * max(rho * rho - 1.0 / n, 0.0)
    return n / total


def scored_slopes(problem: Problem, score: Score) -> FloatArray:
    """Slopes (n·c, P) of the scored errors by the scaled free parameters, each window's state refitted.

    ``problem`` covers lead-ins and scored parts; errors are in units of noise.
    """
    point = Point(problem.start().z, score.states)
    lin = problem.linearise(point, problem.residuals(point))
    scored = np.repeat(score.windows.scored, len(problem.sigma))
    slopes = lin.by_parameters
    if lin.by_states.shape[1]:
        lead = lin.by_states * ~scored[:, None]
        share = np.linalg.solve(problem.state_gram(lead), problem.products(lead, slopes))
        slopes = without_states(slopes, lin.by_states, np.asarray(share), problem.edges)
    return np.asarray(slopes[scored])


def difference_p_value(difference: FloatArray, covariance: FloatArray, effective: float) -> float:
    """p value of Wald's test that a ``difference`` (k,) of values is zero, given its ``covariance`` (k, k).

    Covariances are themselves estimated from ``effective`` samples, so the statistic is Hotelling's.
    Directions of which nothing is known (infinite or huge variances) take no part.
    """
    errors = np.sqrt(np.diag(covariance))
    known = np.isfinite(errors) & (errors > 0.0)
    if not known.any():
        return 1.0
    scaled = difference[known] / errors[known]
    correlation = covariance[np.ix_(known, known)] / np.outer(errors[known], errors[known])
    eigenvalues, directions = np.linalg.eigh(0.5 * (correlation + correlation.T))
    sound = eigenvalues > ROUNDING * eigenvalues[-1]
    statistic = float(np.sum((directions[:, sound].T @ scaled) ** 2 / eigenvalues[sound]))
    k = int(sound.sum())
    freedom = max(effective - k, 2.0)
    return float(stats.f.sf(statistic * freedom / (k * (freedom + k - 1.0)), k, freedom))


def structure_p_value(
    problem: Problem, point: Point, residuals: FloatArray, jacobian: FloatArray
) -> tuple[float, ...]:
    """Per output, the p value that residuals are uncorrelated with the input's recent past.

    ``residuals`` (N·c,) are those of a refit, ``jacobian`` (N·c, P) its projected slopes: what other values
    of the model's own parameters, or other initial states, would explain is taken out of the inputs, and
    both are whitened by the residuals' own autoregression before n·R² is held against F.
    """
    record, c = problem.record, len(problem.sigma)
    slopes = problem.state_slopes(point, residuals)
    # without states of their own windows are no breaks, only recordings are
    rows = np.arange(len(problem.windows.rows))
    owner = problem.windows.owner if slopes.shape[1] else np.searchsorted(problem.begins, rows, side="right")
    p_values = []
    for j in range(c):
        columns = [_past(record.inputs[:, k], problem) for k in _drivers(record, problem, j)]
        past = np.hstack(columns)
        lagged = np.zeros((len(residuals), past.shape[1]))
        lagged[j::c] = past - past.mean(axis=0)
        lagged = _orthogonal(problem, slopes, jacobian, lagged)
        p_values.append(_regression_p_value(residuals[j::c], lagged[j::c], owner))
    return tuple(p_values)


def _drivers(record: Record, problem: Problem, j: int) -> list[int]:
    """Inputs whose past may show in output ``j``: the first, or those of its own joint."""
    joint = record.output_joints[j] if record.output_joints else None
    if joint is None or problem.model.metric is not Metric.INVERSE_DYNAMICS:
        return [0]
    return [k for k, name in enumerate(record.input_names) if name.endswith(f"_{joint}")]


def _past(u: FloatArray, problem: Problem) -> FloatArray:
    """An input (n,) at all rows of the windows and up to ``LAGS`` samples before, (N, lags).

    Before a recording its input is taken for what it began with.
    """
    rows = problem.windows.rows
    begins = np.array([begin.row for begin in problem.record.begins])
    first = begins[np.searchsorted(begins, rows, side="right") - 1]
    return np.column_stack([u[np.maximum(rows - k, first)] for k in range(LAGS)])


def _orthogonal(
    problem: Problem, slopes: FloatArray, jacobian: FloatArray, columns: FloatArray
) -> FloatArray:
    """What of ``columns`` (N·c, k) neither windows' states nor parameters could explain."""
    columns = problem.project_out_states(slopes, columns)
    length = np.linalg.norm(jacobian, axis=0)
    vectors, singular, _ = np.linalg.svd(
        jacobian[:, length > 0.0] / length[length > 0.0], full_matrices=False
    )
    basis = vectors[:, singular > 1e-8]
    return np.asarray(columns - basis @ (basis.T @ columns))


def _regression_p_value(residuals: FloatArray, columns: FloatArray, owner: np.ndarray) -> float:
    """p value of a regression of ``residuals`` (n,) on ``columns`` (n, k), both whitened."""
    order = int(min(MOST_ORDER, len(residuals) // 50))
    both = np.column_stack([residuals, columns])
    weights = _autoregression(residuals, owner, order)
    inside = np.r_[np.zeros(order, dtype=bool), owner[order:] == owner[: len(owner) - order]]
    white = both.copy()
    for lag, weight in enumerate(weights, 1):
        white[lag:] -= weight * both[:-lag]
    white = white[inside]
    target, regressors = white[:, 0] - white[:, 0].mean(), white[:, 1:] - white[:, 1:].mean(axis=0)
    length = np.linalg.norm(regressors, axis=0)
    if not np.any(length > 0.0) or not np.any(target):
        return 1.0
    vectors, singular, _ = np.linalg.svd(regressors / np.maximum(length, 1e-300), full_matrices=False)
    strong = singular > 1e-6 * singular[0]
    k, explained = int(strong.sum()), float(np.sum((vectors[:, strong].T @ target) ** 2))
    freedom = len(target) - k - order - 1
    if freedom < k:
        return 1.0
    return float(stats.f.sf(explained / k / max((target @ target - explained) / freedom, 1e-300), k, freedom))


def _autoregression(residuals: FloatArray, owner: np.ndarray, order: int) -> FloatArray:
    """Weights (order,) that predict residuals from those before them in the same window."""
    if not order:
        return np.empty(0)
    past = np.column_stack([residuals[order - k : len(residuals) - k] for k in range(1, order + 1)])
    same = owner[order:] == owner[: len(owner) - order]
    weights, *_ = np.linalg.lstsq(past[same], residuals[order:][same], rcond=None)
    return np.asarray(weights)
