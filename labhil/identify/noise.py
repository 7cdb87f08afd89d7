"""Noise of outputs as a fitted model leaves it on windows too short for its own errors to grow.

Differences of neighbouring samples (:func:`labhil.identify.windows.noise_of`) know noise of one sample only:
of noise that lasts for a few samples they see too little. On short windows with initial states of their own
a model that is wrong by a force errs by that force times half of the window squared, which is little; noise
is all there but for what the windows' states take of it, and of noise that lasts they take more. Taken for an
autoregression of first order it is found from the variance and the covariance of neighbours that are left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.identify.problem import Point, Problem
from labhil.identify.window_states import fit_states
from labhil.identify.windows import fit_windows, noise_of
from labhil.physics.model import Metric, Model, Record, Windows
from labhil.signals import FloatArray

SAMPLES = 24
"""In a short window: many times what noise lasts for, few enough for errors of the model."""

LONGEST = 1.0 / 8.0
"""Of the scored horizon that such a window may take."""

THIRD = (20.0, -30.0, 12.0, -2.0)
"""Variance of third differences by the covariance of the noise of rows 0 to 3 apart."""

MOST = 3.0
"""Factor beyond which what is left is no noise."""


CORRELATIONS = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85])
"""Of neighbouring samples, among which that of the noise is looked for: beyond, it would be a motion."""

TYPICAL = 3.0
"""Times the median power of a window up to which it counts: one begins in a wrong state, one has a jump."""

COUNTED = 24
"""Windows, at most, in which the states' share is worked out: they are much alike."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of each channel: standard deviation (c,), and correlation (c,) of neighbouring samples."""

    sigma: FloatArray
    correlation: FloatArray

    @property
    def lasts(self) -> FloatArray:
        """Variance of a mean of many samples over that of as many independent ones, (c,)."""
        return np.asarray((1.0 + self.correlation) / (1.0 - self.correlation))


def white(sigma: FloatArray) -> Noise:
    """Noise (c,) of which every sample is independent."""
    return Noise(sigma, np.zeros(len(sigma)))


def estimate_coloured_noise(model: Model, theta: FloatArray, record: Record, sigma: FloatArray) -> Noise:
    """Each channel's noise, its standard deviation at least ``sigma`` and at most 3 times that.

    ``theta`` is the model's fitted vector. Inverse dynamics has no windows: there it is the noise of what the
    model leaves, without the motion, and it may be less than ``sigma``.
    """
    if model.metric is Metric.INVERSE_DYNAMICS:
        return white(_filtered_noise(model, theta, record))
    length = min(SAMPLES * record.period, LONGEST * model.horizon)
    if length < SAMPLES / 2 * record.period:
        return white(sigma)
    problem = Problem(model, record, fit_windows(record, length), np.empty(0, dtype=np.int64), theta, sigma)
    point = Point(np.empty(0), fit_states(problem, np.empty(0), problem.guess))
    residuals = problem.residuals(point)
    typical = _ResidualPower.of(problem, residuals.reshape(-1, len(sigma)))
    after_states = _noise_after_states(problem, problem.linearise(point, residuals).by_states)
    power, neighbours = after_states[:, 0], after_states[:, 1]
    correlation = np.array(
        [np.interp(typical.ratio[j], neighbours[:, j] / power[:, j], CORRELATIONS) for j in range(len(sigma))]
    )
    share = np.array([np.interp(correlation[j], CORRELATIONS, power[:, j]) for j in range(len(sigma))])
    return Noise(np.asarray(sigma * np.clip(np.sqrt(typical.power / share), 1.0, MOST)), correlation)


def _filtered_noise(model: Model, theta: FloatArray, record: Record) -> FloatArray:
    """Noise (c,) of what inverse dynamics leaves, where there is no motion."""
    recordings = Windows.of(record.spans)
    residuals = record.outputs - model.simulate(
        theta, record, recordings, model.initial_states(record, recordings)
    )
    # of white noise 20; a filter takes away most where differences are the largest
    attenuation = np.sqrt(THIRD[0] / np.dot(THIRD, record.autocorrelation))
    return np.asarray(noise_of(replace(record, outputs=residuals)) * attenuation)


@dataclass(frozen=True, slots=True)
class _ResidualPower:
    """Of typical windows and each channel, squares per sample (c,), and neighbours' products over these."""

    power: FloatArray
    ratio: FloatArray

    @classmethod
    def of(cls, problem: Problem, residuals: FloatArray) -> _ResidualPower:
        """Of residuals (N, c)."""
        owner = problem.windows.owner
        counts = np.bincount(owner)
        squares, products = residuals**2, residuals[:-1] * residuals[1:] * (np.diff(owner) == 0)[:, None]
        by_window = np.array([np.bincount(owner, column) for column in squares.T]).T
        pairs = np.array([np.bincount(owner[:-1], column, len(counts)) for column in products.T]).T
        mean = by_window / counts[:, None]
        typical = mean <= TYPICAL * np.median(mean, axis=0)
        total = np.sum(by_window * typical, axis=0)
        return cls(
            total / np.sum(counts[:, None] * typical, axis=0),
            np.sum(pairs * typical, axis=0) / np.maximum(total, 1e-300),
        )


def _noise_after_states(problem: Problem, by_states: FloatArray) -> FloatArray:
    """What windows' states leave of unit noise, (R, 2, c) for R correlations.

    Squares and products of neighbours, per sample; ``by_states`` (N·c, S) are the residuals' slopes.
    """
    c = len(problem.sigma)
    edges = np.append(problem.edges, len(by_states))
    chosen = np.unique(np.linspace(0, len(edges) - 2, COUNTED).astype(int))
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
