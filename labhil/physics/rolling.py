"""The simulation kernel of a ball that rolls on a tilting beam, with every friction law it may have.

Everything is divided by the effective mass M + J/R² (+ added inertia), so forces are accelerations
here and the same kernel serves rigs whose mass is unknown. Equations 4.13 to 4.17 of the reference
text, with its errata: the Stribeck exponent is negative, and −(J/R)·β̈ is kept. The beam's angle is
straight between nodes, so β̇ is constant there and β̈ is an impulse at each node, which changes the
velocity by −(J/R)/(M + J/R²)·Δβ̇.

Rest is an event: below break-away the ball holds still, the moment at which the drive exceeds the
hold is solved exactly (the drive is straight in time), and so is the moment at which a moving ball
comes to rest.
"""

from __future__ import annotations

import numpy as np

from labhil.compiled import compiled
from labhil.signals import FloatArray, IntArray

(
    GRAVITY,
    CENTRIFUGAL,
    ROLLING,
    VISCOUS,
    COULOMB,
    STATIC,
    STRIBECK,
    STRIBECK_VELOCITY,
    QUADRATIC,
    CUBIC,
    ASYMMETRIC_VISCOUS,
    ASYMMETRIC_DRY,
    DRY_SLOPE,
    CONSTANT,
    SPRING,
    HARDENING,
) = range(16)
SIZE = 16

LONGEST_STEP = 0.02
SHORTEST_STEP = 2e-4
NARROW = 30.0


@compiled
def drive(x: float, sine: float, rate: float, k: FloatArray) -> float:
    """Acceleration by everything but friction, m/s²; ``rate`` is β̇."""
    return (
        k[GRAVITY] * sine
        + k[CENTRIFUGAL] * x * rate * rate
        + k[CONSTANT]
        - x * (k[SPRING] + k[HARDENING] * x * x)
    )


@compiled
def hold(x: float, side: float, k: FloatArray) -> float:
    """Largest drive towards ``side`` (±1) against which the ball stays at rest, m/s²; never negative."""
    level = k[COULOMB] + k[STRIBECK] + k[STATIC] + side * k[ASYMMETRIC_DRY] + k[DRY_SLOPE] * x
    return max(level, 0.0)


@compiled
def friction(x: float, v: float, side: float, k: FloatArray) -> float:
    """Deceleration by friction of a ball that moves towards ``side``, m/s²."""
    speed = abs(v)
    dry = k[COULOMB] + side * k[ASYMMETRIC_DRY] + k[DRY_SLOPE] * x
    if k[STRIBECK] != 0.0 and speed < NARROW * k[STRIBECK_VELOCITY]:
        dry += k[STRIBECK] * np.exp(-speed / k[STRIBECK_VELOCITY])
    viscous = v * (k[VISCOUS] + k[QUADRATIC] * speed + k[CUBIC] * v * v) + k[ASYMMETRIC_VISCOUS] * speed
    return side * dry + viscous


@compiled
def acceleration(x: float, v: float, side: float, sine: float, rate: float, k: FloatArray) -> float:
    """Acceleration of a moving ball, m/s²."""
    return drive(x, sine, rate, k) - friction(x, v, side, k)


@compiled
def runge_kutta(
    x: float, v: float, side: float, sine: float, slope: float, rate: float, h: float, k: FloatArray
) -> tuple[float, float]:
    """One classical fourth-order step of a moving ball; sin β starts at ``sine`` and grows with ``slope``."""
    a1 = acceleration(x, v, side, sine, rate, k)
    return runge_kutta_from(a1, x, v, side, sine, slope, rate, h, k)


@compiled
def runge_kutta_from(
    a1: float,
    x: float,
    v: float,
    side: float,
    sine: float,
    slope: float,
    rate: float,
    h: float,
    k: FloatArray,
) -> tuple[float, float]:
    """The same, where the acceleration at the start is known."""
    middle = sine + 0.5 * h * slope
    v2 = v + 0.5 * h * a1
    a2 = acceleration(x + 0.5 * h * v, v2, side, middle, rate, k)
    v3 = v + 0.5 * h * a2
    a3 = acceleration(x + 0.5 * h * v2, v3, side, middle, rate, k)
    v4 = v + h * a3
    a4 = acceleration(x + h * v3, v4, side, sine + h * slope, rate, k)
    return x + h * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0, v + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0


@compiled
def step_length(v: float, pull: float, k: FloatArray) -> float:
    """How far one step may go: the Stribeck peak is narrow and must not be jumped over.

    ``pull`` is the acceleration at the start of the step.
    """
    speed = abs(v)
    stiffness = abs(k[VISCOUS]) + 2.0 * abs(k[QUADRATIC]) * speed + 3.0 * abs(k[CUBIC]) * v * v
    h = LONGEST_STEP
    if k[STRIBECK] != 0.0:
        width = k[STRIBECK_VELOCITY]
        stiffness += abs(k[STRIBECK]) / (width * (1.0 + speed * speed / (width * width)))
        h = min(h, 0.5 * (width + 0.25 * speed) / (abs(pull) + 1e-9))
    return max(min(h, 0.5 / (stiffness + 1e-9)), SHORTEST_STEP)


@compiled
def time_to_rest(
    x: float, v: float, side: float, sine: float, slope: float, rate: float, h: float, k: FloatArray
) -> float:
    """When within a step of length h, that ends with the velocity reversed, it is zero (Illinois method)."""
    low, f_low = 0.0, v * side
    high, f_high = h, runge_kutta(x, v, side, sine, slope, rate, h, k)[1] * side
    for _ in range(60):
        if high - low < 1e-10:
            break
        middle = (low * f_high - high * f_low) / (f_high - f_low)
        f = runge_kutta(x, v, side, sine, slope, rate, middle, k)[1] * side
        if abs(f) < 1e-10:
            return middle
        if f > 0.0:
            low, f_low = middle, f
            f_high *= 0.5
        else:
            high, f_high = middle, f
            f_low *= 0.5
    return 0.5 * (low + high)


@compiled
def time_to_break_away(
    x: float, sine: float, slope: float, rate: float, k: FloatArray
) -> tuple[float, float]:
    """When a ball at rest starts to move, and towards which side; infinity when the drive stays below."""
    now = drive(x, sine, rate, k)
    growth = k[GRAVITY] * slope
    right, left = hold(x, 1.0, k), -hold(x, -1.0, k)
    if now > right:
        return 0.0, 1.0
    if now < left:
        return 0.0, -1.0
    if growth > 0.0:
        return (right - now) / growth, 1.0
    if growth < 0.0:
        return (left - now) / growth, -1.0
    return np.inf, 0.0


@compiled
def advance(
    x: float, v: float, side: float, sine: float, slope: float, rate: float, h: float, k: FloatArray
) -> tuple[float, float, float]:
    """Move the ball over a stretch of length h, s, through all its stops and starts.

    ``side`` is +1 or −1 while it moves and 0 at rest. Returns the new x, v, side.
    """
    t = 0.0
    while t < h:
        left = h - t
        now = sine + slope * t
        if side == 0.0:
            wait, towards = time_to_break_away(x, now, slope, rate, k)
            if wait >= left:
                return x, 0.0, 0.0
            t += wait
            side = towards
            continue
        pull = acceleration(x, v, side, now, rate, k)
        step = min(left, step_length(v, pull, k))
        x_new, v_new = runge_kutta_from(pull, x, v, side, now, slope, rate, step, k)
        if v_new * side >= 0.0:
            x, v = x_new, v_new
            t += step
        elif v == 0.0:
            # it had broken away by less than rounding: it rests for this step
            side = 0.0
            t += step
        else:
            stop = time_to_rest(x, v, side, now, slope, rate, step, k)
            x, _ = runge_kutta(x, v, side, now, slope, rate, stop, k)
            v, side = 0.0, 0.0
            t += stop
    return x, v, side


@compiled
def simulate(
    t: FloatArray,
    node_t: FloatArray,
    sine: FloatArray,
    beam: FloatArray,
    first: IntArray,
    last: IntArray,
    states: FloatArray,
    k: FloatArray,
    out: FloatArray,
) -> None:
    """Simulate windows of a recording; ``out`` (rows of all windows after each other, 2) gets x and v.

    ``t`` (n,) are the times of the samples; the beam's angle ``beam`` (rad) and its ``sine`` are given
    at the nodes ``node_t`` (n,), straight in between and at rest before the first and after the last.
    Window w covers the samples first[w] … last[w] − 1 and begins with states[w] = (x, v).
    """
    row = 0
    for w in range(first.size):
        x, v = states[w, 0], states[w, 1]
        side = np.sign(v)
        now = t[first[w]]
        node = np.searchsorted(node_t, now, side="right") - 1
        rate, slope, sine_now = segment(node_t, sine, beam, node, now)
        out[row, 0], out[row, 1] = x, v
        row += 1
        for i in range(first[w], last[w] - 1):
            end = t[i + 1]
            while now < end:
                until = end
                if node + 1 < node_t.size and node_t[node + 1] < end:
                    until = node_t[node + 1]
                x, v, side = advance(x, v, side, sine_now, slope, rate, until - now, k)
                now = until
                if node + 1 < node_t.size and node_t[node + 1] <= now:
                    node += 1
                previous = rate
                rate, slope, sine_now = segment(node_t, sine, beam, node, now)
                if rate != previous:
                    v -= k[ROLLING] * (rate - previous)
                    side = np.sign(v)
            out[row, 0], out[row, 1] = x, v
            row += 1


@compiled
def segment(
    node_t: FloatArray, sine: FloatArray, beam: FloatArray, node: int, now: float
) -> tuple[float, float, float]:
    """β̇, d(sin β)/dt and sin β at the time ``now`` in the segment that follows ``node`` (−1: before all)."""
    if node < 0:
        return 0.0, 0.0, sine[0]
    if node + 1 >= node_t.size:
        return 0.0, 0.0, sine[node_t.size - 1]
    h = node_t[node + 1] - node_t[node]
    slope = (sine[node + 1] - sine[node]) / h
    return (beam[node + 1] - beam[node]) / h, slope, sine[node] + slope * (now - node_t[node])
