"""One moving part with dry friction: an integrator of fifth order that stops at every event, for any push.

The push is a compiled function of a rig: from the states, the input that acts and the rig's numbers it gives
the force without friction, the dry friction beyond that of the general law and what is left of viscous
friction, and the rates of the rig's own states. A part that moves feels the dry friction of its side, one
at rest whatever keeps it there. Coming to rest, breaking away and meeting a stop are located by bisection on
the step; so is the yielding of an element where elements carry the dry friction. Steps are those of Dormand
and Prince, as long as their estimated error allows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np

from labhil.compiled import compiled, specialised
from labhil.plants.friction import (
    Friction,
    bristle_force,
    bristle_level,
    bristle_rate,
    hold_level,
    on_bristles,
    resistance,
    side_of,
    viscous_force,
)
from labhil.plants.maxwell import (
    all_stick,
    elements_drag,
    held_force,
    let_slip,
    some_yield,
)
from labhil.signals import FloatArray

X, V, BRISTLE, LAG, SENSOR, INNER = range(6)
"""Places of the states: position, velocity, bristles, the lags of the way in and of the sensor, the rig's.

Elements, where there are some, come behind those of the rig.
"""
SIDE, PACE = range(2)
"""Places of the mode: the side towards which the part moves (0 at rest), and the next step's length, s."""
STAGES = 7
BISECTIONS = 50
SLOWEST_BOUNCE = 1e-4
"""Speed (unit/s) below which a part that meets a stop stays there."""
SHORTEST = 1e-13
"""Step (s) below which no error is too large."""
LEAST_DIP = 1e-9
"""Step (s) below which a velocity that dips under zero and comes back is not looked for."""
FLOOR = 1e-6
"""Size (SI) of a state below which its errors count as those of one of this size."""

TIMES = np.array([0.0, 1.0 / 5.0, 3.0 / 10.0, 4.0 / 5.0, 8.0 / 9.0, 1.0, 1.0])
WEIGHTS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1.0 / 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3.0 / 40.0, 9.0 / 40.0, 0.0, 0.0, 0.0, 0.0],
        [44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0, 0.0, 0.0, 0.0],
        [19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0, 0.0, 0.0],
        [9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0, 0.0],
        [35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0],
    ]
)
ERROR = np.array(
    [
        71.0 / 57600.0, 0.0, -71.0 / 16695.0, 71.0 / 1920.0, -17253.0 / 339200.0, 22.0 / 525.0, -1.0 / 40.0,
    ]
)  # fmt: skip
"""Dormand and Prince's pair of fifth and fourth order; the last stage stands at the step's end."""


class Body(NamedTuple):
    """Inertia, stops (infinite where there are none) with their restitution, and the lags' time constants.

    ``seen`` is the state that the sensor follows; a lag of 0 s is none. ``tolerance`` is the error of a step
    over the size of the state.
    """

    inertia: float
    low: float
    high: float
    restitution: float
    lag: float
    sensor_lag: float
    seen: int
    tolerance: float


class Work(NamedTuple):
    """Room for the stages (7, n), a step's end and the largest sizes so far (n,)."""

    stages: FloatArray
    end: FloatArray
    sizes: FloatArray


def push(s: FloatArray, u: float, m: Any, rates: FloatArray) -> tuple[float, float, float]:
    """Nothing pushes: the name under which :func:`mover_for` puts the push of a rig."""
    return 0.0, 0.0, 1.0


def remember(s: FloatArray, u: float, m: Any) -> None:
    """Nothing is remembered: the name under which :func:`mover_for` puts what a rig keeps of its past."""


@compiled
def acting(s: FloatArray, u: float, b: Body) -> float:
    """The input behind the lag of the way in."""
    return float(s[LAG]) if b.lag > 0.0 else u


def slopes(s: FloatArray, u: float, side: float, b: Body, m: Any, f: Friction, rates: FloatArray) -> None:
    """Rates of all states (n,) of a part that moves towards ``side``, or rests (0)."""
    force, more, thinned = push(s, acting(s, u, b), m, rates)
    x, v = s[X], s[V]
    rates[LAG] = (u - s[LAG]) / b.lag if b.lag > 0.0 else 0.0
    rates[SENSOR] = (s[b.seen] - s[SENSOR]) / b.sensor_lag if b.sensor_lag > 0.0 else 0.0
    rates[X], rates[V], rates[BRISTLE] = 0.0, 0.0, 0.0
    carried = elements_drag(s, x, v, side, more, f, rates) if f.attraction > 0.0 else 0.0
    if side == 0.0:
        return
    drag = (thinned - 1.0) * f.viscous * v
    if f.attraction > 0.0:
        drag += viscous_force(v, f) + carried
    elif f.stiffness > 0.0:
        level = bristle_level(x, v, side_of(v), f, more)
        rates[BRISTLE] = bristle_rate(s[BRISTLE], v, level, f)
        drag += viscous_force(v, f) + bristle_force(s[BRISTLE], v, level, f)
    else:
        drag += resistance(x, v, side, f, more)
    rates[X], rates[V] = v, (force - drag) / b.inertia


def leaves(s: FloatArray, u: float, b: Body, m: Any, f: Friction, rates: FloatArray) -> float:
    """The side towards which a part at rest is moved, 0 when it holds; stops hold too."""
    force, more, _ = push(s, acting(s, u, b), m, rates)
    x = s[X]
    if f.stiffness > 0.0:
        # what bends holds nothing by itself: such a part is at rest on a stop, or where all is balanced
        force -= held_force(s) if f.attraction > 0.0 else f.stiffness * s[BRISTLE]
        held = (x >= b.high and force >= 0.0) or (x <= b.low and force <= 0.0)
        if f.attraction > 0.0:
            return 0.0 if held else side_of(force)
        return 0.0 if held else 1.0
    if force > hold_level(x, 1.0, f, more) and x < b.high:
        return 1.0
    if -force > hold_level(x, -1.0, f, more) and x > b.low:
        return -1.0
    return 0.0


def attempt(
    s: FloatArray, u: float, rise: float, h: float, side: float,
    b: Body, m: Any, f: Friction, w: Work,
) -> None:  # fmt: skip
    """One step of h (s) from the states ``s`` to ``w.end``; the input starts at ``u``, slope ``rise``."""
    k, end = w.stages, w.end
    for stage in range(STAGES):
        for j in range(s.size):
            change = 0.0
            for i in range(stage):
                change += WEIGHTS[stage, i] * k[i, j]
            end[j] = s[j] + h * change
        slopes(end, u + TIMES[stage] * h * rise, side, b, m, f, k[stage])


@compiled
def error_of(h: float, b: Body, w: Work) -> float:
    """Estimated error of the step of h (s) that has just been made to ``w.end``, over what is allowed."""
    worst = 0.0
    for j in range(w.end.size):
        error = 0.0
        for i in range(STAGES):
            error += ERROR[i] * w.stages[i, j]
        worst = max(worst, abs(h * error) / max(w.sizes[j], abs(w.end[j])))
    return worst / b.tolerance


def has_happened(
    y: FloatArray, u: float, side: float, stops: bool, b: Body, m: Any, f: Friction, w: Work
) -> bool:
    """Whether a part at rest has left, or a moving one has turned back or has an element that yields.

    With ``stops``, whether a moving one has met a stop. ``y`` is the end of the last attempt.
    """
    if side == 0.0:
        return bool(leaves(y, u, b, m, f, w.stages[6]) != 0.0)
    if stops:
        return bool(y[X] > b.high or y[X] < b.low)
    if on_bristles(f):
        return False
    if f.attraction > 0.0 and some_yield(y, side, w.stages[6, y.size - 1]):
        return True
    return bool(y[V] * side < 0.0)


def time_to(
    s: FloatArray, u: float, rise: float, h: float, side: float, stops: bool,
    b: Body, m: Any, f: Friction, w: Work,
) -> float:  # fmt: skip
    """When within h (s) that first happened; ``w.end`` is then the step's end there."""
    low, high = 0.0, h
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        attempt(s, u, rise, middle, side, b, m, f, w)
        if has_happened(w.end, u + middle * rise, side, stops, b, m, f, w):
            high = middle
        else:
            low = middle
    attempt(s, u, rise, high, side, b, m, f, w)
    return high


def dips(s: FloatArray, h: float, side: float, f: Friction, w: Work) -> bool:
    """Whether the velocity may have passed zero and come back within the step of h (s)."""
    if on_bristles(f) or side == 0.0:
        return False
    before, after = w.stages[0, V] * side, w.stages[6, V] * side
    if before >= 0.0 or after <= 0.0 or h < LEAST_DIP:
        return False
    # a curve that bends upwards lies above the point where its first and last tangents meet
    meet = (side * (w.end[V] - s[V]) - after * h) / (before - after)
    return bool(side * s[V] + before * meet <= 0.0)


def to_rest(mode: FloatArray, f: Friction, w: Work) -> None:
    """The part has come to rest at ``w.end``."""
    w.end[V] = 0.0
    if f.attraction > 0.0:
        all_stick(w.end)
    mode[SIDE] = 0.0


def against_stop(mode: FloatArray, b: Body, f: Friction, w: Work) -> None:
    """The part has met a stop at ``w.end``: it bounces, or stays there."""
    ahead = 1.0 if w.end[X] > b.high else -1.0
    w.end[X] = b.high if ahead > 0.0 else b.low
    back = b.restitution * abs(w.end[V])
    w.end[V] = -ahead * back if back > SLOWEST_BOUNCE else 0.0
    mode[SIDE] = 1.0 if on_bristles(f) and w.end[V] != 0.0 else side_of(w.end[V])
    if f.attraction > 0.0:
        all_stick(w.end)


def to_event(
    s: FloatArray, mode: FloatArray, u: float, rise: float, h: float, b: Body, m: Any, f: Friction, w: Work
) -> float:
    """See what happened in a step of h (s) that led to ``w.end``, and go back to it; how long that took."""
    side, taken = mode[SIDE], h
    if side == 0.0:
        if has_happened(w.end, u + h * rise, side, False, b, m, f, w):
            taken = time_to(s, u, rise, h, side, False, b, m, f, w)
            mode[SIDE] = leaves(w.end, u + taken * rise, b, m, f, w.stages[6])
        return taken
    breaks = has_happened(w.end, u + h * rise, side, False, b, m, f, w)
    if breaks:
        taken = time_to(s, u, rise, h, side, False, b, m, f, w)
        if b.low <= w.end[X] <= b.high:
            if w.end[V] * side < 0.0:
                to_rest(mode, f, w)
            else:
                let_slip(w.end, side, w.stages[6, s.size - 1])
            return taken
    if breaks or has_happened(w.end, u + taken * rise, side, True, b, m, f, w):
        taken = time_to(s, u, rise, taken, side, True, b, m, f, w)
        against_stop(mode, b, f, w)
    return taken


def move(
    s: FloatArray, mode: FloatArray, u: float, rise: float, h: float, b: Body, m: Any, f: Friction, w: Work
) -> None:
    """Let h (s) pass in which the input goes straight from ``u`` with ``rise`` per second."""
    t = 0.0
    while t < h and math.isfinite(s[V]):
        now = u + t * rise
        if mode[SIDE] == 0.0:
            mode[SIDE] = leaves(s, now, b, m, f, w.stages[6])
        step = min(mode[PACE], h - t)
        attempt(s, now, rise, step, mode[SIDE], b, m, f, w)
        error = error_of(step, b, w)
        change = 0.2 if not error < 1e3 else min(0.9 * max(error, 1e-9) ** -0.2, 5.0)
        if step > SHORTEST and (not error <= 1.0 or dips(s, step, mode[SIDE], f, w)):
            mode[PACE] = step * min(change, 0.5)
            continue
        last = step == h - t
        mode[PACE] = max(mode[PACE], step * change) if last else step * change
        if not math.isfinite(w.end[V]):
            s[V] = math.nan
            return
        started = mode[SIDE] != 0.0 and s[V] == 0.0
        taken = to_event(s, mode, now, rise, step, b, m, f, w)
        if started and mode[SIDE] == 0.0 and taken <= SHORTEST and taken < step:
            # it came back at once: what moves it away is less than rounding, and it rests
            attempt(s, now, rise, step, 0.0, b, m, f, w)
            taken = step
        for j in range(s.size):
            s[j] = w.end[j]
            w.sizes[j] = max(w.sizes[j], abs(s[j]))
        remember(s, acting(s, now + taken * rise, b), m)
        t = h if last and taken == step else t + taken


PIECES = (
    slopes, leaves, attempt, has_happened, time_to, dips, to_rest, against_stop, to_event, move,
)  # fmt: skip


def mover_for(push: Callable[..., Any], remember: Callable[..., Any], rig: str) -> Callable[..., None]:
    """:func:`move` compiled for this push.

    A compiled function that takes another one as an argument cannot be kept on disk, nor can what calls
    it; so the pieces are compiled once more for each rig, with its push under a global name,
    and as pieces of the module ``rig``.
    """
    scope = {**globals(), "__name__": rig, "push": push, "remember": remember}
    for piece in PIECES:
        scope[piece.__name__] = specialised(FunctionType(piece.__code__, scope, piece.__name__))
    bound: Callable[..., None] = scope["move"]
    return bound
