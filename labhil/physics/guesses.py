"""Initial states and characteristic scales of a recording, estimated before a fit."""

from __future__ import annotations

import numpy as np

from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale
from labhil.signals import FloatArray


def states_from_line_fit(record: Record, windows: Windows, span: float) -> FloatArray:
    """Estimate position and velocity at the start of each window by a line fit to the first output.

    Args:
        record: The record.
        windows: The windows.
        span: Time span of the fit, s; at least four samples are used.

    Returns:
        Initial states, (w, 2).
    """
    states = np.empty((len(windows), 2))
    count = max(4, int(span / record.period))
    for w, (first, last) in enumerate(zip(windows.first, windows.last, strict=True)):
        stop = min(first + count, last)
        t = record.t[first:stop] - record.t[first]
        slope, start = np.polyfit(t, record.outputs[first:stop, 0], 1) if stop - first > 1 else (0.0, 0.0)
        states[w] = start, slope
    return states


def characteristic_scales_of(record: Record, drive: float, speed: float) -> dict[CharacteristicScale, float]:
    """Characteristic scales: size and rate of the first input, and a given typical force and speed."""
    u = record.inputs[:, 0]
    rates = np.abs(np.diff(u)) / np.diff(record.t)
    return {
        CharacteristicScale.UNIT: 1.0,
        CharacteristicScale.INPUT: float(np.abs(u).max()) or 1.0,
        CharacteristicScale.INPUT_RATE: float(np.quantile(rates, 0.98)) or 1.0,
        CharacteristicScale.DRIVE: drive,
        CharacteristicScale.SPEED: speed,
    }
