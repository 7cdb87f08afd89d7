"""Keys ``hold``, ``unwrap`` and ``shift`` of ``[channels]``, applied to the columns of a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labhil.rig_sections import Channel
from labhil.signals import FloatArray, Hold, Signal, Stream


def with_declared_hold(signal: Signal, channel: Channel | None) -> Signal:
    """The signal with the hold of its channel, if that has one."""
    return signal if channel is None or channel.hold is None else replace(signal, hold=channel.hold)


def apply_channel_keys(
    stream: Stream, channels: Mapping[str, Channel], t: FloatArray, values: FloatArray
) -> tuple[FloatArray, tuple[str, ...]]:
    """Unwrap and shift the columns of a stream by the keys of its channels.

    Args:
        stream: the signals of the columns.
        channels: entries of ``[channels]`` by signal.
        t: times of the rows, increasing, (n,) s.
        values: samples (n, columns), in the signals' units.

    Returns:
        The samples (n, columns), and a line about each applied key. Beyond the ends of a shifted channel its
        nearest sample counts.
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
            columns[:] = np.column_stack(
                [_interpolate(t, t + channel.shift, x, signal.hold) for x in columns.T]
            )
            notes.append(f"{signal.name}: stamps shifted by {channel.shift:+.6g} s")
    return adjusted, tuple(notes)


def _interpolate(t: FloatArray, stamps: FloatArray, x: FloatArray, hold: Hold) -> FloatArray:
    """Values (n,) at times ``t`` (n,) of a channel ``x`` (n,) with stamps (n,)."""
    if hold is Hold.LINEAR:
        return np.interp(t, stamps, x)
    # stamps that were shifted by whole samples equal the rows' times except for rounding
    slack = 1e-6 * float(np.median(np.diff(t)))
    rows = np.searchsorted(stamps, t + slack, side="right") - 1
    return np.asarray(x[np.maximum(rows, 0)])
