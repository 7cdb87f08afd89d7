"""The simulation kernel of one sliding part: a driven mass with friction, a spring and two stops.

m·ẍ = F(u, x) + F₀ − k·x − k₃·x³ − friction, everything divided by the mass. The drive F is a table of
powers, Σ C[a, b]·uᵃ·xᵇ: a straight gain for an axis, the magnet's force map for a solenoid. The input is
straight between nodes, with jumps where two nodes share a moment. Rest is an event: below break-away the
part holds still, and the moments of stopping, of breaking away and of meeting a stop are solved for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.physics.friction import friction, hold, longest_step
from labhil.signals import FloatArray, IntArray

POWERS = 4
LONGEST_STEP = 0.01
SLOWEST_BOUNCE = 1e-3
"""Share of the fastest speed allowed by the stops' gap per second below which a bounce ends."""


class Part(NamedTuple):
    """Strengths over the mass, SI; ``low`` and ``high`` are the stops (infinite where there are none)."""

    force: float
    spring: float
    hardening: float
    cogging_sine: float
    cogging_cosine: float
    cogging_order: float
    low: float
    high: float
    restitution: float


@compiled
def drive(u: float, x: float, c: FloatArray) -> float:
    """Σ C[a, b]·uᵃ·xᵇ by Horner's rule; ``c`` has shape (4, 4)."""
    total = 0.0
    for a in range(POWERS - 1, -1, -1):
        row = 0.0
        for b in range(POWERS - 1, -1, -1):
            row = row * x + c[a, b]
        total = total * u + row
    return total


@compiled
def pull_of(u: float, x: float, c: FloatArray, p: Part) -> float:
    """Acceleration by everything but friction, m/s²."""
    pull = drive(u, x, c) + p.force - x * (p.spring + p.hardening * x * x)
    if p.cogging_sine != 0.0 or p.cogging_cosine != 0.0:
        pull -= p.cogging_sine * np.sin(p.cogging_order * x) + p.cogging_cosine * np.cos(p.cogging_order * x)
    return pull


@compiled
def slide(
    x: float, v: float, side: float, u: float, rise: float, h: float, c: FloatArray, p: Part, f: FloatArray
) -> tuple[float, float]:
    """x and v of a moving part h s later (classical Runge-Kutta); the input rises by ``rise`` a second."""
    half = 0.5 * h
    middle = u + half * rise
    a1 = pull_of(u, x, c, p) - friction(x, v, side, f)
    x2, v2 = x + half * v, v + half * a1
    a2 = pull_of(middle, x2, c, p) - friction(x2, v2, side, f)
    x3, v3 = x + half * v2, v + half * a2
    a3 = pull_of(middle, x3, c, p) - friction(x3, v3, side, f)
    x4, v4 = x + h * v3, v + h * a3
    a4 = pull_of(u + h * rise, x4, c, p) - friction(x4, v4, side, f)
    return x + h * (v + 2.0 * (v2 + v3) + v4) / 6.0, v + h * (a1 + 2.0 * (a2 + a3) + a4) / 6.0


@compiled
def leaves(u: float, x: float, c: FloatArray, p: Part, f: FloatArray) -> float:
    """The side towards which a part at rest is torn away; 0 when it holds or leans on a stop."""
    pull = pull_of(u, x, c, p)
    if pull > hold(x, 1.0, f) and x < p.high:
        return 1.0
    if -pull > hold(x, -1.0, f) and x > p.low:
        return -1.0
    return 0.0


@compiled
def time_to_leave(x: float, u: float, rise: float, h: float, c: FloatArray, p: Part, f: FloatArray) -> float:
    """When within h s, at whose end it is torn away, a part at rest leaves (bisection)."""
    low, high = 0.0, h
    for _ in range(50):
        middle = 0.5 * (low + high)
        if leaves(u + middle * rise, x, c, p, f) != 0.0:
            high = middle
        else:
            low = middle
        if high - low < 1e-12:
            break
    return high


@compiled
def time_to_event(
    x: float, v: float, side: float, u: float, rise: float, h: float, stop: float,
    c: FloatArray, p: Part, f: FloatArray,
) -> float:  # fmt: skip
    """When within h s it stands still, or with a finite ``stop`` meets that (bisection with Illinois)."""
    at_stop = np.isfinite(stop)
    low, high = 0.0, h
    f_low = (stop - x) * side if at_stop else v * side
    x_end, v_end = slide(x, v, side, u, rise, h, c, p, f)
    f_high = (stop - x_end) * side if at_stop else v_end * side
    for _ in range(60):
        if high - low < 1e-13 or f_high == f_low:
            break
        middle = (low * f_high - high * f_low) / (f_high - f_low)
        x_mid, v_mid = slide(x, v, side, u, rise, middle, c, p, f)
        found = (stop - x_mid) * side if at_stop else v_mid * side
        if abs(found) < 1e-14:
            return middle
        if found > 0.0:
            low, f_low = middle, found
            f_high *= 0.5
        else:
            high, f_high = middle, found
            f_low *= 0.5
    return 0.5 * (low + high)


@compiled
def advance(
    state: FloatArray, side: float, u: float, rise: float, h: float, c: FloatArray, p: Part, f: FloatArray
) -> float:
    """Let h s pass, through all stops and starts; changes ``state`` (x, v) and returns the new side."""
    t = 0.0
    stiffest = abs(p.spring) + abs(drive(u, state[0] + 1e-6, c) - drive(u, state[0], c)) / 1e-6
    longest = min(LONGEST_STEP, 0.15 / np.sqrt(stiffest + 1e-9))
    while t < h - 1e-13:
        now = u + t * rise
        x, v = state[0], state[1]
        if side == 0.0:
            side = leaves(now, x, c, p, f)
            if side != 0.0:
                continue
            step = min(h - t, longest)
            side = leaves(now + step * rise, x, c, p, f)
            t += step if side == 0.0 else time_to_leave(x, now, rise, step, c, p, f)
            continue
        pull = pull_of(now, x, c, p) - friction(x, v, side, f)
        step = min(h - t, longest_step(v, pull, longest, f))
        x_new, v_new = slide(x, v, side, now, rise, step, c, p, f)
        stop = p.high if side > 0.0 else p.low
        if v_new * side <= 0.0 and v == 0.0:
            # the force that tore it away is gone again at once: it rests for this step
            side = 0.0
            t += step
            continue
        if v_new * side <= 0.0:
            taken = time_to_event(x, v, side, now, rise, step, np.inf, c, p, f)
            x_new, _ = slide(x, v, side, now, rise, taken, c, p, f)
            if (stop - x_new) * side >= 0.0:
                state[0], state[1] = x_new, 0.0
                side = 0.0
                t += taken
                continue
        if (stop - x_new) * side < 0.0:
            taken = time_to_event(x, v, side, now, rise, step, stop, c, p, f)
            _, v_new = slide(x, v, side, now, rise, taken, c, p, f)
            back = -p.restitution * v_new
            state[0] = stop
            state[1] = back if abs(back) > SLOWEST_BOUNCE * (p.high - p.low) else 0.0
            side = np.sign(state[1])
            t += taken
            continue
        state[0], state[1] = x_new, v_new
        t += step
    return side


@compiled
def simulate(
    t: FloatArray,
    node_t: FloatArray,
    values: FloatArray,
    first: IntArray,
    last: IntArray,
    states: FloatArray,
    c: FloatArray,
    p: Part,
    f: FloatArray,
    viscous_change: FloatArray,
    out: FloatArray,
) -> None:
    """Simulate windows of a recording; ``out`` (rows of all windows after each other, 2) gets x and v.

    The input is straight between ``node_t`` (m,) and its ``values`` (m,), and keeps its last one;
    ``viscous_change`` (n,) scales viscous friction at each sample. Window w covers the samples
    first[w] … last[w] − 1 and begins with states[w] = (x, v).
    """
    state = np.empty(2)
    law = f.copy()
    row = 0
    for w in range(first.size):
        now = t[first[w]]
        node = np.searchsorted(node_t, now, side="right")
        state[0] = min(max(states[w, 0], p.low), p.high)
        state[1] = states[w, 1]
        side = np.sign(state[1])
        out[row] = state
        row += 1
        for k in range(first[w], last[w] - 1):
            law[0] = f[0] * viscous_change[k]
            end = t[k + 1]
            while now < end:
                until = min(end, node_t[node]) if node < node_t.size else end
                if until > now:
                    u, rise = stretch(node_t, values, node, now)
                    side = advance(state, side, u, rise, until - now, c, p, law)
                    now = until
                while node < node_t.size and node_t[node] <= now:
                    node += 1
            out[row] = state
            row += 1


@compiled
def stretch(node_t: FloatArray, values: FloatArray, node: int, now: float) -> tuple[float, float]:
    """Input at ``now`` and its rise per second in the stretch before ``node`` (0: before all)."""
    if node == 0:
        return values[0], 0.0
    if node == node_t.size:
        return values[node - 1], 0.0
    h = node_t[node] - node_t[node - 1]
    rise = (values[node] - values[node - 1]) / h if h > 0.0 else 0.0
    return values[node - 1] + rise * (now - node_t[node - 1]), rise
