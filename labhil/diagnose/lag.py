"""Clocks that part: a rate channel against the derivative of its own position, piece by piece.

Only where a recording holds both does a shift in time between channels differ from physics. If the rate
channel lags by τ, then dx/dt − v = τ·dv/dt.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from labhil.physics.model import Record
from labhil.signals import FloatArray

PAIRS: Mapping[str, str] = {"position": "velocity", "angle": "speed", "actual_q": "actual_qd"}
"""Positions and their rates, by signal name; a joint's number is carried along."""

PIECES = 12
CHANCE = 1e-6
"""p value under which the clocks part: the lag's errors are estimated from few pieces."""

NOTABLE = 0.5
"""Sample periods by which the lag must change over a recording to be worth saying."""


@dataclass(frozen=True, slots=True)
class Parting:
    """How a rate channel's lag behind its position changes: from ``before`` to ``after`` (s)."""

    position: str
    rate: str
    before: float
    after: float
    p_value: float


def partings(record: Record) -> tuple[Parting, ...]:
    """Pairs of position and rate whose lag drifts or steps within a record."""
    results = [_parting(record, *pair) for pair in _pairs(record)]
    return tuple(parting for parting in results if parting is not None)


def _columns(record: Record) -> dict[str, FloatArray]:
    named = dict(zip(record.input_names, record.inputs.T, strict=True))
    named.update(zip(record.output_names, record.outputs.T, strict=True))
    return {**named, **record.auxiliary}


def _pairs(record: Record) -> list[tuple[str, str]]:
    columns = _columns(record)
    pairs = []
    for name in columns:
        stem, _, joint = name.rpartition("_")
        for position, rate in PAIRS.items():
            partner = rate if name == position else f"{rate}_{joint}" if stem == position else None
            if partner in columns:
                pairs.append((name, str(partner)))
    return pairs


def _parting(record: Record, position: str, rate: str) -> Parting | None:
    columns = _columns(record)
    x, v, t = columns[position], columns[rate], record.t
    if len(t) < 50 * PIECES or np.ptp(v) == 0.0 or np.any(np.diff(t) <= 0.0):
        return None
    behind, change = np.gradient(x, t) - v, np.gradient(v, t)
    pieces = [_lag(behind[part], change[part]) for part in np.array_split(np.arange(len(t)), PIECES)]
    lags = np.array([lag for lag in pieces if lag is not None])
    if len(lags) < PIECES - 3:
        return None
    line = stats.linregress(np.arange(len(lags)), lags)
    before, after = (float(line.intercept + line.slope * k) for k in (0, len(lags) - 1))
    if line.pvalue > CHANCE or abs(after - before) < NOTABLE * record.period:
        return None
    return Parting(position, rate, before, after, float(line.pvalue))


def _lag(behind: FloatArray, change: FloatArray) -> float | None:
    """Lag (s) in one piece; None where the rate hardly changes."""
    change = change - change.mean()
    power = float(change @ change)
    centred = behind - behind.mean()
    if power <= 0.0:
        return None
    return float(change @ centred) / power


__all__ = ["Parting", "partings"]
