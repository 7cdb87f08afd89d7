"""The way of a command to what it drives, exact at every bend: delay, backlash, dead zone, saturation, rate.

Commands are knots, held or joined by straight lines; so is what becomes of them, up to the next bend. Each
stage answers with the value now, its slope, and for how long that slope lasts. A lag comes behind all of
them; it is one of the states that the integrator solves.
"""

from __future__ import annotations

import math

from labhil.compiled import compiled
from labhil.plants.input_path import InputPath
from labhil.signals import FloatArray, IntArray

HISTORY = 1024
"""How many past commands are remembered for the delay."""
NEWEST, CURRENT = range(2)
"""Places of the counters: of the newest command, and of the one in effect."""
PLAY, LIMITED = range(2)
"""Places of what the way in remembers: where the play stands, and where the rate limit."""
PLAY_TOLERANCE = 1e-9
"""Share of a width within which a part of a play counts as touching."""

Segment = tuple[float, float, float]
"""A value now, its slope per second, and how long (s) the slope lasts."""


@compiled
def add_command(times: FloatArray, values: FloatArray, counters: IntArray, t: float, value: float) -> None:
    """Remember a command of ``value`` at t (s)."""
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
    """The command in effect at t (s) after its delay; knots within ``tolerance_s`` (s) ahead count as reached."""
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
    """What a play of full width ``gap`` lets through; ``memory`` keeps where it stands."""
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
    """The part of a command outside ``low`` … ``high`` (eq. 4.18 of the reference text)."""
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
    """A command that goes no further than ± ``limit``."""
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
    """A command that changes no faster than ``rate`` per second; ``memory`` keeps where it stands."""
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
    """A delayed command behind everything that has no state of its own."""
    segment = apply_backlash(memory, segment, p.gap)
    segment = apply_dead_zone(segment, -p.left, p.right)
    segment = apply_saturation(segment, p.limit)
    return limit_rate(memory, segment, p.rate)
