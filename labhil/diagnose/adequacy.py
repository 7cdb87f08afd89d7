"""Residual adequacy: does a model leave more than noise once the initial states of windows are fitted?

A score predicts from an estimated initial state, whose error grows with the horizon; a handful of windows
then says little about the model. Here the states are fitted to all samples of a window, so that noise and
model error remain. ``conclude.py`` combines this with the scores.
"""

from __future__ import annotations

import numpy as np

from labhil.diagnose.curve import mean_window_length
from labhil.diagnose.judge import Data
from labhil.identify.adequacy import adequacy_of
from labhil.identify.fitted import Fitted
from labhil.identify.input_noise import variance_by_input_noise
from labhil.identify.noise import Noise, estimate_coloured_noise
from labhil.identify.problem import Point, Problem
from labhil.identify.score import score, scored_horizon
from labhil.identify.window_states import estimate_states
from labhil.identify.windows import fit_windows, noise_of
from labhil.physics.model import Metric, Model
from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray

MAX_RMS_IN_NOISE = 1.2
"""RMS of residuals, in units of the noise, that noise alone may reach: it is known to a few per cent."""


def leaves_only_noise(data: Data, fitted: Fitted) -> bool:
    """Whether a model explains the searched data by the metric of the rig."""
    return adequacy_of([score(data.model, fitted.theta, data.search, data.sigma)]).explained


def residual_rms_on(
    model: Model, theta: FloatArray, record: Record, noise: Noise, length: float
) -> FloatArray:
    """RMS of the residuals of each output on windows of a given length, in units of the noise.

    The noise that a measured input brings into the simulation counts as noise.

    Args:
        model: the model.
        theta: its parameter vector.
        record: the recording.
        noise: the noise of its outputs.
        length: length of the windows, s; inverse dynamics has no windows and ignores it.

    Returns:
        RMS of each output, (c,); about 1 for a complete model.
    """
    inverse_dynamics = model.metric is Metric.INVERSE_DYNAMICS
    windows = Windows.of(record.spans) if inverse_dynamics else fit_windows(record, length)
    problem = Problem(model, record, windows, np.empty(0, dtype=np.int64), theta, noise.sigma)
    estimate = estimate_states(problem, np.empty(0), thorough=True)
    squares = estimate.residuals.reshape(-1, len(noise.sigma)) ** 2
    by_input = variance_by_input_noise(problem, Point(np.empty(0), estimate.states), estimate.residuals)
    return np.asarray(np.sqrt(squares.mean(axis=0) / (1.0 - estimate.states.size / squares.size + by_input)))


def residual_rms(data: Data, fitted: Fitted) -> FloatArray:
    """RMS of the residuals of a fit on search and held-out data, in units of the noise.

    Args:
        data: the data of the search.
        fitted: the fit.

    Returns:
        RMS by data set (search, held-out) and output, (2, c): the larger of that on windows of the fit and
        on windows of the metric.
    """
    length = mean_window_length(fitted)
    return np.array(
        [_worst_rms(record, data.model, fitted.theta, length) for record in (data.search, data.test)]
    )


def _worst_rms(
    record: Record,
    model: Model,
    theta: FloatArray,
    fit_window: float,
    *,
    window_in_horizons: float = 1.5,
) -> FloatArray:
    """The larger RMS (c,) of that on windows of the fit (s) and on the metric's with their lead-in."""
    noise = estimate_coloured_noise(model, theta, record, noise_of(record))
    lengths = {fit_window}
    if model.metric is not Metric.INVERSE_DYNAMICS:
        lengths.add(max(fit_window, window_in_horizons * scored_horizon(model, theta, record)))
    return np.max([residual_rms_on(model, theta, record, noise, length) for length in lengths], axis=0)


def exceeds_noise(
    data: Data,
    rms: FloatArray,
    *,
    max_rms: float = MAX_RMS_IN_NOISE,
    max_rms_inverse_dynamics: float = 2.5,
) -> bool:
    """Decide whether residuals of any output are more than noise.

    Args:
        data: the data of the search.
        rms: RMS of residuals in units of the noise, (…, c).
        max_rms: RMS that noise alone may reach.
        max_rms_inverse_dynamics: the same of inverse dynamics, whose noise is known only from the differences
            of neighbouring samples.

    Returns:
        True if the RMS of some output is above the limit.
    """
    limit = max_rms_inverse_dynamics if data.model.metric is Metric.INVERSE_DYNAMICS else max_rms
    return bool(np.max(rms) > limit)
