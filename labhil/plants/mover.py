"""One moving part with dry friction: an integrator that stops at every event, for any push.

The push is a compiled function that is handed in: from position, velocity, an inner state, the input and
the rig's numbers it gives the acceleration without friction and the rate of the inner state (a current, or
nothing). Events, coming to rest, breaking away and meeting a stop, are located by bisection.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import FunctionType
from typing import Any, NamedTuple

import numba

from labhil.plants.friction import (
    Friction,
    bristle_force,
    hold_level,
    relax_bristles,
    resistance,
    side_of,
    viscous_force,
)
from labhil.signals import FloatArray

X, V, INNER, SIDE, BRISTLE = range(5)
STATE_SIZE = 5
BISECTIONS = 48
BRISTLE_STEP = 1e-4
SLOWEST_BOUNCE = 1e-4
"""Speed (unit/s) below which a part that meets a stop stays there."""


Push = Callable[[float, float, float, float, Any], tuple[float, float]]

Three = tuple[float, float, float]


def push(x: float, v: float, i: float, u: float, m: Any) -> tuple[float, float]:
    """Nothing pushes: the name under which :func:`mover_for` puts the push of a rig."""
    return 0.0, 0.0


class Body(NamedTuple):
    """Inertia, stops (infinite where there are none) with their restitution, and the longest step, s."""

    inertia: float
    low: float
    high: float
    restitution: float
    longest: float


def stride(s: Three, side: float, u: float, rise: float, h: float, b: Body, m: Any, f: Friction) -> Three:
    """Position, velocity and inner state of a moving part h s later (classical Runge-Kutta)."""
    x, v, i = s
    half = 0.5 * h
    a1, d1 = push(x, v, i, u, m)
    a1 -= resistance(x, v, side, f) / b.inertia
    x2, v2, i2 = x + half * v, v + half * a1, i + half * d1
    a2, d2 = push(x2, v2, i2, u + half * rise, m)
    a2 -= resistance(x2, v2, side, f) / b.inertia
    x3, v3, i3 = x + half * v2, v + half * a2, i + half * d2
    a3, d3 = push(x3, v3, i3, u + half * rise, m)
    a3 -= resistance(x3, v3, side, f) / b.inertia
    x4, v4, i4 = x + h * v3, v + h * a3, i + h * d3
    a4, d4 = push(x4, v4, i4, u + h * rise, m)
    a4 -= resistance(x4, v4, side, f) / b.inertia
    return (
        x + h * (v + 2.0 * (v2 + v3) + v4) / 6.0,
        v + h * (a1 + 2.0 * (a2 + a3) + a4) / 6.0,
        i + h * (d1 + 2.0 * (d2 + d3) + d4) / 6.0,
    )


def idle(s: Three, u: float, rise: float, h: float, m: Any) -> Three:
    """A part that stands still: only its inner state goes on."""
    x, _, i = s
    half = 0.5 * h
    d1 = push(x, 0.0, i, u, m)[1]
    d2 = push(x, 0.0, i + half * d1, u + half * rise, m)[1]
    d3 = push(x, 0.0, i + half * d2, u + half * rise, m)[1]
    d4 = push(x, 0.0, i + h * d3, u + h * rise, m)[1]
    return x, 0.0, i + h * (d1 + 2.0 * (d2 + d3) + d4) / 6.0


def breaks_away(s: Three, u: float, b: Body, m: Any, f: Friction) -> float:
    """The side towards which a part at rest is moved, 0 when it holds; stops hold too."""
    x, _, i = s
    force = push(x, 0.0, i, u, m)[0] * b.inertia
    if force > hold_level(x, 1.0, f) and x < b.high:
        return 1.0
    if -force > hold_level(x, -1.0, f) and x > b.low:
        return -1.0
    return 0.0


def rest(s: Three, u: float, rise: float, h: float, b: Body, m: Any, f: Friction) -> tuple[float, float]:
    """How long (s, at most h) a part at rest stays, and to which side it then leaves (0: none)."""
    at_once = breaks_away(s, u, b, m, f)
    if at_once != 0.0:
        return 0.0, at_once
    side = breaks_away(idle(s, u, rise, h, m), u + h * rise, b, m, f)
    if side == 0.0:
        return h, 0.0
    low, high = 0.0, h
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if breaks_away(idle(s, u, rise, middle, m), u + middle * rise, b, m, f) != 0.0:
            high = middle
        else:
            low = middle
    return high, side


def passed(s: Three, side: float, b: Body, stops: bool) -> bool:
    """Whether a part that moved towards ``side`` has turned back, or with ``stops`` gone past a stop."""
    if stops:
        return s[0] > b.high if side > 0.0 else s[0] < b.low
    return s[1] * side < 0.0


def time_to(
    s: Three, side: float, u: float, rise: float, h: float, stops: bool,
    b: Body, m: Any, f: Friction,
) -> float:  # fmt: skip
    """When within h (s) it has come to rest, or with ``stops`` has met the stop ahead."""
    low, high = 0.0, h
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if passed(stride(s, side, u, rise, middle, b, m, f), side, b, stops):
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


def step_of(s: Three, side: float, u: float, b: Body, m: Any, f: Friction) -> float:
    """How long a step (s) may be: short against the time to cross the Stribeck velocity."""
    if f.stribeck == 0.0:
        return b.longest
    x, v, i = s
    pull = abs(push(x, v, i, u, m)[0] - resistance(x, v, side, f) / b.inertia)
    return min(b.longest, 0.1 * (f.stribeck_velocity + abs(v)) / (pull + 1e-12))


def to_event(state: FloatArray, u: float, rise: float, h: float, b: Body, m: Any, f: Friction) -> float:
    """Move a moving part on by at most h (s), up to its next event; return how long that took."""
    s = (state[X], state[V], state[INNER])
    side = state[SIDE]
    there = stride(s, side, u, rise, h, b, m, f)
    taken = h
    if passed(there, side, b, False) or (there[1] == 0.0 and s[1] != 0.0):
        if s[1] == 0.0:
            # broken away by less than rounding: it rests for this step
            state[INNER] = idle(s, u, rise, h, m)[2]
            state[SIDE] = 0.0
            return h
        taken = time_to(s, side, u, rise, h, False, b, m, f)
        there = stride(s, side, u, rise, taken, b, m, f)
        if not passed(there, side, b, True):
            state[X], state[V], state[INNER], state[SIDE] = there[0], 0.0, there[2], 0.0
            return taken
    if passed(there, side, b, True):
        taken = time_to(s, side, u, rise, taken, True, b, m, f)
        there = stride(s, side, u, rise, taken, b, m, f)
        back = -b.restitution * there[1]
        state[X] = b.high if side > 0.0 else b.low
        state[V] = back if abs(back) > SLOWEST_BOUNCE else 0.0
        state[INNER], state[SIDE] = there[2], side_of(state[V])
        return taken
    state[X], state[V], state[INNER] = there
    return taken


def on_bristles(state: FloatArray, u: float, rise: float, h: float, b: Body, m: Any, f: Friction) -> None:
    """Move a part whose dry friction is carried by bristles (LuGre) over h (s)."""
    # short against the bristles' own oscillation and damping, which a light part makes fast
    longest = min(BRISTLE_STEP, 0.2 * math.sqrt(b.inertia / f.stiffness), b.longest)
    if f.damping > 0.0:
        longest = min(longest, 0.2 * b.inertia / f.damping)
    steps = math.ceil(h / longest)
    d = h / steps
    x, v, i, z = state[X], state[V], state[INNER], state[BRISTLE]
    for k in range(steps):
        middle = u + (k + 0.5) * d * rise
        z = relax_bristles(z, x, v, 0.5 * d, f)
        a, di = push(x, v, i, middle, m)
        a -= (bristle_force(z, x, v, f) + viscous_force(v, f)) / b.inertia
        x_half, v_half, i_half = x + 0.5 * d * v, v + 0.5 * d * a, i + 0.5 * d * di
        a, di = push(x_half, v_half, i_half, middle, m)
        a -= (bristle_force(z, x_half, v_half, f) + viscous_force(v_half, f)) / b.inertia
        x, v, i = x + d * (v + 0.5 * d * a), v + d * a, i + d * di
        z = relax_bristles(z, x, v, 0.5 * d, f)
        if (x > b.high and v > 0.0) or (x < b.low and v < 0.0):
            x, v = min(max(x, b.low), b.high), -b.restitution * v
    state[X], state[V], state[INNER], state[BRISTLE], state[SIDE] = x, v, i, z, side_of(v)


def move(state: FloatArray, u: float, rise: float, h: float, b: Body, m: Any, f: Friction) -> None:
    """Let h (s) pass in which the input goes straight from ``u`` with ``rise`` per second."""
    if f.stiffness > 0.0:
        on_bristles(state, u, rise, h, b, m, f)
        return
    t = 0.0
    while t < h * (1.0 - 1e-12):
        now = u + t * rise
        left = min(h - t, b.longest)
        s = (state[X], state[V], state[INNER])
        if state[SIDE] == 0.0:
            waited, side = rest(s, now, rise, left, b, m, f)
            state[INNER] = idle(s, now, rise, waited, m)[2]
            state[SIDE] = side
            t += waited
        else:
            left = min(left, step_of(s, state[SIDE], now, b, m, f))
            t += to_event(state, now, rise, left, b, m, f)


PIECES = (stride, idle, breaks_away, rest, passed, time_to, step_of, to_event, on_bristles, move)


def mover_for(push: Push) -> Callable[..., None]:
    """:func:`move` compiled for this push.

    A compiled function that takes another one as an argument cannot be kept on disk, nor can what calls
    it; so the pieces are compiled once more for each rig, with its push under a global name.
    """
    scope = {**globals(), "push": push}
    for piece in PIECES:
        scope[piece.__name__] = numba.njit(nogil=True)(FunctionType(piece.__code__, scope, piece.__name__))
    bound: Callable[..., None] = scope["move"]
    return bound
