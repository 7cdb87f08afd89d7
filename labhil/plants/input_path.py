"""Input path of a plant, exact for piecewise linear inputs.

Order: time delay, backlash, dead zone, saturation, rate limit, lag. Commands are held, or linear between
samples. Each stage but the lag returns a segment: the value now, its slope, and for how long it lasts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from labhil.compiled import compiled
from labhil.signals import FloatArray, IntArray

HISTORY = 1024
"""Number of past commands in the buffer of the delay."""
MAX_DELAY_SAMPLES = HISTORY - 24
"""Longest delay in sample periods."""
TIME_TOLERANCE = 1e-9
"""Share of a sample period within which two instants are equal."""
NEWEST, CURRENT = range(2)
"""Indices of the counters: of the newest command, and of the one in effect."""
PLAY, LIMITED = range(2)
"""Indices of the memory: outputs of the backlash and of the rate limit."""
PLAY_TOLERANCE = 1e-9
"""Relative distance within which the sides of a backlash touch."""

Segment = tuple[float, float, float]
"""Value now, slope per second, and time (s) that the slope lasts."""


class InputPath(NamedTuple):
    """Parameters of all effects of the input path, SI; neutral where an effect is absent."""

    delay: float
    gap: float
    left: float
    right: float
    limit: float
    rate: float
    lag: float

    @classmethod
    def of(cls, values: Mapping[str, float]) -> InputPath:
        """Take them from the parameters of a plant."""
        return cls(
            delay=values.get("time_delay.delay", 0.0),
            gap=values.get("backlash.gap", 0.0),
            left=values.get("dead_zone.left", 0.0),
            right=values.get("dead_zone.right", 0.0),
            limit=values.get("saturation.limit", math.inf),
            rate=values.get("rate_limit.rate", math.inf),
            lag=values.get("actuator_lag.time_constant", 0.0),
        )


@compiled
def add_command(times: FloatArray, values: FloatArray, counters: IntArray, t: float, value: float) -> None:
    """Add a command of ``value`` at t (s) to the buffer."""
    counters[NEWEST] += 1
    times[counters[NEWEST] % HISTORY] = t
    values[counters[NEWEST] % HISTORY] = value


@compiled
def delayed_command(
    times: FloatArray,
    values: FloatArray,
    counters: IntArray,
    t: float,
    delay: float,
    tolerance_s: float,
    is_held: bool,
) -> Segment:
    """Return the delayed command at t (s); samples within ``tolerance_s`` after t count as reached."""
    while (
        counters[CURRENT] < counters[NEWEST]
        and times[(counters[CURRENT] + 1) % HISTORY] + delay <= t + tolerance_s
    ):
        counters[CURRENT] += 1
    current = counters[CURRENT] % HISTORY
    if counters[CURRENT] == counters[NEWEST]:
        return values[current], 0.0, math.inf
    following = (counters[CURRENT] + 1) % HISTORY
    remaining = times[following] + delay - t
    if is_held or times[following] == times[current]:
        return values[current], 0.0, remaining
    if t - delay < times[current]:
        return values[current], 0.0, times[current] + delay - t
    slope = (values[following] - values[current]) / (times[following] - times[current])
    return values[following] - slope * remaining, slope, remaining


@compiled
def apply_backlash(memory: FloatArray, segment: Segment, gap: float) -> Segment:
    """Apply a backlash of full width ``gap``; ``memory`` has its output."""
    value, slope, remaining = segment
    half = 0.5 * gap
    memory[PLAY] = min(max(memory[PLAY], value - half), value + half)
    if gap == 0.0 or slope == 0.0:
        return memory[PLAY], slope if gap == 0.0 else 0.0, remaining
    distance = memory[PLAY] - value + half if slope > 0.0 else value + half - memory[PLAY]
    if distance <= PLAY_TOLERANCE * max(gap, abs(value)):
        return memory[PLAY], slope, remaining
    return memory[PLAY], 0.0, min(remaining, distance / abs(slope))


@compiled
def apply_dead_zone(segment: Segment, low: float, high: float) -> Segment:
    """Apply a dead zone ``low`` … ``high`` (eq. 4.18 of the reference text)."""
    value, slope, remaining = segment
    if value > high or (value == high and slope > 0.0):
        return value - high, slope, min(remaining, (value - high) / -slope) if slope < 0.0 else remaining
    if value < low or (value == low and slope < 0.0):
        return value - low, slope, min(remaining, (low - value) / slope) if slope > 0.0 else remaining
    if slope > 0.0:
        remaining = min(remaining, (high - value) / slope)
    elif slope < 0.0:
        remaining = min(remaining, (low - value) / slope)
    return 0.0, 0.0, remaining


@compiled
def apply_saturation(segment: Segment, limit: float) -> Segment:
    """Limit a command to ± ``limit``."""
    value, slope, remaining = segment
    sign = 1.0 if value > 0.0 else -1.0
    if abs(value) > limit or (abs(value) == limit and slope * sign > 0.0):
        remaining_beyond = (abs(value) - limit) / abs(slope) if slope * sign < 0.0 else math.inf
        return sign * limit, 0.0, min(remaining, remaining_beyond)
    if slope != 0.0:
        edge = limit if slope > 0.0 else -limit
        remaining = min(remaining, (edge - value) / slope)
    return value, slope, remaining


@compiled
def limit_rate(memory: FloatArray, segment: Segment, rate: float) -> Segment:
    """Limit the change of a command to ``rate`` per second; ``memory`` has its output."""
    value, slope, remaining = segment
    if rate == math.inf:
        memory[LIMITED] = value
        return segment
    deviation = value - memory[LIMITED]
    if abs(deviation) <= PLAY_TOLERANCE * rate * min(remaining, 1.0):
        memory[LIMITED] = value
        return value, min(max(slope, -rate), rate), remaining
    sign = 1.0 if deviation > 0.0 else -1.0
    closing = rate - sign * slope
    return (
        memory[LIMITED],
        sign * rate,
        min(remaining, abs(deviation) / closing) if closing > 0.0 else remaining,
    )


@compiled
def pass_through(memory: FloatArray, segment: Segment, p: InputPath) -> Segment:
    """Pass a delayed command through all stages but the lag."""
    segment = apply_backlash(memory, segment, p.gap)
    segment = apply_dead_zone(segment, -p.left, p.right)
    segment = apply_saturation(segment, p.limit)
    return limit_rate(memory, segment, p.rate)


@compiled
def apply_lag(y: float, before: float, now: float, h: float, time_constant: float) -> float:
    """Return the lagged signal after h (s) in which its input went linearly from ``before`` to ``now``."""
    if time_constant <= 0.0:
        return now
    lag_error = (now - before) / h * time_constant
    return now - lag_error + (y - before + lag_error) * math.exp(-h / time_constant)
