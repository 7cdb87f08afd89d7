"""Whether a model leaves more than noise, on windows whose initial states are fitted to all of their samples.

Scores predict, and an error of the initial state grows with the horizon, so that a handful of windows says
little of what else is wrong. Windows that are fitted to their end leave noise and what the model lacks.
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
"""The same of inverse dynamics, whose noise is known only from differences of neighbours."""

WITH_LEAD = 1.5
"""A scored window and its lead-in, in horizons."""

STANDS_IN = 0.5
"""Share of the excess that a force has to explain, or it only stands in for something else."""


def residual_rms_on(
    model: Model, theta: FloatArray, record: Record, noise: Noise, length: float
) -> FloatArray:
    """RMS (c,) of what a model leaves of each output, in units of its noise, windows ``length`` s long.

    The noise that a measured input brings into the simulation counts as noise.
    """
    inverse_dynamics = model.metric is Metric.INVERSE_DYNAMICS
    windows = Windows.of(record.spans) if inverse_dynamics else fit_windows(record, length)
    problem = Problem(model, record, windows, np.empty(0, dtype=np.int64), theta, noise.sigma)
    estimate = estimate_states(problem, np.empty(0), thorough=True)
    squares = estimate.residuals.reshape(-1, len(noise.sigma)) ** 2
    by_input = variance_by_input_noise(problem, Point(np.empty(0), estimate.states), estimate.residuals)
    return np.asarray(np.sqrt(squares.mean(axis=0) / (1.0 - estimate.states.size / squares.size + by_input)))


def residual_rms(data: Data, fitted: Fitted) -> FloatArray:
    """RMS (2, c) that a fit leaves of search and held-out data: on its own windows, or on the metric's."""
    length = length_of(fitted)
    return np.array(
        [_worst_rms(record, data.model, fitted.theta, length) for record in (data.search, data.test)]
    )


def _worst_rms(record: Record, model: Model, theta: FloatArray, of_fit: float) -> FloatArray:
    """The larger RMS (c,) of those on windows of the fit and on the metric's with their lead-in."""
    noise = estimate_coloured_noise(model, theta, record, noise_of(record))
    lengths = {of_fit}
    if model.metric is not Metric.INVERSE_DYNAMICS:
        lengths.add(max(of_fit, WITH_LEAD * scored_horizon(model, theta, record)))
    return np.max([residual_rms_on(model, theta, record, noise, length) for length in lengths], axis=0)


def exceeds_noise(data: Data, rms: FloatArray) -> bool:
    """Whether an RMS (…, c), in units of the noise, is more than noise, of any output."""
    limit = EXCESS if data.model.metric is Metric.INVERSE_DYNAMICS else UNEXPLAINED
    return bool(np.max(rms) > limit)
