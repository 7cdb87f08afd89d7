"""How strongly data speak for one model over another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from labhil.identify.fitted import Fitted
from labhil.identify.score import Score
from labhil.signals import FloatArray

STUDENT = 4.0
"""Degrees of freedom of the held-out likelihood: a window that a bad model loses must not decide alone."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Search data by BIC (negative is better), held-out data by likelihood, nats, with its p value."""

    delta_bic: float
    p_value: float
    heldout_loglik_gain: float


def effective_samples(residuals: FloatArray) -> float:
    """How many independent residuals these (n,) are worth, by their AR(1)."""
    power = float(residuals @ residuals)
    rho = float(residuals[1:] @ residuals[:-1]) / power if power > 0 else 0.0
    rho = min(max(rho, 0.0), 0.99)
    return len(residuals) * (1.0 - rho) / (1.0 + rho)


def bic(fitted: Fitted, effective: float) -> float:
    """Schwarz's criterion with as many samples as the residuals are worth; windows' states cost the same."""
    n = len(fitted.solution.residuals)
    return float(effective * np.log(fitted.solution.cost / n) + len(fitted.problem.free) * np.log(effective))


def search_p_value(before: Fitted, after: Fitted, effective: float, looks: int) -> float:
    """p value of the likelihood ratio on the search data, times the number of candidates looked at."""
    added = max(len(after.problem.free) - len(before.problem.free), 1)
    ratio = effective * np.log(before.solution.cost / max(after.solution.cost, 1e-300))
    return float(min(1.0, looks * stats.chi2.sf(max(ratio, 0.0), added)))


def heldout_gain(before: Score, after: Score) -> tuple[float, float]:
    """Log likelihood that a model gains on data it never saw, nats, and the p value that it gains at all.

    Windows are independent, so they are what is counted: a one-sided t test of the gains of windows.
    """
    scale = np.array([max(c.noise_floor, c.rmse) for c in after.channels])
    gain = _student(after.errors / scale) - _student(before.errors / scale)
    owners = np.unique(after.window)
    # a window's samples are one smooth error, worth about as many as it has turns: count it as one
    gains = np.array([gain[after.window == w].mean() for w in owners])
    total = float(gains.sum())
    if len(gains) < 3 or not np.any(gains):
        return total, 1.0
    t = gains.mean() / (gains.std(ddof=1) / np.sqrt(len(gains)) + 1e-300)
    return total, float(stats.t.sf(t, len(gains) - 1))


def _student(errors: FloatArray) -> FloatArray:
    """Log density of scaled errors (N, c) up to a constant, summed over the channels, (N,)."""
    return np.asarray(-0.5 * (STUDENT + 1.0) * np.log1p(errors**2 / STUDENT).sum(axis=1))
