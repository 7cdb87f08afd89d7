"""Hypothesis tests of a model against a recording, each with a p value.

They test the error of a simulation, a difference of parameters (Wald, Hotelling), and the correlation of
residuals with past inputs. :mod:`labhil.diagnose.verify` puts them together.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from labhil.identify.problem import Point, Problem
from labhil.identify.score import Score
from labhil.identify.window_products import without_states
from labhil.physics.model import Metric
from labhil.physics.record import Record
from labhil.signals import FloatArray


def excess_p_value(
    score: Score,
    j: int,
    slopes: FloatArray,
    covariance: FloatArray,
    allowed: float,
    allowed_is_measured: bool,
    *,
    alpha_of_limit: float = 1e-3,
) -> tuple[float, float]:
    """Test whether an output is simulated worse than noise and parameter errors explain.

    The mean square of correlated errors is taken as a scaled χ² with its first two moments (Satterthwaite,
    Biometrics Bulletin 2, 1946).

    Args:
        score: errors of the windowed simulation.
        j: column of the output.
        slopes: derivatives (n, P) of its scored errors by the parameters.
        covariance: covariance (P, P) of the parameters.
        allowed: ratio of RMSE to noise floor that counts as noise.
        allowed_is_measured: whether ``allowed`` was itself measured on as many data, and so has an error.
        alpha_of_limit: probability with which noise exceeds the returned limit.

    Returns:
        The p value, and the ratio of RMSE to noise floor that noise exceeds with ``alpha_of_limit``.
    """
    channel = score.channels[j]
    level = (channel.noise_floor * allowed) ** 2
    spread = slopes.T @ slopes @ covariance / (len(slopes) * level) if len(covariance) else np.zeros((0, 0))
    mean = 1.0 + float(np.trace(spread))
    n_effective = _effective_squares(score.errors[:, j], score.window)
    noise_variance = 2.0 / n_effective * (2.0 if allowed_is_measured else 1.0)
    variance = noise_variance + 2.0 * float(np.trace(spread @ spread))
    shape, scale = mean**2 / variance, variance / mean
    limit = float(np.sqrt(stats.gamma.isf(alpha_of_limit, shape, scale=scale))) * allowed
    if not np.isfinite(channel.mse):
        return 0.0, limit
    return float(stats.gamma.sf(channel.mse / level, shape, scale=scale)), limit


def _effective_squares(errors: FloatArray, window: np.ndarray) -> float:
    """Number of independent squares that correlated errors (n,) are worth: n / (1 + 2·Σρ²)."""
    n, total = len(errors), 1.0
    power = float(errors @ errors)
    longest = int(np.bincount(window).max(initial=1))
    for lag in range(1, min(longest, n // 2)):
        rho = float(errors[lag:] @ errors[:-lag]) / max(power, 1e-300)
        total += 2.0 * max(rho * rho - 1.0 / n, 0.0)
    return n / total


def scored_slopes(problem: Problem, score: Score) -> FloatArray:
    """Return the derivatives of scored errors by the scaled free parameters, each window's state refitted.

    Args:
        problem: the problem over lead-ins and scored parts of the windows.
        score: the score, with the states that fit the lead-ins.

    Returns:
        Derivatives (n·c, P) of the errors, which are in units of noise.
    """
    point = Point(problem.start().z, score.states)
    lin = problem.linearise(point, problem.residuals(point))
    scored = np.repeat(score.windows.scored, len(problem.sigma))
    slopes = lin.by_parameters
    if lin.by_states.shape[1]:
        lead_in = lin.by_states * ~scored[:, None]
        state_changes = np.linalg.solve(problem.state_gram(lead_in), problem.products(lead_in, slopes))
        slopes = without_states(slopes, lin.by_states, np.asarray(state_changes), problem.edges)
    return np.asarray(slopes[scored])


def difference_p_value(
    difference: FloatArray,
    covariance: FloatArray,
    n_effective: float,
    *,
    min_relative_eigenvalue: float = 1e-10,
) -> float:
    """Test whether a difference of two estimates is zero (Wald's test).

    The covariance is itself estimated, so the statistic is Hotelling's T². Directions of which nothing is
    known (infinite variances) take no part.

    Args:
        difference: difference of the values (k,).
        covariance: its covariance (k, k).
        n_effective: number of independent samples that the covariance is estimated from.
        min_relative_eigenvalue: share of the largest eigenvalue of the correlation matrix below which an
            eigenvalue is rounding.

    Returns:
        The p value; 1 where nothing is known.
    """
    errors = np.sqrt(np.diag(covariance))
    known = np.isfinite(errors) & (errors > 0.0)
    if not known.any():
        return 1.0
    scaled = difference[known] / errors[known]
    correlation = covariance[np.ix_(known, known)] / np.outer(errors[known], errors[known])
    eigenvalues, directions = np.linalg.eigh(0.5 * (correlation + correlation.T))
    kept = eigenvalues > min_relative_eigenvalue * eigenvalues[-1]
    statistic = float(np.sum((directions[:, kept].T @ scaled) ** 2 / eigenvalues[kept]))
    k = int(kept.sum())
    freedom = max(n_effective - k, 2.0)
    return float(stats.f.sf(statistic * freedom / (k * (freedom + k - 1.0)), k, freedom))


def structure_p_value(
    problem: Problem, point: Point, residuals: FloatArray, jacobian: FloatArray, *, n_lags: int = 20
) -> tuple[float, ...]:
    """Test whether the residuals of each output are correlated with the recent past of the inputs.

    First the part of the past inputs is projected out that other parameter values or initial states could
    explain. Then both are whitened by an autoregression of the residuals, and the regression of residuals on
    past inputs is tested by F.

    Args:
        problem: problem of the refitted model.
        point: its parameters and states.
        residuals: its residuals (N·c,).
        jacobian: its projected slopes (N·c, P).
        n_lags: number of past samples of each input.

    Returns:
        A p value for each output.
    """
    record, c = problem.record, len(problem.sigma)
    slopes = problem.state_slopes(point, residuals)
    # where windows have no states of their own only the recordings are breaks
    rows = np.arange(len(problem.windows.rows))
    owner = problem.windows.owner if slopes.shape[1] else np.searchsorted(problem.begins, rows, side="right")
    p_values = []
    for j in range(c):
        columns = [_past(record.inputs[:, k], problem, n_lags) for k in _driving_inputs(record, problem, j)]
        past = np.hstack(columns)
        lagged = np.zeros((len(residuals), past.shape[1]))
        lagged[j::c] = past - past.mean(axis=0)
        lagged = _project_out(problem, slopes, jacobian, lagged)
        p_values.append(_regression_p_value(residuals[j::c], lagged[j::c], owner))
    return tuple(p_values)


def _driving_inputs(record: Record, problem: Problem, j: int) -> list[int]:
    """Columns of the inputs whose past may show in output ``j``: the first, or those of its own joint."""
    joint = record.output_joints[j] if record.output_joints else None
    if joint is None or problem.model.metric is not Metric.INVERSE_DYNAMICS:
        return [0]
    return [k for k, name in enumerate(record.input_names) if name.endswith(f"_{joint}")]


def _past(u: FloatArray, problem: Problem, n_lags: int) -> FloatArray:
    """An input (n,) at all rows of the windows and at the samples before each, (N, ``n_lags``).

    Before a recording the input is taken as its first value.
    """
    rows = problem.windows.rows
    begins = np.array([begin.row for begin in problem.record.begins])
    first = begins[np.searchsorted(begins, rows, side="right") - 1]
    return np.column_stack([u[np.maximum(rows - k, first)] for k in range(n_lags)])


def _project_out(
    problem: Problem, slopes: FloatArray, jacobian: FloatArray, columns: FloatArray
) -> FloatArray:
    """Project columns (N·c, k) on the complement of what states of the windows and parameters can change."""
    columns = problem.project_out_states(slopes, columns)
    length = np.linalg.norm(jacobian, axis=0)
    vectors, singular, _ = np.linalg.svd(
        jacobian[:, length > 0.0] / length[length > 0.0], full_matrices=False
    )
    basis = vectors[:, singular > 1e-8]
    return np.asarray(columns - basis @ (basis.T @ columns))


def _regression_p_value(
    residuals: FloatArray, columns: FloatArray, owner: np.ndarray, *, max_order: int = 10
) -> float:
    """p value of a regression of ``residuals`` (n,) on ``columns`` (n, k).

    Both are whitened by an autoregression of at most ``max_order`` within each window; ``owner`` (n,) is the
    window of each row.
    """
    order = int(min(max_order, len(residuals) // 50))
    both = np.column_stack([residuals, columns])
    weights = _autoregression_weights(residuals, owner, order)
    is_inside = np.r_[np.zeros(order, dtype=bool), owner[order:] == owner[: len(owner) - order]]
    white = both.copy()
    for lag, weight in enumerate(weights, 1):
        white[lag:] -= weight * both[:-lag]
    white = white[is_inside]
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


def _autoregression_weights(residuals: FloatArray, owner: np.ndarray, order: int) -> FloatArray:
    """Weights (order,) of the autoregression of residuals within the windows, by least squares."""
    if not order:
        return np.empty(0)
    past = np.column_stack([residuals[order - k : len(residuals) - k] for k in range(1, order + 1)])
    same_window = owner[order:] == owner[: len(owner) - order]
    weights, *_ = np.linalg.lstsq(past[same_window], residuals[order:][same_window], rcond=None)
    return np.asarray(weights)
