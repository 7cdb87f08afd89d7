"""Whether a model leaves more than noise: on windows that all of their samples found the initial state of.

Scores have to foretell, and an error of the initial state grows with the horizon; a handful of windows then
says little of what else is wrong. Windows that are fitted to their end leave noise and what the model lacks.
"""

from __future__ import annotations

import numpy as np

from labhil.diagnose.curve import length_of
from labhil.diagnose.judge import Data
from labhil.identify.fitted import Fitted
from labhil.identify.input_noise import variance_by_input_noise
from labhil.identify.noise import Noise, estimate_coloured_noise
from labhil.identify.problem import Point, Problem
from labhil.identify.score import scored_horizon
from labhil.identify.window_states import estimate_states
from labhil.identify.windows import fit_windows, noise_of
from labhil.physics.model import Metric, Model, Record, Windows
from labhil.signals import FloatArray

UNEXPLAINED = 1.2
"""RMS of what is left, in units of the noise, that no noise makes: it is known to a few per cent."""

EXCESS = 2.5
"""The same where all there is to know the noise from are differences of neighbours, of inverse dynamics."""

WITH_LEAD = 1.5
"""A scored window and its lead-in, in horizons."""

STANDS_IN = 0.5
"""Share of the excess that terms must have explained of which more is left, or they only stand in for it."""


def residual_rms_on(
    model: Model, theta: FloatArray, record: Record, noise: Noise, length: float
) -> FloatArray:
    """RMS (c,) of what a model leaves of each output, in units of its noise, windows ``length`` s long.

    With what the noise of a measured input makes of the simulation counted among the noise.
    """
    whole = model.metric is Metric.INVERSE_DYNAMICS
    windows = Windows.of(record.spans) if whole else fit_windows(record, length)
    problem = Problem(model, record, windows, np.empty(0, dtype=np.int64), theta, noise.sigma)
    found = estimate_states(problem, np.empty(0), thorough=True)
    squares = found.residuals.reshape(-1, len(noise.sigma)) ** 2
    by_input = variance_by_input_noise(problem, Point(np.empty(0), found.states), found.residuals)
    return np.asarray(np.sqrt(squares.mean(axis=0) / (1.0 - found.states.size / squares.size + by_input)))


def residual_rms(data: Data, fitted: Fitted) -> FloatArray:
    """What a fit leaves of search and held-out data, (2, c): on its own windows, or on the metric's."""
    length = length_of(fitted)
    return np.array([_left_of(each, data.model, fitted.theta, length) for each in (data.search, data.test)])


def _left_of(record: Record, model: Model, theta: FloatArray, length: float) -> FloatArray:
    """The larger of what is left (c,) on windows of the fit and on those of the metric with their lead-in."""
    noise = estimate_coloured_noise(model, theta, record, noise_of(record))
    lengths = {length}
    if model.metric is not Metric.INVERSE_DYNAMICS:
        lengths.add(max(length, WITH_LEAD * scored_horizon(model, theta, record)))
    return np.max([residual_rms_on(model, theta, record, noise, each) for each in lengths], axis=0)


def unexplained(data: Data, left: FloatArray) -> bool:
    """Whether that (…, c) is more than noise, of any output."""
    limit = EXCESS if data.model.metric is Metric.INVERSE_DYNAMICS else UNEXPLAINED
    return bool(np.max(left) > limit)
