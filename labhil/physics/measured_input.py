"""A measured input without the noise of its sensor: what was not there cannot push.

A model that is driven by a measured input simulates the noise of that measurement as if it had acted, and an
answer that follows is taken for what the model lacks (errors in variables). Where that noise is white, a
smoother of zero phase takes most of it away.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labhil.physics.model import Record
from labhil.physics.smoothing import WIDTHS, Smoothing
from labhil.signals import Hold

MEASURED_INPUTS = ("beam_angle", "coil_current")
"""Inputs that are no command but the reading of a sensor."""

DIFFERENCES = 20.0
"""Variance of third differences of white noise over its own."""

NEIGHBOURS, WHITE = -0.75, 0.15
"""Correlation of neighbours among these, and by how much it may differ: those of a motion go together."""

NORMAL = 0.6745
"""Median size of normal noise over its standard deviation."""

FEWEST = 300
"""Samples from which the noise of an input can be separated from what drives the plant."""

LARGEST = 0.5
"""Of the input's own spread, beyond which such noise is no sensor's: it may be what drives the plant."""

EVEN = 0.1
"""Share of the period by which samples may stand beside their beat."""


def with_input_smoothing(record: Record) -> Record:
    """A record with how its measured input is to be smoothed where each recording begins.

    That is a matter of whole recordings: a part in which hardly anything moves shows no difference between
    the noise of a sensor and what drives the plant.
    """
    if record.input_names[0] not in MEASURED_INPUTS:
        return record
    pairs = zip(record.begins, record.recordings(), strict=True)
    begins = (replace(begin, input_smoothing=smoothing_of(recording)) for begin, recording in pairs)
    return replace(record, begins=tuple(begins))


def smoothing_of(record: Record) -> Smoothing:
    """How to smooth the first input of one recording; none where there is no white noise on it."""
    (begin,) = record.begins
    return begin.input_smoothing or _estimate(record)


def _estimate(record: Record) -> Smoothing:
    u = record.inputs[:, 0]
    if record.input_holds[0] is not Hold.LINEAR or len(u) < FEWEST:
        return Smoothing(0.0)
    steps = np.diff(record.t)
    if np.any(np.abs(steps - np.median(steps)) > EVEN * np.median(steps)):
        return Smoothing(0.0)
    third = np.diff(u, 3)
    noise = float(np.median(np.abs(third))) / NORMAL / np.sqrt(DIFFERENCES)
    if not 0.0 < noise < LARGEST * float(np.std(u)):
        return Smoothing(0.0)
    if abs(float(third[1:] @ third[:-1]) / float(third @ third) - NEIGHBOURS) > WHITE:
        return Smoothing(0.0)
    return Smoothing(noise)


def without_noise(record: Record) -> Record:
    """A record whose measured input is smoothed, each recording by itself, where it has white noise."""
    if record.input_names[0] not in MEASURED_INPUTS:
        return record
    record = with_input_smoothing(record)
    inputs = record.inputs.copy()
    for begin, (first, last) in zip(record.begins, record.spans, strict=True):
        if begin.input_smoothing is not None:
            inputs[first:last, 0] = begin.input_smoothing.of(inputs[first:last, 0])
    return replace(record, inputs=inputs)


def smoothing_notes(record: Record, unit: str) -> list[str]:
    """What is done with a measured input that has white noise, for people; a line a recording."""
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
