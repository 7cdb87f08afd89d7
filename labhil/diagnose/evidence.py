"""How strongly data speak for one model over another."""

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

BLOCKS = 12
"""Into which the errors of inverse dynamics are cut."""

STUDENT = 4.0
"""Degrees of freedom of the held-out likelihood: a window that a bad model loses must not decide alone."""

CLIPPED = 3.0
"""Noise levels beyond which an error counts no more."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Search data by BIC (negative is better), held-out data by likelihood, nats, with its p value."""

    delta_bic: float
    p_value: float
    heldout_loglik_gain: float


def effective_samples(fitted: Fitted, joint: int | None = None) -> float:
    """How many independent residuals those of a fit are worth, or those of one joint's output."""
    problem = fitted.problem
    return independent_samples(
        _channels(fitted, joint), problem.begins, float(problem.effective_fraction.mean())
    )


def independent_samples(
    residuals: FloatArray, begins: Sequence[int] = (0,), effective_fraction: float = 1.0
) -> float:
    """How many independent ones residuals (n, channels) are worth, by an AR(1) of all channels.

    Recordings begin at the rows ``begins``. No more than the share ``effective_fraction``, where readings are
    rounded.
    """
    power = float(np.sum(residuals**2))
    rho = float(np.sum(lag_one_products(residuals, begins))) / power if power > 0 else 0.0
    rho = min(max(rho, 0.0), 0.99)
    return residuals.size * min((1.0 - rho) / (1.0 + rho), effective_fraction)


def bic(fitted: Fitted, effective: float, degrees: float | None = None, joint: int | None = None) -> float:
    """Schwarz's criterion with as many samples as the residuals are worth; windows' states cost the same.

    ``degrees`` are the free parameters, where they are not simply counted. What acts on one ``joint`` is
    judged by that joint's output: what others leave, and how long it lasts, says nothing of it.
    """
    free = len(fitted.problem.free) if degrees is None else degrees
    return float(effective * _log_power(fitted, joint) + free * np.log(effective))


def search_p_value(before: Fitted, after: Fitted, effective: float, looks: int) -> float:
    """p value of the likelihood ratio on the search data, times the number of candidates looked at."""
    added = max(len(after.problem.free) - len(before.problem.free), 1)
    ratio = effective * (_log_power(before) - _log_power(after))
    return float(min(1.0, looks * stats.chi2.sf(max(ratio, 0.0), added)))


def _channels(fitted: Fitted, joint: int | None = None) -> FloatArray:
    """Residuals by channel, (n, channels), or those of one joint, (n, 1)."""
    residuals = fitted.solution.residuals.reshape(-1, len(fitted.problem.sigma))
    return residuals if joint is None else residuals[:, [fitted.problem.record.output_joints.index(joint)]]


def _log_power(fitted: Fitted, joint: int | None = None) -> float:
    return _mean_log_power(_channels(fitted, joint))


def _mean_log_power(residuals: FloatArray) -> float:
    """Mean over the channels of the logarithm of their mean square: each has a noise level of its own."""
    return float(np.mean(np.log(np.maximum(np.mean(residuals**2, axis=0), 1e-300))))


def best_heldout_gain(before: Sequence[Score], after: Sequence[Score]) -> tuple[float, float]:
    """The clearest of the gains on several cuts into windows, its p value times their number."""
    gains = [heldout_gain(b, a) for b, a in zip(before, after, strict=True)]
    total, p_value = min(gains, key=lambda gain: gain[1])
    return total, min(1.0, len(gains) * p_value)


def heldout_gain(before: Score, after: Score) -> tuple[float, float]:
    """Log likelihood that a model gains on data it never saw, nats, and the p value that it gains at all.

    Nats count samples as independent as their neighbours let them be.
    """
    scale = _scale(after)
    errors_before, errors_after = before.errors / scale, after.errors / scale
    begins = np.flatnonzero(np.r_[True, np.diff(after.window) > 0]).tolist()
    owner = after.window
    if after.metric is Metric.INVERSE_DYNAMICS:
        owner = np.arange(len(errors_after)) * BLOCKS // len(errors_after)
    gain = float(np.sum(_student(errors_after) - _student(errors_before)))
    worth = _independent_share(errors_after, begins)
    return worth * gain, direction_p_value(errors_before, errors_after, owner, begins)


def direction_p_value(before: FloatArray, after: FloatArray, owner: IntArray, begins: Sequence[int]) -> float:
    """One-sided p value that scaled errors (n, channels) fall along the step from one model to another.

    The step Δ was chosen on other data. Were the first model right, its errors would be noise, and their
    product with Δ zero on average. The variance of that is taken from what the second model leaves, by an
    autoregression of each channel and by windows (``owner``, (n,)), for slow errors last for a window: the
    larger p value counts. Both factors are clipped, so that a window in which a model loses its way does not
    decide. ``begins`` are the rows where a window begins.
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


def _clip(errors: FloatArray) -> FloatArray:
    return np.clip(errors, -CLIPPED, CLIPPED)


def _scale(after: Score) -> FloatArray:
    """What errors are measured by: (c,), or (N, c) where recordings differ."""
    if not after.recordings:
        return np.array([max(c.noise_floor, c.rmse) for c in after.channels])
    scale = np.empty_like(after.errors)
    for recording in after.recordings:
        scale[recording.places] = [max(c.noise_floor, c.rmse) for c in recording.channels]
    return scale


def _independent_share(errors: FloatArray, begins: Sequence[int]) -> float:
    """Share of the samples of errors (N, c) that are worth an independent one, by each channel's AR(1)."""
    rho = np.sum(lag_one_products(errors, begins), axis=0) / np.maximum(np.sum(errors**2, axis=0), 1e-300)
    rho = float(np.clip(np.max(rho), 0.0, 0.99))
    return (1.0 - rho) / (1.0 + rho)


def _student(errors: FloatArray) -> FloatArray:
    """Log density of scaled errors (N, c) up to a constant, summed over the channels, (N,)."""
    return np.asarray(-0.5 * (STUDENT + 1.0) * np.log1p(errors**2 / STUDENT).sum(axis=1))
