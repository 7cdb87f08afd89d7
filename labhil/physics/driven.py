"""The recorded input behind the effects of the input path, cached per record.

The effects themselves (backlash, dead zone, saturation, rate limit, lag) are in ``physics.input_path``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labhil.physics import input_path
from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray, Hold

INPUT_PATH_PARAMETERS = (
    "backlash.gap",
    "dead_zone.left",
    "dead_zone.right",
    "saturation.inverse_limit",
    "rate_limit.inverse_rate",
    "actuator_lag.time_constant",
    "time_delay.delay",
)
SENSOR_LAG = "sensor_lag.time_constant"
"""Key of the lag of the first output's sensor."""

Value = Callable[[str], float]
Lag = Callable[[FloatArray, FloatArray, float], input_path.Nodes]


def lag_in_fitted_lines(t: FloatArray, u: FloatArray, time_constant: float) -> input_path.Nodes:
    """First-order lag as two least-squares lines per stretch: exact in the mean, with small jumps."""
    return input_path.lag_in_lines(t, u, time_constant, parts=2)


def lag_without_jumps(t: FloatArray, u: FloatArray, time_constant: float) -> input_path.Nodes:
    """First-order lag, exact at six nodes per stretch, for a rig that feels the rate and its square."""
    t, u = input_path.refine_for_decay(t, u, time_constant, 6)
    return t, input_path.first_order_lag(t, u, time_constant)


class InputPath:
    """Cache of inputs behind backlash, dead zone, saturation, rate limit, lag and delay.

    Most simulations of a fit differ in friction or in initial states only, so the last ``size`` are kept.
    """

    def __init__(self, size: int = 32, lag: Lag = lag_in_fitted_lines) -> None:
        self._size = size
        self._lag = lag
        self._remembered: dict[tuple[float, ...], tuple[Record, input_path.Nodes]] = {}

    def nodes(self, record: Record, column: int, value: Value) -> input_path.Nodes:
        """Node times and values (m,) of input ``column``; ``value`` gives a parameter by name, else 0."""
        key = (id(record), column, *(value(name) for name in INPUT_PATH_PARAMETERS))
        entry = self._remembered.get(key)
        if entry is None or entry[0] is not record:
            entry = (record, effective_input(record, column, value, self._lag))
            if len(self._remembered) >= self._size:
                self._remembered.clear()
            self._remembered[key] = entry
        return entry[1]

    def at_samples(self, record: Record, windows: Windows, value: Value) -> FloatArray:
        """Values of the first input behind these effects at the samples of windows, (N,)."""
        nodes, values = self.nodes(record, 0, value)
        return np.interp(record.t[windows.rows], nodes, values)


def effective_input(
    record: Record, column: int, value: Value, lag: Lag = lag_in_fitted_lines
) -> input_path.Nodes:
    """Apply the effects of the input path to input ``column`` over the whole record.

    Args:
        record: The record.
        column: Column of its inputs.
        value: Gives a parameter by name, 0 where the term is absent.
        lag: How a first-order lag is made piecewise linear.

    Returns:
        Node times and values, (m,) each, linear in between.
    """
    t, u = input_nodes(record, column)
    gap, left, right = value("backlash.gap"), value("dead_zone.left"), value("dead_zone.right")
    inverse_limit, inverse_rate = value("saturation.inverse_limit"), value("rate_limit.inverse_rate")
    time_constant = value("actuator_lag.time_constant")
    t, u = input_path.backlash(t, u, gap) if gap else (t, u)
    t, u = input_path.dead_zone(t, u, left, right) if left or right else (t, u)
    t, u = input_path.saturation(t, u, inverse_limit) if inverse_limit else (t, u)
    t, u = input_path.rate_limit(t, u, inverse_rate) if inverse_rate else (t, u)
    t, u = lag(t, u, time_constant) if time_constant else (t, u)
    return t + value("time_delay.delay"), u


def input_nodes(record: Record, column: int) -> input_path.Nodes:
    """The recorded input ``column`` as nodes; a held input has two nodes at each jump."""
    t, u = record.t, np.ascontiguousarray(record.inputs[:, column])
    if record.input_holds[column] is Hold.ZERO:
        return np.repeat(t, 2)[1:], np.repeat(u, 2)[:-1]
    return t, u


def apply_sensor_lag(
    record: Record, windows: Windows, values: FloatArray, time_constant: float
) -> FloatArray:
    """Apply the first-order lag of a sensor to an output (N,); each window begins as after a steady ramp."""
    return input_path.sensor_lag(record.t[windows.rows], values, windows.owner, time_constant)
