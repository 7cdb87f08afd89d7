"""Input path of a plant, exact for piecewise linear inputs.

Its stages are delay, backlash, dead zone, saturation and rate limit.

Commands are held, or linear between samples. Each stage returns a segment: the value now, its slope, and for
how long that slope lasts. The lag comes last; it is a state of the integrator.
"""

from __future__ import annotations

import math

from labhil.compiled import compiled
from labhil.plants.input_path import InputPath
from labhil.signals import FloatArray, IntArray

HISTORY = 1024
"""Number of past commands in the buffer of the delay."""
NEWEST, CURRENT = range(2)
"""Indices of the counters: of the newest command, and of the one in effect."""
PLAY, LIMITED = range(2)
"""Indices of the memory: outputs of the backlash and of the rate limit."""
PLAY_TOLERANCE = 1e-9
"""Relative distance within which the sides of a backlash touch."""

Segment = tuple[float, float, float]
"""Value now, slope per second, and time (s) that the slope lasts."""


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
    if distance <= PLAY_TOLERANCE * gap:
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
