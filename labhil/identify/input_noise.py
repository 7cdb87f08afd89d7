"""Effect of the noise of a measured input on a simulation (errors in variables).

A model that is driven by a sensor's reading simulates the sensor's noise as if it had acted. Most of it is
smoothed away; the remaining part is no error of the model, and noise floors include it. Its size comes from a
parametric bootstrap: the same windows from the same states, driven by the input with more of the same noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from labhil.identify.problem import Linearised, Point, Problem
from labhil.physics.record import Record
from labhil.signals import FloatArray


def responses_to_input_noise(problem: Problem, point: Point, *, draws: int = 6) -> FloatArray:
    """Simulate how noise on a measured input changes the residuals.

    Args:
        problem: Windows of a record, and the noise of its outputs.
        point: Parameters and states of the model.
        draws: Number of realisations of the noise; over many windows the mean square of six is known to a
            few per cent.

    Returns:
        (N·c, D) changes in units of noise, a column for each draw; D is 0 where no input is known to have
        noise.
    """
    record, theta, states = problem.record, problem.theta(point.z), point.states
    if not any(begin.input_smoothing and begin.input_smoothing.noise for begin in record.begins):
        return np.empty((len(problem.owner), 0))
    simulated = problem.model.simulate(theta, record, problem.windows, states)
    changes = [
        (
            (problem.model.simulate(theta, noisy_record, problem.windows, states) - simulated) / problem.noise
        ).ravel()
        for noisy_record in _with_more_noise(record, draws)
    ]
    return np.column_stack(changes)


def variance_by_input_noise(problem: Problem, point: Point, residuals: FloatArray) -> FloatArray:
    """Variance that noise on a measured input adds to the residuals, initial states projected out.

    Args:
        problem: Windows of a record, and the noise of its outputs.
        point: Parameters and states of the model.
        residuals: (N·c,) those at ``point``.

    Returns:
        (c,) mean squares in units of the variance of each channel's noise.
    """
    changes, channels = responses_to_input_noise(problem, point), len(problem.sigma)
    if not changes.size:
        return np.zeros(channels)
    lin = Linearised(residuals, np.empty((len(residuals), 0)), problem.state_slopes(point, residuals))
    remaining = problem.project(lin, changes).reshape(-1, channels, changes.shape[1])
    return np.asarray(np.mean(remaining**2, axis=(0, 2)))


def _with_more_noise(record: Record, draws: int) -> Iterator[Record]:
    """The record with further noise on its measured input, drawn anew each time."""
    random = np.random.default_rng(0)
    for _ in range(draws):
        inputs = record.inputs.copy()
        for begin, (first, last) in zip(record.begins, record.spans, strict=True):
            if begin.input_smoothing is not None:
                inputs[first:last, 0] += begin.input_smoothing.error(inputs[first:last, 0], random)
        yield replace(record, inputs=inputs)
