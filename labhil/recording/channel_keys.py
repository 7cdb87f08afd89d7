"""What the keys ``hold``, ``unwrap`` and ``shift`` of a rig file's [channels] make of a table's columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labhil.rig_sections import Channel
from labhil.signals import FloatArray, Hold, Signal, Stream


def with_declared_hold(signal: Signal, channel: Channel | None) -> Signal:
    """The signal with the hold that its channel states."""
    return signal if channel is None or channel.hold is None else replace(signal, hold=channel.hold)


def apply_channel_keys(
    stream: Stream, channels: Mapping[str, Channel], t: FloatArray, values: FloatArray
) -> tuple[FloatArray, tuple[str, ...]]:
    """Unwrap and shift the columns of a stream as its channels state.

    Args:
        stream: The signals of the columns.
        channels: Entries of ``[channels]`` by signal.
        t: Times of the rows, increasing, (n,) s.
        values: Samples, (n, columns), in the signals' units.

    Returns:
        The samples (n, columns), and a line about each key that was applied. Where a shifted channel has no
        sample for a row at an end of the table, its nearest one stands there.
    """
    adjusted, notes = values, list[str]()
    for signal in stream.signals:
        channel = channels.get(signal.name)
        if channel is None or (channel.unwrap is None and channel.shift == 0.0):
            continue
        adjusted = adjusted.copy()
        columns = adjusted[:, stream.columns_of(signal.name)]
        if channel.unwrap is not None:
            columns[:] = np.unwrap(columns, period=channel.unwrap, axis=0)
            notes.append(f"{signal.name}: unwrapped, period {channel.unwrap:.7g} {signal.unit}")
        if channel.shift:
            columns[:] = np.column_stack([_at(t, t + channel.shift, x, signal.hold) for x in columns.T])
            notes.append(f"{signal.name}: stamps shifted by {channel.shift:+.6g} s")
    return adjusted, tuple(notes)


def _at(t: FloatArray, stamps: FloatArray, x: FloatArray, hold: Hold) -> FloatArray:
    """A channel (n,) with these stamps at the times ``t`` (n,)."""
    if hold is Hold.LINEAR:
        return np.interp(t, stamps, x)
    # stamps that were shifted by a whole number of samples meet the rows' times but for rounding
    slack = 1e-6 * float(np.median(np.diff(t)))
    rows = np.searchsorted(stamps, t + slack, side="right") - 1
    return np.asarray(x[np.maximum(rows, 0)])
