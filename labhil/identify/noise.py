"""Estimate coloured measurement noise (AR(1)) from the residuals of a fitted model on short windows.

Differences of neighbouring samples (:func:`labhil.identify.windows.noise_of`) give the variance of white
noise; of noise that is correlated over a few samples they show too little. On short windows with initial
states of their own, a missing force F causes an error of only F·T²/2 (T the length of the window), while the
noise is in the residuals but for the part that the fitted states absorb, which is larger for correlated
noise. Variance and lag-one covariance of the residuals therefore give the two parameters of an autoregression
of first order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.identify.problem import Point, Problem
from labhil.identify.window_states import fit_states
from labhil.identify.windows import fit_windows, noise_of
from labhil.physics.model import Metric, Model
from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray

THIRD_DIFFERENCE = (20.0, -30.0, 12.0, -2.0)
"""Variance of third differences, as coefficients of the noise's autocovariance at lags 0 to 3."""

MAX_NOISE_RATIO = 3.0
"""Largest standard deviation of coloured noise over that of white noise; beyond, a model error is assumed."""

CORRELATIONS = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85])
"""Grid of lag-one correlations of the noise; a correlation beyond its end would be a motion."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Coloured noise of each channel, an autoregression of first order.

    Attributes:
        sigma: (c,) standard deviation, in the channels' units.
        correlation: (c,) correlation of neighbouring samples.
    """

    sigma: FloatArray
    correlation: FloatArray

    @property
    def variance_inflation(self) -> FloatArray:
        """Variance of the mean of many samples over that of as many independent ones, (c,)."""
        return np.asarray((1.0 + self.correlation) / (1.0 - self.correlation))


def white_noise(sigma: FloatArray) -> Noise:
    """White noise with standard deviations ``sigma`` (c,)."""
    return Noise(sigma, np.zeros(len(sigma)))


def estimate_coloured_noise(
    model: Model,
    theta: FloatArray,
    record: Record,
    sigma: FloatArray,
    *,
    window_samples: int = 24,
    max_horizon_share: float = 1.0 / 8.0,
) -> Noise:
    """Estimate the standard deviation and the lag-one correlation of each channel's noise.

    Args:
        model: A model that was fitted to the record.
        theta: Its parameter vector.
        record: What was measured.
        sigma: (c,) standard deviation of the noise if it were white, in the channels' units.
        window_samples: Samples in a short window: many times the correlation time of noise, and few enough
            that errors of the model stay small.
        max_horizon_share: Longest such window, as a share of the scored horizon.

    Returns:
        Standard deviations between ``sigma`` and 3 times ``sigma``. Of inverse dynamics, which has no
        windows, it is white noise from differences of the residuals, and may be less than ``sigma``.
    """
    if model.metric is Metric.INVERSE_DYNAMICS:
        return white_noise(_filtered_noise(model, theta, record))
    length = min(window_samples * record.period, max_horizon_share * model.horizon)
    if length < window_samples / 2 * record.period:
        return white_noise(sigma)
    problem = Problem(model, record, fit_windows(record, length), np.empty(0, dtype=np.int64), theta, sigma)
    point = Point(np.empty(0), fit_states(problem, np.empty(0), problem.guess))
    residuals = problem.residuals(point)
    measured = _ResidualPower.of(problem, residuals.reshape(-1, len(sigma)))
    after_states = _noise_after_states(problem, problem.linearise(point, residuals).by_states)
    power, products = after_states[:, 0], after_states[:, 1]
    correlation = np.array(
        [np.interp(measured.ratio[j], products[:, j] / power[:, j], CORRELATIONS) for j in range(len(sigma))]
    )
    share = np.array([np.interp(correlation[j], CORRELATIONS, power[:, j]) for j in range(len(sigma))])
    ratio = np.clip(np.sqrt(measured.power / share), 1.0, MAX_NOISE_RATIO)
    return Noise(np.asarray(sigma * ratio), correlation)


def _filtered_noise(model: Model, theta: FloatArray, record: Record) -> FloatArray:
    """Noise (c,) of the residuals of inverse dynamics, from third differences of the filtered signals."""
    recordings = Windows.of(record.spans)
    residuals = record.outputs - model.simulate(
        theta, record, recordings, model.initial_states(record, recordings)
    )
    # third differences of white noise have 20 times its variance; the filter attenuates them more than it
    attenuation = np.sqrt(THIRD_DIFFERENCE[0] / np.dot(THIRD_DIFFERENCE, record.autocorrelation))
    return np.asarray(noise_of(replace(record, outputs=residuals)) * attenuation)


@dataclass(frozen=True, slots=True)
class _ResidualPower:
    """Mean square (c,) of the residuals in typical windows, and their lag-one products over it (c,)."""

    power: FloatArray
    ratio: FloatArray

    @classmethod
    def of(cls, problem: Problem, residuals: FloatArray, *, max_power_ratio: float = 3.0) -> _ResidualPower:
        """From residuals (N, c).

        Windows whose power is more than ``max_power_ratio`` times the median's do not count: their initial
        state may be wrong, or a jump lies in them.
        """
        owner = problem.windows.owner
        counts = np.bincount(owner)
        squares, products = residuals**2, residuals[:-1] * residuals[1:] * (np.diff(owner) == 0)[:, None]
        by_window = np.array([np.bincount(owner, column) for column in squares.T]).T
        pairs = np.array([np.bincount(owner[:-1], column, len(counts)) for column in products.T]).T
        mean = by_window / counts[:, None]
        typical = mean <= max_power_ratio * np.median(mean, axis=0)
        total = np.sum(by_window * typical, axis=0)
        return cls(
            total / np.sum(counts[:, None] * typical, axis=0),
            np.sum(pairs * typical, axis=0) / np.maximum(total, 1e-300),
        )


def _noise_after_states(problem: Problem, by_states: FloatArray, *, max_windows: int = 24) -> FloatArray:
    """Expected squares and lag-one products of AR(1) noise after states are fitted to it, (R, 2, c).

    Per sample, for noise of unit variance and R correlations. ``by_states`` (N·c, S) are the residuals'
    slopes; as windows differ little, no more than ``max_windows`` are used.
    """
    c = len(problem.sigma)
    edges = np.append(problem.edges, len(by_states))
    chosen = np.unique(np.linspace(0, len(edges) - 2, max_windows).astype(int))
    sums, samples = np.zeros((len(CORRELATIONS), 2, c)), 0
    for w in chosen:
        slopes = by_states[edges[w] : edges[w + 1]]
        n = len(slopes) // c
        basis, _ = np.linalg.qr(slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300))
        projector = np.eye(len(slopes)) - basis @ basis.T
        lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        for k, rho in enumerate(CORRELATIONS):
            covariance = projector @ np.kron(rho**lag, np.eye(c)) @ projector
            sums[k, 0] += np.diag(covariance).reshape(n, c).sum(axis=0)
            sums[k, 1] += np.diag(covariance, c).reshape(n - 1, c).sum(axis=0)
        samples += n
    return sums / samples
