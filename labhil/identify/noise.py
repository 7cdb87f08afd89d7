"""Noise of outputs as a fitted model leaves it on windows too short for its own errors to grow.

Differences of neighbouring samples (:func:`labhil.identify.windows.noise_of`) know noise of one sample only:
of noise that lasts for a few samples they see too little. On short windows with initial states of their own
a model that is wrong by a force is off by that force times half of the window squared, which is little; noise
is all there.
"""

from __future__ import annotations

from dataclasses import replace

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


def lasting_noise(model: Model, theta: FloatArray, record: Record, sigma: FloatArray) -> FloatArray:
    """Standard deviation of each channel's noise (channels,), at least ``sigma`` and at most 3 times that.

    ``theta`` is the model's fitted vector. Inverse dynamics has no windows: there it is the noise of what the
    model leaves, without the motion, and it may be less than ``sigma``.
    """
    if model.metric is Metric.INVERSE_DYNAMICS:
        every = Windows.of(record.spans)
        left = record.outputs - model.simulate(theta, record, every, model.initial_states(record, every))
        # of white noise 20; a filter takes away most where differences are the largest
        return noise_of(replace(record, outputs=left)) * np.sqrt(THIRD[0] / np.dot(THIRD, record.alike))
    length = min(SAMPLES * record.period, LONGEST * model.horizon)
    if length < SAMPLES / 2 * record.period:
        return sigma
    windows = fit_windows(record, length)
    problem = Problem(model, record, windows, np.empty(0, dtype=np.int64), theta, sigma)
    none = np.empty(0)
    states = fit_states(problem, none, problem.guess)
    squares = problem.residuals(Point(none, states)).reshape(-1, len(sigma)) ** 2
    # a window that begins in a wrong state, or through which something jumps, must not decide
    per_window = np.array([squares[windows.owner == w].sum(axis=0) for w in range(len(windows))])
    counts = np.bincount(windows.owner)
    freedom = np.maximum(counts - states.shape[1] / len(sigma), 1.0)
    typical = np.median(per_window / freedom[:, None], axis=0)
    return np.asarray(sigma * np.clip(np.sqrt(typical), 1.0, MOST))
