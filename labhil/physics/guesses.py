"""What a recording says of a model's states and sizes before anything is fitted."""

from __future__ import annotations

import numpy as np

from labhil.physics.model import Record, Windows
from labhil.physics.terms import CharacteristicScale
from labhil.signals import FloatArray


def straight_starts(record: Record, windows: Windows, span: float) -> FloatArray:
    """First output and its rate at the begin of each window, (W, 2).

    Of a straight line through ``span`` seconds, or through four samples where that is longer.
    """
    states = np.empty((len(windows), 2))
    count = max(4, int(span / record.period))
    for w, (first, last) in enumerate(zip(windows.first, windows.last, strict=True)):
        stop = min(first + count, last)
        t = record.t[first:stop] - record.t[first]
        slope, start = np.polyfit(t, record.outputs[first:stop, 0], 1) if stop - first > 1 else (0.0, 0.0)
        states[w] = start, slope
    return states


def yardsticks_of(record: Record, drive: float, speed: float) -> dict[CharacteristicScale, float]:
    """What starts are fractions of: the first input's size and rate, beside a typical drive and speed."""
    u = record.inputs[:, 0]
    rates = np.abs(np.diff(u)) / np.diff(record.t)
    return {
        CharacteristicScale.UNIT: 1.0,
        CharacteristicScale.INPUT: float(np.abs(u).max()) or 1.0,
        CharacteristicScale.INPUT_RATE: float(np.quantile(rates, 0.98)) or 1.0,
        CharacteristicScale.DRIVE: drive,
        CharacteristicScale.SPEED: speed,
    }
