"""The simulation kernel of a DC motor: winding, rotor, and a rotor that can stand still.

U = R·i + L·di/dt + K·ω + brush drop and J·ω̇ = K·i − friction − load (equations 4.1 to 4.7 of the reference
text). The voltage moves straight between nodes, with jumps where two nodes share a moment. Rest is an
event: below break-away ω is exactly zero and the current alone goes on; the moments of stopping and of
breaking away are solved for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.physics.friction import friction, hold, longest_step
from labhil.signals import FloatArray, IntArray

QUASI_STATIC = 4e-4
"""Electrical time constant (s) under which the current follows at once."""

SHARE_OF_WINDING = 0.15
COARSEST_SHARE = 0.6
COARSE_STEP = 2e-3
"""A step may be this long (s) where that is at most ``COARSEST_SHARE`` of the electrical time constant."""

LONGEST_STEP = 0.02


class Motor(NamedTuple):
    """Strengths in SI units; ``load``, ``spring`` and ``cogging`` are torques over the inertia."""

    inertia: float
    constant: float
    resistance: float
    inductance: float
    brush_drop: float
    brush_width: float
    load: float
    spring: float
    cogging_sine: float
    cogging_cosine: float
    cogging_order: float


@compiled
def electromotive(i: float, w: float, m: Motor) -> float:
    """What the current has to be driven against besides the resistance, V."""
    drop = m.brush_drop * np.tanh(i / m.brush_width) if m.brush_drop != 0.0 else 0.0
    return m.constant * w + drop


@compiled
def settled_current(u: float, w: float, m: Motor) -> float:
    """Current (A) that flows when the inductance has no say."""
    i = (u - m.constant * w) / m.resistance
    if m.brush_drop != 0.0:
        for _ in range(30):
            slope = m.resistance + m.brush_drop / m.brush_width / np.cosh(i / m.brush_width) ** 2
            step = (m.resistance * i + electromotive(i, w, m) - u) / slope
            i -= step
            if abs(step) < 1e-12:
                break
    return i


@compiled
def pull_of(i: float, angle: float, m: Motor) -> float:
    """Angular acceleration by everything but friction, rad/s²."""
    pull = m.constant * i / m.inertia - m.load - m.spring * angle
    if m.cogging_sine != 0.0 or m.cogging_cosine != 0.0:
        turned = m.cogging_order * angle
        pull -= m.cogging_sine * np.sin(turned) + m.cogging_cosine * np.cos(turned)
    return pull


@compiled
def slopes(
    w: float, i: float, angle: float, side: float, u: float, m: Motor, f: FloatArray
) -> tuple[float, float]:
    """ω̇ and di/dt of a turning rotor at voltage ``u``."""
    turning = pull_of(i, angle, m) - friction(angle, w, side, f)
    return turning, (u - m.resistance * i - electromotive(i, w, m)) / m.inductance


@compiled
def turn(
    w: float, i: float, angle: float, side: float, u: float, rise: float, h: float, m: Motor, f: FloatArray
) -> tuple[float, float, float]:
    """ω, i and angle of a turning rotor h s later (Runge-Kutta) while the voltage rises by ``rise``/s."""
    half = 0.5 * h
    if m.inductance <= QUASI_STATIC * m.resistance:
        a1 = pull_of(settled_current(u, w, m), angle, m) - friction(angle, w, side, f)
        w2, x2, middle = w + half * a1, angle + half * w, u + half * rise
        a2 = pull_of(settled_current(middle, w2, m), x2, m) - friction(x2, w2, side, f)
        w3, x3 = w + half * a2, angle + half * w2
        a3 = pull_of(settled_current(middle, w3, m), x3, m) - friction(x3, w3, side, f)
        w4, x4 = w + h * a3, angle + h * w3
        a4 = pull_of(settled_current(u + h * rise, w4, m), x4, m) - friction(x4, w4, side, f)
        w_new = w + h * (a1 + 2.0 * (a2 + a3) + a4) / 6.0
        return w_new, settled_current(u + h * rise, w_new, m), angle + h * (w + 2.0 * (w2 + w3) + w4) / 6.0
    a1, d1 = slopes(w, i, angle, side, u, m, f)
    w2, i2, x2 = w + half * a1, i + half * d1, angle + half * w
    a2, d2 = slopes(w2, i2, x2, side, u + half * rise, m, f)
    w3, i3, x3 = w + half * a2, i + half * d2, angle + half * w2
    a3, d3 = slopes(w3, i3, x3, side, u + half * rise, m, f)
    w4, i4, x4 = w + h * a3, i + h * d3, angle + h * w3
    a4, d4 = slopes(w4, i4, x4, side, u + h * rise, m, f)
    return (
        w + h * (a1 + 2.0 * (a2 + a3) + a4) / 6.0,
        i + h * (d1 + 2.0 * (d2 + d3) + d4) / 6.0,
        angle + h * (w + 2.0 * (w2 + w3) + w4) / 6.0,
    )


@compiled
def stalled_current(i: float, u: float, rise: float, h: float, m: Motor) -> float:
    """Current of a rotor that stands still, h s later (Runge-Kutta; exact enough on a short step)."""
    if m.inductance <= QUASI_STATIC * m.resistance:
        return settled_current(u + h * rise, 0.0, m)
    if m.brush_drop == 0.0:
        time_constant = m.inductance / m.resistance
        lag = rise * time_constant
        decay = np.exp(-h / time_constant)
        return (u + h * rise - lag) / m.resistance + (i - (u - lag) / m.resistance) * decay
    half = 0.5 * h
    d1 = (u - m.resistance * i - electromotive(i, 0.0, m)) / m.inductance
    i2 = i + half * d1
    d2 = (u + half * rise - m.resistance * i2 - electromotive(i2, 0.0, m)) / m.inductance
    i3 = i + half * d2
    d3 = (u + half * rise - m.resistance * i3 - electromotive(i3, 0.0, m)) / m.inductance
    i4 = i + h * d3
    d4 = (u + h * rise - m.resistance * i4 - electromotive(i4, 0.0, m)) / m.inductance
    return i + h * (d1 + 2.0 * (d2 + d3) + d4) / 6.0


@compiled
def leaves(i: float, angle: float, m: Motor, f: FloatArray) -> float:
    """The side towards which a rotor at rest is torn away at this current; 0 when it holds."""
    pull = pull_of(i, angle, m)
    if pull > hold(angle, 1.0, f):
        return 1.0
    if -pull > hold(angle, -1.0, f):
        return -1.0
    return 0.0


@compiled
def time_to_leave(i: float, angle: float, u: float, rise: float, h: float, m: Motor, f: FloatArray) -> float:
    """When within h s, at whose end it is torn away, a rotor at rest leaves (bisection)."""
    low, high = 0.0, h
    for _ in range(50):
        middle = 0.5 * (low + high)
        if leaves(stalled_current(i, u, rise, middle, m), angle, m, f) != 0.0:
            high = middle
        else:
            low = middle
        if high - low < 1e-12:
            break
    return high


@compiled
def time_to_stop(
    w: float, i: float, angle: float, side: float, u: float, rise: float, h: float, m: Motor, f: FloatArray
) -> float:
    """When within h s, at whose end it would turn back, the rotor stands still (Illinois method)."""
    low, f_low = 0.0, w * side
    high, f_high = h, turn(w, i, angle, side, u, rise, h, m, f)[0] * side
    for _ in range(60):
        if high - low < 1e-12:
            break
        middle = (low * f_high - high * f_low) / (f_high - f_low)
        found = turn(w, i, angle, side, u, rise, middle, m, f)[0] * side
        if abs(found) < 1e-12:
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
    state: FloatArray, side: float, u: float, rise: float, h: float, m: Motor, f: FloatArray
) -> float:
    """Let h s pass, through all stops and starts; changes ``state`` (ω, i, angle), returns the new side."""
    t = 0.0
    electrical = m.inductance / m.resistance
    longest = LONGEST_STEP
    if electrical > QUASI_STATIC:
        coarse = min(COARSEST_SHARE * electrical, COARSE_STEP)
        longest = min(LONGEST_STEP, max(SHARE_OF_WINDING * electrical, coarse))
    while t < h - 1e-13:
        now = u + t * rise
        w, i, angle = state[0], state[1], state[2]
        if side == 0.0:
            step = min(h - t, longest)
            towards = leaves(i, angle, m, f)
            if towards != 0.0:
                side = towards
                continue
            later = stalled_current(i, now, rise, step, m)
            towards = leaves(later, angle, m, f)
            if towards != 0.0:
                step = time_to_leave(i, angle, now, rise, step, m, f)
                later = stalled_current(i, now, rise, step, m)
                side = towards
            state[1] = later
            t += step
            continue
        pull = pull_of(i, angle, m) - friction(angle, w, side, f)
        step = min(h - t, longest_step(w, pull, longest, f))
        w_new, i_new, angle_new = turn(w, i, angle, side, now, rise, step, m, f)
        if w_new * side > 0.0 or (w_new == 0.0 and w == 0.0):
            state[0], state[1], state[2] = w_new, i_new, angle_new
            t += step
        elif w == 0.0:
            # the torque that tore it away is gone again at once: it rests for this step
            state[1] = stalled_current(i, now, rise, step, m)
            side = 0.0
            t += step
        else:
            stop = time_to_stop(w, i, angle, side, now, rise, step, m, f)
            _, i_new, angle_new = turn(w, i, angle, side, now, rise, stop, m, f)
            state[0], state[1], state[2] = 0.0, i_new, angle_new
            side = 0.0
            t += stop
    return side


@compiled
def simulate(
    t: FloatArray,
    node_t: FloatArray,
    voltage: FloatArray,
    gain: FloatArray,
    first: IntArray,
    last: IntArray,
    states: FloatArray,
    m: Motor,
    f: FloatArray,
    warm: FloatArray,
    viscous_change: FloatArray,
    out: FloatArray,
) -> None:
    """Simulate windows of a recording; ``out`` (rows of all windows after each other, 3) gets ω, i, angle.

    The voltage is straight between ``node_t`` (m,) and its values ``voltage`` (m,), and keeps its last one;
    ``gain`` (n,) scales it at each sample (a sagging supply). ``warm`` (n,) is the resistance over its
    value when cold, ``viscous_change`` (n,) the same of viscous friction. Window w covers the samples
    first[w] … last[w] − 1 and begins with states[w] = (ω, i, angle).
    """
    state = np.empty(3)
    law = f.copy()
    row = 0
    for w in range(first.size):
        now = t[first[w]]
        node = np.searchsorted(node_t, now, side="right")
        state[:] = states[w]
        side = np.sign(state[0])
        out[row] = state
        row += 1
        for k in range(first[w], last[w] - 1):
            heated = Motor(
                m.inertia, m.constant, m.resistance * warm[k], m.inductance, m.brush_drop, m.brush_width,
                m.load, m.spring, m.cogging_sine, m.cogging_cosine, m.cogging_order,
            )  # fmt: skip
            law[0] = f[0] * viscous_change[k]
            end = t[k + 1]
            while now < end:
                until = min(end, node_t[node]) if node < node_t.size else end
                if until > now:
                    u, rise = stretch(node_t, voltage, node, now)
                    side = advance(state, side, gain[k] * u, gain[k] * rise, until - now, heated, law)
                    now = until
                while node < node_t.size and node_t[node] <= now:
                    node += 1
            out[row] = state
            row += 1


@compiled
def stretch(node_t: FloatArray, voltage: FloatArray, node: int, now: float) -> tuple[float, float]:
    """Voltage at ``now`` and its rise per second in the stretch before ``node`` (0: before all)."""
    if node == 0:
        return voltage[0], 0.0
    if node == node_t.size:
        return voltage[node - 1], 0.0
    h = node_t[node] - node_t[node - 1]
    rise = (voltage[node] - voltage[node - 1]) / h if h > 0.0 else 0.0
    return voltage[node - 1] + rise * (now - node_t[node - 1]), rise
