"""Simulation of one moving part with dry friction and end stops by event detection.

:func:`compile_integrator` makes the simulation of a part from its laws (:class:`physics.moving_part.Laws`).
Below break-away the part is at rest. The instants of coming to rest, of break-away and of impact on a stop
are found within a step by root bracketing, so results do not depend on where these fall between samples.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labhil.compiled import inlined, merged, specialised
from labhil.physics.bracket import Bracket, false_position, narrow
from labhil.physics.bristles import SETTLED
from labhil.physics.moving_part import Course, Follows, Laws, Motion, Part, Step, Stops, compile_step
from labhil.signals import FloatArray, IntArray

TIME_TOLERANCE = 1e-12
"""Instants closer than this are one, s."""

INSTANT_RATE = 1e6
"""Rate times length of a stretch above which the lagging quantity takes its steady value at once."""

MIN_CREEP_TIME_CONSTANTS = 3.0
"""Least number of damping time constants in the rest of a stretch for a part that creeps."""

MAX_CREEP_DAMPING_CHANGE = 0.1
"""Largest relative change of the damping of a creeping part on its way to the balance."""

MIN_STEP_IN_PERIODS = 0.02
"""Shortest step that any law but a lag may ask for, in sampling periods."""

MAX_STEPS = 500
"""Largest number of steps in one straight stretch of the input; a simulation that needs more is stopped.

Parameters that no real part has (a current that reverses a rotor many times between two samples) would
otherwise cause an endless sequence of events.
"""

MAX_ROOT_STEPS = 80
"""Largest number of iterations for the instant of an event."""

Event = Callable[[Motion, float, float, float, float, Follows, float, Part], float]
"""(state, side, u, rise, h, lag, stop, part) to the instant of an event within h, s."""

Stage = Callable[
    [Motion, float, float, float, float, float, Follows, Stops, Part], tuple[Motion, float, float]
]
"""(state, side, u, rise, h, finest, lag, stops, part) to new state, side and elapsed time."""


def compile_break_away_time(laws: Laws[Part, Course], step: Step[Part]) -> Event[Part]:
    """Compile the instant of break-away towards ``side`` within a step that ends broken away."""
    pull_and_hold = laws.pull_and_hold

    @specialised
    def excess(s: Motion, u: float, side: float, part: Part) -> float:
        pull, level = pull_and_hold(s, u, part)
        return side * pull - level

    @specialised
    def time_to_break_away(
        s: Motion, side: float, u: float, rise: float, h: float, lag: Follows, stop: float, part: Part
    ) -> float:
        f_low = excess(s, u, side, part)
        if f_low >= 0.0:
            return 0.0
        f_high = excess(step(s, 0.0, u, rise, h, lag, part), u + h * rise, side, part)
        between = Bracket(0.0, f_low, h, f_high, 0.0)
        close = 1e-14 * (abs(f_low) + abs(f_high))
        for _ in range(MAX_ROOT_STEPS):
            if between.high - between.low < TIME_TOLERANCE:
                break
            middle = false_position(between)
            f = excess(step(s, 0.0, u, rise, middle, lag, part), u + middle * rise, side, part)
            if abs(f) <= close:
                return min(middle + TIME_TOLERANCE, h)
            between = narrow(between, middle, f)
        return between.high

    return time_to_break_away


def compile_event_time(step: Step[Part]) -> Event[Part]:
    """Compile the instant at which a part comes to rest, or with a finite ``stop`` reaches that stop."""

    @specialised
    def time_to_event(
        s: Motion, side: float, u: float, rise: float, h: float, lag: Follows, stop: float, part: Part
    ) -> float:
        meets = np.isfinite(stop)
        later = step(s, side, u, rise, h, lag, part)
        f_low = (stop - s.x) * side if meets else s.v * side
        f_high = (stop - later.x) * side if meets else later.v * side
        between = Bracket(0.0, f_low, h, f_high, 0.0)
        close = 1e-14 * (abs(f_low) + abs(f_high))
        for _ in range(MAX_ROOT_STEPS):
            if between.high - between.low < TIME_TOLERANCE or f_high == f_low:
                break
            middle = false_position(between)
            reached = step(s, side, u, rise, middle, lag, part)
            f = (stop - reached.x) * side if meets else reached.v * side
            if abs(f) <= close:
                return middle
            between = narrow(between, middle, f)
        return 0.5 * (between.low + between.high)

    return time_to_event


def compile_rest(laws: Laws[Part, Course], step: Step[Part]) -> Stage[Part]:
    """Compile rest for h s or until break-away."""
    pull_and_hold = laws.pull_and_hold
    time_to_break_away = compile_break_away_time(laws, step)

    @merged
    def rest(
        s: Motion, side: float, u: float, rise: float, h: float, finest: float, lag: Follows, stops: Stops,
        part: Part,
    ) -> tuple[Motion, float, float]:  # fmt: skip
        later = step(s, 0.0, u, rise, h, lag, part)
        towards = break_away_side(later.x, pull_and_hold(later, u + h * rise, part), stops)
        if towards == 0.0:
            return later, 0.0, h
        taken = time_to_break_away(s, towards, u, rise, h, lag, np.inf, part)
        if taken == 0.0:
            return s, towards, 0.0
        return step(s, 0.0, u, rise, taken, lag, part), towards, taken

    return rest


def compile_move(laws: Laws[Part, Course], step: Step[Part]) -> Stage[Part]:
    """Compile motion for h s or until the part comes to rest or reaches a stop."""
    pull_and_hold, bend_after = laws.pull_and_hold, laws.bend_after
    time_to_event = compile_event_time(step)

    @merged
    def move(
        s: Motion, side: float, u: float, rise: float, h: float, finest: float, lag: Follows, stops: Stops,
        part: Part,
    ) -> tuple[Motion, float, float]:  # fmt: skip
        later = step(s, side, u, rise, h, lag, part)
        while s.v == 0.0 and later.v * side <= 0.0:
            # the drive recedes within this step: shorten it, and rest if the part does not move then either
            if h <= finest:
                return step(s, 0.0, u, rise, h, lag, part), 0.0, h
            h *= 0.25
            later = step(s, side, u, rise, h, lag, part)
        edge = stops.high if side > 0.0 else stops.low
        if later.v * side <= 0.0:
            h = time_to_event(s, side, u, rise, h, lag, np.inf, part)
            later = step(s, side, u, rise, h, lag, part)
            if (edge - later.x) * side >= 0.0:
                return Motion(later.x, 0.0, later.a, later.bend), 0.0, h
        if (edge - later.x) * side >= 0.0:
            return later, side, h
        h = time_to_event(s, side, u, rise, h, lag, edge, part)
        later = step(s, side, u, rise, h, lag, part)
        back = -stops.restitution * later.v
        pull, _ = pull_and_hold(Motion(edge, 0.0, later.a, later.bend), u + h * rise, part)
        if back == 0.0 or 2.0 * abs(back) <= finest * pull * side:
            return Motion(edge, 0.0, later.a, later.bend), 0.0, h
        return Motion(edge, back, later.a, bend_after(later.bend, -side, 0.0, part)), -side, h

    return move


@inlined
def break_away_side(x: float, grip: tuple[float, float], stops: Stops) -> float:
    """Side towards which a part at rest breaks away; 0 if it holds or is against a stop."""
    pull, level = grip
    if pull > level and x < stops.high:
        return 1.0
    if -pull > level and x > stops.low:
        return -1.0
    return 0.0


def compile_advance(laws: Laws[Part, Course]) -> Callable[..., tuple[Motion, float]]:
    """Compile the motion over a stretch of h s with a linear input, through all events.

    The result is NaN where that takes more than ``MAX_STEPS`` steps.
    """
    follow, steady_value, pull_and_hold, max_step = (
        laws.follow,
        laws.steady_value,
        laws.pull_and_hold,
        laws.max_step,
    )
    acceleration, damping, bend_after = laws.acceleration, laws.damping, laws.bend_after
    step = compile_step(laws)
    rest, move = compile_rest(laws, step), compile_move(laws, step)

    @specialised
    def creep(s: Motion, side: float, u: float, remaining: float, part: Part) -> float:
        rate, curvature = damping(s, side, part)
        if rate * remaining < MIN_CREEP_TIME_CONSTANTS or abs(side - s.bend) > SETTLED:
            return 0.0
        return (
            rate
            if abs(acceleration(s, side, u, part)) * curvature <= MAX_CREEP_DAMPING_CHANGE * rate * rate
            else 0.0
        )

    @merged
    def advance(
        s: Motion, side: float, u: float, rise: float, h: float, finest: float, stops: Stops, part: Part
    ) -> tuple[Motion, float]:
        t, steps = 0.0, 0
        while h - t > TIME_TOLERANCE:
            steps += 1
            if steps > MAX_STEPS:
                return Motion(np.nan, np.nan, np.nan, side), side
            now = u + t * rise
            lag = follow(s, now, part)
            if lag.rate * h > INSTANT_RATE:
                lag = Follows(np.inf, lag.gauge, lag.bias, 0.0)
                s = Motion(s.x, s.v, steady_value(s, now, part), s.bend)
            if side == 0.0:
                side = break_away_side(s.x, pull_and_hold(s, now, part), stops)
                s = Motion(s.x, s.v, s.a, bend_after(s.bend, side, 0.0, part))
            if side != 0.0:
                lag = Follows(lag.rate, lag.gauge, lag.bias, creep(s, side, now, h - t, part))
            size = min(h - t, max_step(s, side, now, rise, t, lag, finest, part))
            if side == 0.0:
                s, side, taken = rest(s, side, now, rise, size, finest, lag, stops, part)
                s = Motion(s.x, s.v, s.a, bend_after(s.bend, side, 0.0, part))
            else:
                s, side, taken = move(s, side, now, rise, size, finest, lag, stops, part)
            t += taken
        return s, side

    return advance


@inlined
def stretch(node_t: FloatArray, values: FloatArray, node: int, now: float) -> tuple[float, float]:
    """Input at ``now`` and its slope per second in the stretch before ``node`` (0: before the first)."""
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

``t`` (n,) are the times of the samples, s. The input is linear between the nodes ``node_t`` (m,), s, with
``values`` (m,), jumps where two nodes have the same time, and is constant before the first and after the last
node. Window w covers the samples first[w] … last[w] − 1 and begins with states[w] = (x, v, a); ``out`` (N, 3)
receives x, v, a of all windows one after another. A simulation that diverges keeps its last finite state.
"""


def compile_integrator(laws: Laws[Part, Course]) -> Run[Part, Course]:
    """Compile the simulation of windows of a recording by these laws, to be called from a kernel."""
    advance, part_at, first_bend = compile_advance(laws), laws.part_at, laws.first_bend

    @merged
    def run(
        t: FloatArray, node_t: FloatArray, values: FloatArray, first: IntArray, last: IntArray,
        states: FloatArray, stops: Stops, part: Part, course: Course, out: FloatArray,
    ) -> None:  # fmt: skip
        finest = MIN_STEP_IN_PERIODS * (t[-1] - t[0]) / max(t.size - 1, 1)
        row = 0
        for w in range(first.size):
            now = t[first[w]]
            node = np.searchsorted(node_t, now, side="right")
            s = Motion(min(max(states[w, 0], stops.low), stops.high), states[w, 1], states[w, 2], 0.0)
            side, lost = np.sign(s.v), False
            part_here, (u, _) = part_at(part, course, first[w]), stretch(node_t, values, node, now)
            s = Motion(s.x, s.v, s.a, first_bend(s, u, part_here))
            for k in range(first[w], last[w]):
                out[row, 0], out[row, 1], out[row, 2] = s.x, s.v, s.a
                row += 1
                if lost or k == last[w] - 1:
                    continue
                part_here, before = part_at(part, course, k), s
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
