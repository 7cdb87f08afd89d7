"""Clock drift between a rate channel and the derivative of its own position.

Only where a recording holds both does a shift in time between channels differ from physics. If the rate
channel lags by τ, then dx/dt − v = τ·dv/dt. The lag τ is estimated piece by piece, and a line through the
pieces is tested for a slope.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from labhil.physics.record import Record
from labhil.signals import FloatArray

RATE_OF_POSITION: Mapping[str, str] = {"position": "velocity", "angle": "speed", "actual_q": "actual_qd"}
"""Name of the rate that belongs to each position; a joint's number follows both names."""


@dataclass(frozen=True, slots=True)
class LagChange:
    """How the lag of a rate channel behind its position changes within a recording.

    Attributes:
        position: name of the position.
        rate: name of its rate.
        before: lag at the beginning in s.
        after: lag at the end in s.
        p_value: p value of a constant lag.
    """

    position: str
    rate: str
    before: float
    after: float
    p_value: float


def detect_lag_changes(record: Record) -> tuple[LagChange, ...]:
    """Find pairs of a position and its rate whose lag drifts or steps within a recording.

    Args:
        record: the recording; inputs, outputs and auxiliary channels may form pairs.

    Returns:
        One entry for each pair whose lag changes.
    """
    changes = [_lag_change(record, *pair) for pair in _position_rate_pairs(record)]
    return tuple(change for change in changes if change is not None)


def _columns(record: Record) -> dict[str, FloatArray]:
    """All channels of a recording by name."""
    columns = dict(zip(record.input_names, record.inputs.T, strict=True))
    columns.update(zip(record.output_names, record.outputs.T, strict=True))
    return {**columns, **record.auxiliary}


def _position_rate_pairs(record: Record) -> list[tuple[str, str]]:
    """Names of the positions that are recorded together with their rates."""
    columns = _columns(record)
    pairs = []
    for name in columns:
        stem, _, joint = name.rpartition("_")
        for position, rate in RATE_OF_POSITION.items():
            partner = rate if name == position else f"{rate}_{joint}" if stem == position else None
            if partner in columns:
                pairs.append((name, str(partner)))
    return pairs


def _lag_change(
    record: Record,
    position: str,
    rate: str,
    *,
    n_pieces: int = 12,
    alpha: float = 1e-6,
    min_change_in_periods: float = 0.5,
) -> LagChange | None:
    """The change of a rate's lag; None where it is not significant or below half a sample period.

    ``alpha`` is small because the errors of the lag are themselves estimated from few pieces.
    """
    columns = _columns(record)
    x, v, t = columns[position], columns[rate], record.t
    if len(t) < 50 * n_pieces or np.ptp(v) == 0.0 or np.any(np.diff(t) <= 0.0):
        return None
    mismatch, change = np.gradient(x, t) - v, np.gradient(v, t)
    pieces = [_lag(mismatch[part], change[part]) for part in np.array_split(np.arange(len(t)), n_pieces)]
    lags = np.array([lag for lag in pieces if lag is not None])
    if len(lags) < n_pieces - 3:
        return None
    line = stats.linregress(np.arange(len(lags)), lags)
    before, after = (float(line.intercept + line.slope * k) for k in (0, len(lags) - 1))
    if line.pvalue > alpha or abs(after - before) < min_change_in_periods * record.period:
        return None
    return LagChange(position, rate, before, after, float(line.pvalue))


def _lag(mismatch: FloatArray, change: FloatArray) -> float | None:
    """Lag τ (s) of one piece from dx/dt − v = τ·dv/dt by least squares; None where the rate is constant."""
    change = change - change.mean()
    power = float(change @ change)
    centred = mismatch - mismatch.mean()
    if power <= 0.0:
        return None
    return float(change @ centred) / power
