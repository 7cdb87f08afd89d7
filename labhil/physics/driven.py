"""The way of a recorded input through the effects before the mechanism, remembered per record."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labhil.physics import input_path
from labhil.physics.model import Record, Windows
from labhil.signals import FloatArray, Hold

WAY_IN = (
    "backlash.gap",
    "dead_zone.left",
    "dead_zone.right",
    "saturation.inverse_limit",
    "rate_limit.inverse_rate",
    "actuator_lag.time_constant",
    "time_delay.delay",
)
REMEMBERED = 32
LAG_PARTS = 2
"""Into how many straight lines a stretch is cut behind a lag."""

Value = Callable[[str], float]


class DrivenPath:
    """Nodes of an input behind backlash, dead zone, saturation, rate limit, lag and delay.

    Most simulations of a fit differ in friction or in initial states only, so the last few are kept.
    """

    def __init__(self) -> None:
        self._remembered: dict[tuple[float, ...], tuple[Record, input_path.Nodes]] = {}

    def nodes(self, record: Record, column: int, value: Value) -> input_path.Nodes:
        """Times and values (m,) of input ``column``; ``value`` gives a parameter by name, 0 if absent."""
        key = (id(record), column, *(value(name) for name in WAY_IN))
        entry = self._remembered.get(key)
        if entry is None or entry[0] is not record:
            entry = (record, effective(record, column, value))
            if len(self._remembered) >= REMEMBERED:
                self._remembered.clear()
            self._remembered[key] = entry
        return entry[1]

    def at_samples(self, record: Record, windows: Windows, value: Value) -> FloatArray:
        """The first input behind these effects at the samples of windows, (N,)."""
        nodes, values = self.nodes(record, 0, value)
        return np.interp(record.t[windows.rows], nodes, values)


def effective(record: Record, column: int, value: Value) -> input_path.Nodes:
    """The way in, walked once through the whole record."""
    t, u = nodes_of(record, column)
    gap, left, right = value("backlash.gap"), value("dead_zone.left"), value("dead_zone.right")
    inverse_limit, inverse_rate = value("saturation.inverse_limit"), value("rate_limit.inverse_rate")
    time_constant = value("actuator_lag.time_constant")
    t, u = input_path.backlash(t, u, gap) if gap else (t, u)
    t, u = input_path.dead_zone(t, u, left, right) if left or right else (t, u)
    t, u = input_path.saturation(t, u, inverse_limit) if inverse_limit else (t, u)
    t, u = input_path.rate_limit(t, u, inverse_rate) if inverse_rate else (t, u)
    if time_constant:
        t, u = input_path.lag_in_lines(t, u, time_constant, LAG_PARTS)
    return t + value("time_delay.delay"), u


def nodes_of(record: Record, column: int) -> input_path.Nodes:
    """Input ``column`` as it was recorded, at nodes; one that is held jumps at a node that is there twice."""
    t, u = record.t, np.ascontiguousarray(record.inputs[:, column])
    if record.input_holds[column] is Hold.ZERO:
        return np.repeat(t, 2)[1:], np.repeat(u, 2)[:-1]
    return t, u


def lagged(record: Record, windows: Windows, values: FloatArray, time_constant: float) -> FloatArray:
    """An output (N,) behind a sensor's first-order lag, which every window finds as after a steady slope."""
    return input_path.sensor_lag(record.t[windows.rows], values, windows.owner, time_constant)
