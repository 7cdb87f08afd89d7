"""Evidence of data for one model over another: BIC on the search data, likelihood gain on held-out data.

Residuals are correlated, so that every criterion counts effective samples instead of samples. ``judge.py``
decides with these figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from labhil.identify.fitted import Fitted
from labhil.identify.score import Score
from labhil.identify.statistics import autoregressive_variance, lag_one_products
from labhil.physics.model import Metric
from labhil.signals import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Evidence:
    """The evidence for an addition.

    Attributes:
        delta_bic: BIC with it less BIC without it on the search data; negative speaks for it.
        p_value: one-sided p value of the gain on held-out data.
        heldout_loglik_gain: gain in log likelihood on held-out data, nats.
    """

    delta_bic: float
    p_value: float
    heldout_loglik_gain: float


def effective_samples(fitted: Fitted, joint: int | None = None) -> float:
    """Count the independent samples that the residuals of a fit are worth.

    Args:
        fitted: the fit.
        joint: count only the residuals of this joint's output; None counts those of all outputs.

    Returns:
        Effective number of samples.
    """
    problem = fitted.problem
    return independent_samples(
        _residuals_by_channel(fitted, joint), problem.begins, float(problem.effective_fraction.mean())
    )


def independent_samples(
    residuals: FloatArray, begins: Sequence[int] = (0,), effective_fraction: float = 1.0
) -> float:
    """Count the independent samples that correlated residuals are worth, by an AR(1) model of all channels.

    An AR(1) process with correlation ρ of neighbours is worth n·(1 − ρ)/(1 + ρ) samples.

    Args:
        residuals: residuals, (n, channels).
        begins: rows at which a stretch of neighbouring samples begins.
        effective_fraction: upper limit of the share that counts, where readings are rounded.

    Returns:
        Effective number of samples.
    """
    power = float(np.sum(residuals**2))
    rho = float(np.sum(lag_one_products(residuals, begins))) / power if power > 0 else 0.0
    rho = min(max(rho, 0.0), 0.99)
    return residuals.size * min((1.0 - rho) / (1.0 + rho), effective_fraction)


def bic(fitted: Fitted, effective: float, degrees: float | None = None, joint: int | None = None) -> float:
    """Schwarz's Bayesian information criterion of a fit, n·ln MSE + k·ln n (Ann. Stat. 6, 1978).

    The initial states of the windows are not counted: they are the same in all fits that are compared.

    Args:
        fitted: the fit.
        effective: effective number of samples n.
        degrees: degrees of freedom k; None counts the free parameters.
        joint: judge only the output of this joint, for an effect that acts on it alone.

    Returns:
        The criterion; less is better.
    """
    free = len(fitted.problem.free) if degrees is None else degrees
    return float(effective * _log_mean_square(fitted, joint) + free * np.log(effective))


def search_p_value(before: Fitted, after: Fitted, effective: float, n_candidates: int) -> float:
    """p value of the likelihood ratio of two nested fits, with Bonferroni's correction.

    Args:
        before: the fit without the addition.
        after: the fit with it.
        effective: effective number of samples.
        n_candidates: number of candidates of which this one was chosen.

    Returns:
        The corrected p value, at most 1.
    """
    added = max(len(after.problem.free) - len(before.problem.free), 1)
    ratio = effective * (_log_mean_square(before) - _log_mean_square(after))
    return float(min(1.0, n_candidates * stats.chi2.sf(max(ratio, 0.0), added)))


def _residuals_by_channel(fitted: Fitted, joint: int | None = None) -> FloatArray:
    """Residuals by channel, (n, channels), or those of one joint, (n, 1)."""
    residuals = fitted.solution.residuals.reshape(-1, len(fitted.problem.sigma))
    return residuals if joint is None else residuals[:, [fitted.problem.record.output_joints.index(joint)]]


def _log_mean_square(fitted: Fitted, joint: int | None = None) -> float:
    """Mean over the channels of the log mean square of a fit's residuals, or that of one joint."""
    return _mean_log_mean_square(_residuals_by_channel(fitted, joint))


def _mean_log_mean_square(residuals: FloatArray) -> float:
    """Mean over the channels of the log of their mean square: each channel has a noise level of its own."""
    return float(np.mean(np.log(np.maximum(np.mean(residuals**2, axis=0), 1e-300))))


def best_heldout_gain(before: Sequence[Score], after: Sequence[Score]) -> tuple[float, float]:
    """The most significant of the held-out gains on windows of several lengths.

    Args:
        before: scores of the model without the addition, one for each length.
        after: scores of the model with it, on the same windows.

    Returns:
        Log likelihood gain in nats, and its p value with Bonferroni's correction for the number of lengths.
    """
    gains = [heldout_gain(b, a) for b, a in zip(before, after, strict=True)]
    total, p_value = min(gains, key=lambda gain: gain[1])
    return total, min(1.0, len(gains) * p_value)


def heldout_gain(before: Score, after: Score, *, n_blocks: int = 12) -> tuple[float, float]:
    """Log likelihood that a model gains over another one on held-out data, and its p value.

    Args:
        before: score of the model without the addition.
        after: score of the model with it, on the same windows.
        n_blocks: number of blocks that errors of inverse dynamics, which has no windows, are cut into.

    Returns:
        Gain in nats, counted in effective samples, and the one-sided p value of :func:`direction_p_value`.
    """
    scale = _error_scale(after)
    errors_before, errors_after = before.errors / scale, after.errors / scale
    begins = np.flatnonzero(np.r_[True, np.diff(after.window) > 0]).tolist()
    owner = after.window
    if after.metric is Metric.INVERSE_DYNAMICS:
        owner = np.arange(len(errors_after)) * n_blocks // len(errors_after)
    gain = float(np.sum(_student_log_density(errors_after) - _student_log_density(errors_before)))
    share = _independent_share(errors_after, begins)
    return share * gain, direction_p_value(errors_before, errors_after, owner, begins)


def direction_p_value(before: FloatArray, after: FloatArray, owner: IntArray, begins: Sequence[int]) -> float:
    """One-sided p value that errors on held-out data fall along the step from one model to another.

    The step Δ was chosen on other data. If the first model were right, its errors would be noise, and their
    product with Δ zero on average. The variance of that product follows from the errors of the second model,
    once by an autoregression of each channel and once by windows, since slow errors last for a window; the
    larger p value counts. Both factors are clipped, so that a window that a model fails to follow does not
    decide.

    Args:
        before: errors of the first model in units of their scale, (n, channels).
        after: errors of the second model, (n, channels).
        owner: number of the window of each row, (n,).
        begins: rows at which a window begins.

    Returns:
        The p value; 1 with fewer than three windows or without a step.
    """
    step, errors = _clip(before - after), _clip(after)
    windows = len(np.unique(owner))
    if windows < 3 or not np.any(step):
        return 1.0
    product = float(np.sum(step * _clip(before)))
    by_window = np.bincount(owner, np.sum(step * errors, axis=1))
    modelled = float(
        autoregressive_variance(step.reshape(-1, 1), errors.ravel(), errors.shape[1], begins)[0, 0]
    )
    by_samples = stats.norm.sf(product / np.sqrt(modelled + 1e-300))
    by_windows = stats.t.sf(product / np.sqrt(by_window @ by_window + 1e-300), windows - 1)
    return float(max(by_samples, by_windows))


def _clip(errors: FloatArray, max_size: float = 3.0) -> FloatArray:
    """Limit errors to ± ``max_size`` noise levels."""
    return np.clip(errors, -max_size, max_size)


def _error_scale(after: Score) -> FloatArray:
    """Unit of the errors, the larger of noise floor and RMSE: (c,), or (N, c) where recordings differ."""
    if not after.recordings:
        return np.array([max(c.noise_floor, c.rmse) for c in after.channels])
    scale = np.empty_like(after.errors)
    for recording in after.recordings:
        scale[recording.places] = [max(c.noise_floor, c.rmse) for c in recording.channels]
    return scale


def _independent_share(errors: FloatArray, begins: Sequence[int]) -> float:
    """Share of the samples of errors (N, c) that are independent, by the AR(1) of the slowest channel."""
    rho = np.sum(lag_one_products(errors, begins), axis=0) / np.maximum(np.sum(errors**2, axis=0), 1e-300)
    rho = float(np.clip(np.max(rho), 0.0, 0.99))
    return (1.0 - rho) / (1.0 + rho)


def _student_log_density(errors: FloatArray, dof: float = 4.0) -> FloatArray:
    """Log density (N,) of Student's t, up to a constant, summed over the channels of errors (N, c).

    Its heavy tails (``dof`` degrees of freedom) keep one window that a model fails to follow from deciding.
    """
    return np.asarray(-0.5 * (dof + 1.0) * np.log1p(errors**2 / dof).sum(axis=1))
