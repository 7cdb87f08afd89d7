"""What the noise of a measured input makes of a simulation (errors in variables).

A model that is driven by the reading of a sensor simulates that sensor's noise as if it had acted. Most of it
is smoothed away; what stays is as known in size as the noise is, and no model is to blame for it: floors hold
it beside the noise of the outputs. It is simulated: the same windows from the same states, driven by the
input with more of the same error (a parametric bootstrap).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from labhil.identify.problem import Linearised, Point, Problem
from labhil.physics.model import Record
from labhil.signals import FloatArray

DRAWS = 6
"""Of the noise: over many windows a mean square of so many is known to a few per cent."""


def responses_to_input_noise(problem: Problem, point: Point) -> FloatArray:
    """Changes of the residuals, in units of noise, by one more error of a measured input each.

    Args:
        problem: windows of a record, and the noise of its outputs.
        point: where the model stands.

    Returns:
        As many as are drawn, (N·c, D); D is 0 where no input is known to have noise.
    """
    record, theta, states = problem.record, problem.theta(point.z), point.states
    if not any(begin.input_smoothing and begin.input_smoothing.noise for begin in record.begins):
        return np.empty((len(problem.owner), 0))
    simulated = problem.model.simulate(theta, record, problem.windows, states)
    changes = [
        (
            (problem.model.simulate(theta, noisy_record, problem.windows, states) - simulated) / problem.noise
        ).ravel()
        for noisy_record in _with_more_noise(record)
    ]
    return np.column_stack(changes)


def variance_by_input_noise(problem: Problem, point: Point, residuals: FloatArray) -> FloatArray:
    """Mean square (c,) of these changes, over that of noise, beside states that are fitted to all samples."""
    changes, channels = responses_to_input_noise(problem, point), len(problem.sigma)
    if not changes.size:
        return np.zeros(channels)
    lin = Linearised(residuals, np.empty((len(residuals), 0)), problem.state_slopes(point, residuals))
    remaining = problem.project(lin, changes).reshape(-1, channels, changes.shape[1])
    return np.asarray(np.mean(remaining**2, axis=(0, 2)))


def _with_more_noise(record: Record) -> Iterator[Record]:
    """The record with one more error of its measured input, drawn anew each time."""
    random = np.random.default_rng(0)
    for _ in range(DRAWS):
        inputs = record.inputs.copy()
        for begin, (first, last) in zip(record.begins, record.spans, strict=True):
            if begin.input_smoothing is not None:
                inputs[first:last, 0] += begin.input_smoothing.error(inputs[first:last, 0], random)
        yield replace(record, inputs=inputs)
