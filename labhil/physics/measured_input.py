"""Removal of white sensor noise from measured inputs.

A model whose input is measured simulates the noise of that measurement as if it had acted on the plant, which
biases estimates (errors in variables). Where the noise is white, a zero-phase smoother
(``physics.smoothing``) removes most of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labhil.physics.record import Record
from labhil.physics.smoothing import WIDTHS, Smoothing
from labhil.signals import Hold

MEASURED_INPUTS = ("beam_angle", "coil_current")
"""Inputs that are sensor readings and not commands."""

THIRD_DIFFERENCE_VARIANCE = 20.0
"""Variance of third differences of white noise over that of the noise: 1 + 9 + 9 + 1."""

THIRD_DIFFERENCE_CORRELATION = -0.75
"""Correlation of neighbouring third differences of white noise: −15/20."""

MEDIAN_OF_ABSOLUTE_NORMAL = 0.6745
"""Median absolute value of normal noise over its standard deviation."""


def with_input_smoothing(record: Record) -> Record:
    """Estimate the smoothing of a measured input for each recording and store it in the record.

    The estimate needs the whole recording: in a part with little motion, sensor noise cannot be separated
    from the input itself.

    Args:
        record: The record.

    Returns:
        The record with ``Begin.input_smoothing``; unchanged where the input is a command.
    """
    if record.input_names[0] not in MEASURED_INPUTS:
        return record
    pairs = zip(record.begins, record.recordings(), strict=True)
    begins = (replace(begin, input_smoothing=smoothing_of(recording)) for begin, recording in pairs)
    return replace(record, begins=tuple(begins))


def smoothing_of(record: Record) -> Smoothing:
    """Smoothing of the first input of a single recording; of zero noise where it has no white noise."""
    (begin,) = record.begins
    return begin.input_smoothing or _estimate(record)


def _estimate(
    record: Record,
    *,
    min_samples: int = 300,
    max_noise_share: float = 0.5,
    max_jitter: float = 0.1,
    correlation_tolerance: float = 0.15,
) -> Smoothing:
    """Estimate white noise by the median of third differences; zero if the noise is not white.

    Args:
        record: A single recording.
        min_samples: Least number of samples that separate noise from the input.
        max_noise_share: Largest noise over the spread of the input; larger noise may drive the plant.
        max_jitter: Largest deviation of a sampling step from the median, in periods.
        correlation_tolerance: Largest deviation of the correlation of neighbouring third differences from
        that
            of white noise; a motion correlates them positively.
    """
    u = record.inputs[:, 0]
    if record.input_holds[0] is not Hold.LINEAR or len(u) < min_samples:
        return Smoothing(0.0)
    steps = np.diff(record.t)
    if np.any(np.abs(steps - np.median(steps)) > max_jitter * np.median(steps)):
        return Smoothing(0.0)
    third = np.diff(u, 3)
    noise = float(np.median(np.abs(third))) / MEDIAN_OF_ABSOLUTE_NORMAL / np.sqrt(THIRD_DIFFERENCE_VARIANCE)
    if not 0.0 < noise < max_noise_share * float(np.std(u)):
        return Smoothing(0.0)
    correlation = float(third[1:] @ third[:-1]) / float(third @ third)
    if abs(correlation - THIRD_DIFFERENCE_CORRELATION) > correlation_tolerance:
        return Smoothing(0.0)
    return Smoothing(noise)


def without_noise(record: Record) -> Record:
    """Smooth the measured input of each recording that has white noise on it."""
    if record.input_names[0] not in MEASURED_INPUTS:
        return record
    record = with_input_smoothing(record)
    inputs = record.inputs.copy()
    for begin, (first, last) in zip(record.begins, record.spans, strict=True):
        if begin.input_smoothing is not None:
            inputs[first:last, 0] = begin.input_smoothing.of(inputs[first:last, 0])
    return replace(record, inputs=inputs)


def smoothing_notes(record: Record, unit: str) -> list[str]:
    """Notes for the user on smoothed inputs, one for each recording; ``unit`` is that of the input."""
    if record.input_names[0] not in MEASURED_INPUTS:
        return []
    noisy = [
        (recording, smoothing)
        for recording in record.recordings()
        if (smoothing := smoothing_of(recording)).noise
    ]
    return list(
        dict.fromkeys(
            f"{record.input_names[0]} is measured with white noise of {smoothing.noise:.2g} {unit}; the "
            f"model is driven by it smoothed over up to {WIDTHS[-1]} samples (local cubics), which leaves "
            f"{smoothing.remaining_noise(recording.inputs[:, 0]):.2g} {unit}."
            for recording, smoothing in noisy
        )
    )
