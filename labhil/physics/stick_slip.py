"""The motion of one part with dry friction and stops: rest is an event.

Its physics are functions (:class:`physics.moving_part.Laws`), from which :func:`integrator` makes what a
kernel calls. Below break-away the part holds still; the moments of coming to rest, of breaking away and of
meeting a stop are solved for within a step, so nothing depends on how they fall between samples.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labhil.compiled import inlined, merged, specialised
from labhil.physics.bracket import Bracket, crossing, narrow
from labhil.physics.moving_part import Course, Follows, Laws, Motion, Part, Step, Stops, stepper
from labhil.signals import FloatArray, IntArray

INSTANT = 1e-12
"""Times closer than this (s) are one."""

AT_ONCE = 1e6
"""Rate times the length of a stretch above which the following quantity is simply there."""

SWIFT = 3.0
"""Time constants of damping in the rest of a stretch from which on a part may count as creeping."""

BALANCED = 0.1
"""Share of itself by which the damping of a creeping part may change on its way to the balance."""

FINEST = 0.02
"""Shortest step that any law but a following quantity may ask for, as a share of the sampling period."""

MOST_STEPS = 500
"""Steps in one straight stretch of the input beyond which a simulation counts as run away.

Values that no part has (a winding whose current turns a rotor over many times between two samples) would
otherwise be followed through events without end.
"""

ITERATIONS = 80

Event = Callable[[Motion, float, float, float, float, Follows, float, Part], float]
"""(state, side, u, rise, h, how a follows, stop, part) to a moment within h, s."""

Stage = Callable[
    [Motion, float, float, float, float, float, Follows, Stops, Part], tuple[Motion, float, float]
]
"""(state, side, u, rise, h, finest, how a follows, stops, part) to new state, side and time taken."""


def leaver(laws: Laws[Part, Course], step: Step[Part]) -> Event[Part]:
    """Compile the moment when a resting part leaves towards ``side``, as it has at the end."""
    grip = laws.grip

    @specialised
    def excess(s: Motion, u: float, side: float, part: Part) -> float:
        pull, level = grip(s, u, part)
        return side * pull - level

    @specialised
    def time_to_leave(
        s: Motion, side: float, u: float, rise: float, h: float, how: Follows, stop: float, part: Part
    ) -> float:
        f_low = excess(s, u, side, part)
        if f_low >= 0.0:
            return 0.0
        f_high = excess(step(s, 0.0, u, rise, h, how, part), u + h * rise, side, part)
        between = Bracket(0.0, f_low, h, f_high, 0.0)
        close = 1e-14 * (abs(f_low) + abs(f_high))
        for _ in range(ITERATIONS):
            if between.high - between.low < INSTANT:
                break
            middle = crossing(between)
            f = excess(step(s, 0.0, u, rise, middle, how, part), u + middle * rise, side, part)
            if abs(f) <= close:
                return min(middle + INSTANT, h)
            between = narrow(between, middle, f)
        return between.high

    return time_to_leave


def finder(step: Step[Part]) -> Event[Part]:
    """Compile the moment when a part stands still, or with a finite ``stop`` meets that."""

    @specialised
    def time_to_event(
        s: Motion, side: float, u: float, rise: float, h: float, how: Follows, stop: float, part: Part
    ) -> float:
        meets = np.isfinite(stop)
        later = step(s, side, u, rise, h, how, part)
        f_low = (stop - s.x) * side if meets else s.v * side
        f_high = (stop - later.x) * side if meets else later.v * side
        between = Bracket(0.0, f_low, h, f_high, 0.0)
        close = 1e-14 * (abs(f_low) + abs(f_high))
        for _ in range(ITERATIONS):
            if between.high - between.low < INSTANT or f_high == f_low:
                break
            middle = crossing(between)
            reached = step(s, side, u, rise, middle, how, part)
            f = (stop - reached.x) * side if meets else reached.v * side
            if abs(f) <= close:
                return middle
            between = narrow(between, middle, f)
        return 0.5 * (between.low + between.high)

    return time_to_event


def rester(laws: Laws[Part, Course], step: Step[Part]) -> Stage[Part]:
    """Compile a rest of h s, or until the part is torn away."""
    grip = laws.grip
    time_to_leave = leaver(laws, step)

    @merged
    def rest(
        s: Motion, side: float, u: float, rise: float, h: float, finest: float, how: Follows, stops: Stops,
        part: Part,
    ) -> tuple[Motion, float, float]:  # fmt: skip
        later = step(s, 0.0, u, rise, h, how, part)
        towards = break_away_side(later.x, grip(later, u + h * rise, part), stops)
        if towards == 0.0:
            return later, 0.0, h
        taken = time_to_leave(s, towards, u, rise, h, how, np.inf, part)
        return step(s, 0.0, u, rise, taken, how, part), towards, taken

    return rest


def mover(laws: Laws[Part, Course], step: Step[Part]) -> Stage[Part]:
    """Compile a motion of h s, or until the part stands still or meets a stop."""
    grip = laws.grip
    time_to_event = finder(step)

    @merged
    def move(
        s: Motion, side: float, u: float, rise: float, h: float, finest: float, how: Follows, stops: Stops,
        part: Part,
    ) -> tuple[Motion, float, float]:  # fmt: skip
        later = step(s, side, u, rise, h, how, part)
        while s.v == 0.0 and later.v * side <= 0.0:
            # what tore it away recedes within this step: look closer, and rest if that is no motion
            if h <= finest:
                return step(s, 0.0, u, rise, h, how, part), 0.0, h
            h *= 0.25
            later = step(s, side, u, rise, h, how, part)
        edge = stops.high if side > 0.0 else stops.low
        if later.v * side <= 0.0:
            h = time_to_event(s, side, u, rise, h, how, np.inf, part)
            later = step(s, side, u, rise, h, how, part)
            if (edge - later.x) * side >= 0.0:
                return Motion(later.x, 0.0, later.a), 0.0, h
        if (edge - later.x) * side >= 0.0:
            return later, side, h
        h = time_to_event(s, side, u, rise, h, how, edge, part)
        later = step(s, side, u, rise, h, how, part)
        back = -stops.restitution * later.v
        pull, _ = grip(Motion(edge, 0.0, later.a), u + h * rise, part)
        if back == 0.0 or 2.0 * abs(back) <= finest * pull * side:
            return Motion(edge, 0.0, later.a), 0.0, h
        return Motion(edge, back, later.a), -side, h

    return move


@inlined
def break_away_side(x: float, grip: tuple[float, float], stops: Stops) -> float:
    """The side towards which a resting part breaks away; 0 where it holds, or leans on a stop."""
    pull, level = grip
    if pull > level and x < stops.high:
        return 1.0
    if -pull > level and x > stops.low:
        return -1.0
    return 0.0


def advancer(laws: Laws[Part, Course]) -> Callable[..., tuple[Motion, float]]:
    """Compile a stretch of h s on which the input is straight, through all stops and starts.

    It gives NaN where that takes more than ``MOST_STEPS``.
    """
    follow, settled, grip, pace = laws.follow, laws.settled, laws.grip, laws.pace
    pull, damping = laws.pull, laws.damping
    step = stepper(laws)
    rest, move = rester(laws, step), mover(laws, step)

    @specialised
    def creep(s: Motion, side: float, u: float, remaining: float, part: Part) -> float:
        rate, bend = damping(s, side, part)
        if rate * remaining < SWIFT:
            return 0.0
        return rate if abs(pull(s, side, u, part)) * bend <= BALANCED * rate * rate else 0.0

    @merged
    def advance(
        s: Motion, side: float, u: float, rise: float, h: float, finest: float, stops: Stops, part: Part
    ) -> tuple[Motion, float]:
        t, steps = 0.0, 0
        while h - t > INSTANT:
            steps += 1
            if steps > MOST_STEPS:
                return Motion(np.nan, np.nan, np.nan), side
            now = u + t * rise
            how = follow(s, part)
            if how.rate * h > AT_ONCE:
                how = Follows(np.inf, how.gauge, how.bias, 0.0)
                s = Motion(s.x, s.v, settled(s, now, part))
            if side == 0.0:
                side = break_away_side(s.x, grip(s, now, part), stops)
            if side != 0.0:
                how = Follows(how.rate, how.gauge, how.bias, creep(s, side, now, h - t, part))
            size = min(h - t, pace(s, side, now, rise, t, how, finest, part))
            if side == 0.0:
                s, side, taken = rest(s, side, now, rise, size, finest, how, stops, part)
            else:
                s, side, taken = move(s, side, now, rise, size, finest, how, stops, part)
            t += taken
        return s, side

    return advance


@inlined
def stretch(node_t: FloatArray, values: FloatArray, node: int, now: float) -> tuple[float, float]:
    """Input at ``now`` and its rise per second in the stretch before ``node`` (0: before all)."""
    if node == 0:
        return values[0], 0.0
    if node == node_t.size:
        return values[node - 1], 0.0
    h = node_t[node] - node_t[node - 1]
    rise = (values[node] - values[node - 1]) / h if h > 0.0 else 0.0
    return values[node - 1] + rise * (now - node_t[node - 1]), rise


Run = Callable[
    [FloatArray, FloatArray, FloatArray, IntArray, IntArray, FloatArray, Stops, Part, Course, FloatArray],
    None,
]
"""(t, node_t, values, first, last, states, stops, part, course, out) to nothing.

``t`` (n,) are the times of the samples; the input is straight between ``node_t`` (m,) and its ``values``
(m,), jumps where two nodes share a moment, and keeps its first and last value before and after. Window w
covers the samples first[w] … last[w] − 1 and begins with states[w] = (x, v, a); ``out`` (rows of all
windows after each other, 3) gets x, v, a. What runs away to infinity stays where it was last a number.
"""


def integrator(laws: Laws[Part, Course]) -> Run[Part, Course]:
    """Compile the simulation of windows of a recording for a kernel of these laws, which calls it."""
    advance, at = advancer(laws), laws.at

    @merged
    def run(
        t: FloatArray, node_t: FloatArray, values: FloatArray, first: IntArray, last: IntArray,
        states: FloatArray, stops: Stops, part: Part, course: Course, out: FloatArray,
    ) -> None:  # fmt: skip
        finest = FINEST * (t[-1] - t[0]) / max(t.size - 1, 1)
        row = 0
        for w in range(first.size):
            now = t[first[w]]
            node = np.searchsorted(node_t, now, side="right")
            s = Motion(min(max(states[w, 0], stops.low), stops.high), states[w, 1], states[w, 2])
            side, lost = np.sign(s.v), False
            for k in range(first[w], last[w]):
                out[row, 0], out[row, 1], out[row, 2] = s.x, s.v, s.a
                row += 1
                if lost or k == last[w] - 1:
                    continue
                part_here, before = at(part, course, k), s
                while now < t[k + 1]:
                    until = min(t[k + 1], node_t[node]) if node < node_t.size else t[k + 1]
                    if until > now:
                        u, rise = stretch(node_t, values, node, now)
                        s, side = advance(s, side, u, rise, until - now, finest, stops, part_here)
                        now = until
                    while node < node_t.size and node_t[node] <= now:
                        node += 1
                lost = not np.isfinite(s.x + s.v + s.a)
                s = before if lost else s

    return run
