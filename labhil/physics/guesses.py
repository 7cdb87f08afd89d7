"""Initial states and characteristic scales of a recording, estimated before a fit."""

from __future__ import annotations

import numpy as np

from labhil.compiled import compiled
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale
from labhil.signals import FloatArray, IntArray


def states_from_line_fit(record: Record, windows: Windows, span: float) -> FloatArray:
    """Estimate position and velocity at the start of each window by a line fit to the first output.

    Args:
        record: The record.
        windows: The windows.
        span: Time span of the fit, s; at least four samples are used.

    Returns:
        Initial states, (w, 2).
    """
    states = np.zeros((len(windows), 2))
    stops = np.minimum(windows.first + max(4, int(span / record.period)), windows.last)
    _fit_lines(record.t, np.ascontiguousarray(record.outputs[:, 0]), windows.first, stops, states)
    return states


@compiled
def _fit_lines(t: FloatArray, x: FloatArray, first: IntArray, stop: IntArray, states: FloatArray) -> None:
    """Value at the first sample and slope of a least-squares line through each stretch of samples."""
    for w in range(first.size):
        count = stop[w] - first[w]
        if count < 2:
            continue
        mean_t, mean_x, across, along = 0.0, 0.0, 0.0, 0.0
        for k in range(first[w], stop[w]):
            mean_t += t[k] / count
            mean_x += x[k] / count
        for k in range(first[w], stop[w]):
            across += (t[k] - mean_t) * (x[k] - mean_x)
            along += (t[k] - mean_t) ** 2
        states[w, 1] = across / along if along > 0.0 else 0.0
        states[w, 0] = mean_x - states[w, 1] * (mean_t - t[first[w]])


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
