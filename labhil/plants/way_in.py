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
ENOUGH = 1e-9
"""Share of a width within which a part of a play counts as touching."""

Course = tuple[float, float, float]
"""A value now, its slope per second, and how long (s) the slope lasts."""


@compiled
def add(times: FloatArray, values: FloatArray, count: IntArray, t: float, value: float) -> None:
    """Remember a command of ``value`` at t (s)."""
    count[NEWEST] += 1
    times[count[NEWEST] % HISTORY] = t
    values[count[NEWEST] % HISTORY] = value


@compiled
def command(
    times: FloatArray, values: FloatArray, count: IntArray, t: float, delay: float, near: float, held: bool
) -> Course:
    """The command in effect at t (s) after its delay; knots within ``near`` (s) ahead count as reached."""
    while count[CURRENT] < count[NEWEST] and times[(count[CURRENT] + 1) % HISTORY] + delay <= t + near:
        count[CURRENT] += 1
    current = count[CURRENT] % HISTORY
    if count[CURRENT] == count[NEWEST]:
        return values[current], 0.0, math.inf
    ahead = (count[CURRENT] + 1) % HISTORY
    remaining = times[ahead] + delay - t
    if held or times[ahead] == times[current]:
        return values[current], 0.0, remaining
    if t - delay < times[current]:
        return values[current], 0.0, times[current] + delay - t
    slope = (values[ahead] - values[current]) / (times[ahead] - times[current])
    return values[ahead] - slope * remaining, slope, remaining


@compiled
def behind_play(memory: FloatArray, course: Course, gap: float) -> Course:
    """What a play of full width ``gap`` lets through; ``memory`` keeps where it stands."""
    value, slope, remaining = course
    half = 0.5 * gap
    memory[PLAY] = min(max(memory[PLAY], value - half), value + half)
    if gap == 0.0 or slope == 0.0:
        return memory[PLAY], slope if gap == 0.0 else 0.0, remaining
    room = memory[PLAY] - value + half if slope > 0.0 else value + half - memory[PLAY]
    if room <= ENOUGH * gap:
        return memory[PLAY], slope, remaining
    return memory[PLAY], 0.0, min(remaining, room / abs(slope))


@compiled
def behind_dead_zone(course: Course, low: float, high: float) -> Course:
    """The part of a command outside ``low`` … ``high`` (eq. 4.18 of the reference text)."""
    value, slope, remaining = course
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
def clip(course: Course, limit: float) -> Course:
    """A command that goes no further than ± ``limit``."""
    value, slope, remaining = course
    side = 1.0 if value > 0.0 else -1.0
    if abs(value) > limit or (abs(value) == limit and slope * side > 0.0):
        returns = (abs(value) - limit) / abs(slope) if slope * side < 0.0 else math.inf
        return side * limit, 0.0, min(remaining, returns)
    if slope != 0.0:
        edge = limit if slope > 0.0 else -limit
        remaining = min(remaining, (edge - value) / slope)
    return value, slope, remaining


@compiled
def limit_rate(memory: FloatArray, course: Course, rate: float) -> Course:
    """A command that changes no faster than ``rate`` per second; ``memory`` keeps where it stands."""
    value, slope, remaining = course
    if rate == math.inf:
        memory[LIMITED] = value
        return course
    behind = value - memory[LIMITED]
    if abs(behind) <= ENOUGH * rate * min(remaining, 1.0):
        memory[LIMITED] = value
        return value, min(max(slope, -rate), rate), remaining
    side = 1.0 if behind > 0.0 else -1.0
    closing = rate - side * slope
    return memory[LIMITED], side * rate, min(remaining, abs(behind) / closing) if closing > 0.0 else remaining


@compiled
def through(memory: FloatArray, course: Course, p: InputPath) -> Course:
    """A delayed command behind everything that has no state of its own."""
    course = behind_play(memory, course, p.gap)
    course = behind_dead_zone(course, -p.left, p.right)
    course = clip(course, p.limit)
    return limit_rate(memory, course, p.rate)
