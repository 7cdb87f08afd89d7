"""Simulation kernel of a ball that rolls on a tilting beam, with friction.

(M + J/R²)·ẍ = M·g·sin β + M·x·β̇² − (J/R)·β̈ + F₀ − k·x − k₃·x³ − friction, sin β = ratio·sin γ, with
position x (m), beam angle β and crank angle γ (rad), mass M (kg), radius R (m), inertia J (kg·m²), constant
force F₀ (N), stiffness k (N/m) and hardening k₃ (N/m³). Equations 4.13 to 4.17 of the reference text, with
its errata: the Stribeck exponent is negative, and −(J/R)·β̈ is kept; dry friction may turn over on bristles
(``physics.bristles``). Everything is divided by the effective mass M + J/R² (+ added inertia), so forces are
accelerations and the kernel serves rigs of unknown mass. The crank turns at a constant rate between nodes; β̇
jumps at a node, which changes the velocity by −(J/R)/(M + J/R²)·Δβ̇.

Rest is an event: below break-away the ball is at rest. The instant of break-away is exact (the drive is taken
as linear in time), and the instant at which a ball comes to rest is found by root bracketing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from labhil.compiled import inlined
from labhil.physics import bristles
from labhil.physics.bracket import Bracket, false_position, narrow
from labhil.physics.extra_force import CompiledForce, friction_at, max_table_step
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
    DRY_SLOPE,
    CONSTANT,
    SPRING,
    HARDENING,
    BRISTLE_TIME,
    PRESLIDING_LENGTH,
) = range(17)
SIZE = 17
"""Number of coefficients; an additional force follows them, see :func:`with_force`."""

DRY = (COULOMB, STRIBECK, DRY_SLOPE)
"""Places of dry friction; bristles bend under no other, and do nothing without it."""

ACTS, LOW, PER_UNIT, WIDTH, N_TABLE = range(SIZE, SIZE + 5)
TABLE = SIZE + 5
"""Place of the first of ``k[N_TABLE]`` values of user-defined friction.

The values of the curve follow, or those of the course where the force has no curve.
"""


class Crank(NamedTuple):
    """Motion of the crank in a stretch: from ``angle`` (rad) at the rate ``turning`` (rad/s)."""

    angle: float
    turning: float
    ratio: float


LONGEST_STEP = 0.02
SHORTEST_STEP = 3e-4
"""Limits of a time step, s."""

STRIBECK_RANGE = 30.0
"""Speed, in Stribeck velocities, above which the Stribeck peak counts as zero (e^−30)."""

BREAK_AWAY_DELAY = 1e-7
"""Time after the instant of break-away at which the ball moves, s."""


@inlined
def beam(crank: Crank, t: float) -> tuple[float, float, float]:
    """sin β, β̇ (rad/s) and β̈ (rad/s²) t s into a stretch, from sin β = ratio·sin γ."""
    angle = crank.angle + t * crank.turning
    sine = crank.ratio * np.sin(angle)
    cosine = np.sqrt(max(1.0 - sine * sine, 1e-6))
    rate = crank.ratio * np.cos(angle) * crank.turning / cosine
    return sine, rate, (rate * rate - crank.turning * crank.turning) * sine / cosine


@inlined
def lever(angle: float, ratio: float) -> float:
    """dβ/dγ where the crank stands at ``angle`` (rad)."""
    sine = ratio * np.sin(angle)
    return ratio * np.cos(angle) / np.sqrt(max(1.0 - sine * sine, 1e-6))


def with_force(k: FloatArray, extra: CompiledForce, along: FloatArray) -> FloatArray:
    """Append an additional force to coefficients ``k`` (17,): user-defined friction, curve or course."""
    friction = extra.friction
    head = [float(extra.over), extra.low, extra.per_unit, extra.width, float(len(friction))]
    return np.concatenate([k, head, friction, extra.values if extra.over else along])


@inlined
def curve(x: float, k: FloatArray) -> float:
    """Value of the curve at ``x``: linear between its nodes, constant outside, m/s²."""
    place = (x - k[LOW]) * k[PER_UNIT]
    first = TABLE + int(k[N_TABLE])
    last = k.size - first - 1
    if not place > 0.0:
        return k[first]
    if place >= last:
        return k[first + last]
    i = int(place)
    share = place - i
    return (1.0 - share) * k[first + i] + share * k[first + i + 1]


@inlined
def push(x: float, v: float, k: FloatArray) -> float:
    """Force of the curve along the beam, m/s²."""
    if k[ACTS] == 1.0:
        return curve(x, k)
    if k[ACTS] == 3.0:
        return curve(v, k)
    return -v * curve(x, k) if k[ACTS] == 5.0 else 0.0


@inlined
def drag(x: float, v: float, k: FloatArray) -> float:
    """Force of the curve and of user-defined friction against the motion, m/s²."""
    level = 0.0
    if k[ACTS] == 2.0:
        level = curve(x, k)
    elif k[ACTS] == 4.0:
        level = curve(abs(v), k)
    return level + friction_at(abs(v), k, TABLE) if k[N_TABLE] > 0.0 else level


@inlined
def drive(x: float, sine: float, rate: float, turn: float, k: FloatArray) -> float:
    """Acceleration without friction, m/s²; ``rate`` is β̇ and ``turn`` is β̈."""
    return (
        k[GRAVITY] * sine
        + k[CENTRIFUGAL] * x * rate * rate
        - k[ROLLING] * turn
        + k[CONSTANT]
        - x * (k[SPRING] + k[HARDENING] * x * x)
    )


@inlined
def dry_friction(x: float, speed: float, k: FloatArray) -> float:
    """Dry friction of a ball that slides on no bristles, m/s²."""
    dry = k[COULOMB] + k[DRY_SLOPE] * x
    if k[STRIBECK] != 0.0 and speed < STRIBECK_RANGE * k[STRIBECK_VELOCITY]:
        dry += k[STRIBECK] * np.exp(-speed / k[STRIBECK_VELOCITY])
    return dry


@inlined
def hold(x: float, k: FloatArray) -> float:
    """Break-away level: acceleration either way up to which the ball stays at rest, m/s²; never negative.

    Bristles do not hold.
    """
    level = 0.0 if k[PRESLIDING_LENGTH] > 0.0 else dry_friction(x, 0.0, k) + k[STATIC]
    if k.size > SIZE:
        level += drag(x, 0.0, k)
    return max(level, 0.0)


@inlined
def friction(x: float, v: float, side: float, bend: float, k: FloatArray) -> float:
    """Deceleration by friction of a ball that moves towards ``side`` on bristles with this bend, m/s²."""
    speed = abs(v)
    share = bristles.share_of_dry_friction(v, bend, k[PRESLIDING_LENGTH], k[BRISTLE_TIME])
    dry = share * dry_friction(x, speed, k)
    viscous = v * (k[VISCOUS] + k[QUADRATIC] * speed + k[CUBIC] * v * v) + k[ASYMMETRIC_VISCOUS] * speed
    if k.size > SIZE:
        return dry + side * drag(x, v, k) + viscous - push(x, v, k)
    return dry + viscous


@inlined
def acceleration(
    x: float, v: float, side: float, bend: float, crank: Crank, t: float, k: FloatArray
) -> float:
    """Acceleration of a moving ball t s into a stretch, m/s²."""
    sine, rate, turn = beam(crank, t)
    return drive(x, sine, rate, turn, k) - friction(x, v, side, bend, k)


@inlined
def accelerations(
    x: FloatArray, v: FloatArray, bend: FloatArray, sine: FloatArray, rate: FloatArray, k: FloatArray
) -> FloatArray:
    """Accelerations (n,) at positions, velocities, bends, beam sines and rates (n,), m/s²; zero at rest.

    The beam turns at a constant rate.
    """
    out = np.zeros(v.size)
    for i in range(v.size):
        side = np.sign(v[i])
        if side != 0.0:
            out[i] = drive(x[i], sine[i], rate[i], 0.0, k) - friction(x[i], v[i], side, bend[i], k)
    return out


@inlined
def runge_kutta(
    a1: float, x: float, v: float, side: float, bend: float, crank: Crank, t: float, h: float, k: FloatArray
) -> tuple[float, float]:
    """One classical fourth-order step of a moving ball from t to t + h; ``a1`` is its acceleration at t."""
    sine, rate, turn = beam(crank, t + 0.5 * h)
    length = k[PRESLIDING_LENGTH]
    x2, v2 = x + 0.5 * h * v, v + 0.5 * h * a1
    bend2 = bristles.bend_after(bend, side, x2 - x, length)
    a2 = drive(x2, sine, rate, turn, k) - friction(x2, v2, side, bend2, k)
    x3, v3 = x + 0.5 * h * v2, v + 0.5 * h * a2
    bend3 = bristles.bend_after(bend, side, x3 - x, length)
    a3 = drive(x3, sine, rate, turn, k) - friction(x3, v3, side, bend3, k)
    x4, v4 = x + h * v3, v + h * a3
    bend4 = bristles.bend_after(bend, side, x4 - x, length)
    a4 = acceleration(x4, v4, side, bend4, crank, t + h, k)
    return x + h * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0, v + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0


@inlined
def step_length(v: float, left: float, pull: float, k: FloatArray) -> float:
    """Longest step, s: it must not jump over a narrow Stribeck peak, or over bristles.

    ``left`` is the distance of the bristles' bend from its end value, and ``pull`` is the acceleration at the
    start of the step, m/s².
    """
    speed = abs(v)
    stiffness = abs(k[VISCOUS]) + 2.0 * abs(k[QUADRATIC]) * speed + 3.0 * abs(k[CUBIC]) * v * v
    h = LONGEST_STEP
    if k[STRIBECK] != 0.0:
        width = k[STRIBECK_VELOCITY]
        stiffness += abs(k[STRIBECK]) / (width * (1.0 + speed * speed / (width * width)))
        h = min(h, 0.5 * (width + 0.25 * speed) / (abs(pull) + 1e-9))
    if k.size > SIZE and k[ACTS] != 0.0:
        h = min(h, k[WIDTH] / ((abs(pull) if 3.0 <= k[ACTS] <= 4.0 else speed) + 1e-9))
    if k.size > SIZE and k[N_TABLE] > 0.0:
        h = min(h, max_table_step(speed, pull, k, TABLE))
    if k[PRESLIDING_LENGTH] > 0.0:
        dry = k[COULOMB] + k[STRIBECK]
        h = min(h, bristles.max_step(v, left, dry, k[PRESLIDING_LENGTH], k[BRISTLE_TIME]))
    return max(min(h, 0.5 / (stiffness + 1e-9)), SHORTEST_STEP)


@inlined
def time_to_rest(
    a1: float, x: float, v: float, side: float, bend: float, crank: Crank, t: float, h: float, k: FloatArray
) -> float:
    """Instant of zero velocity within a step of length h that ends with the velocity reversed, s."""
    later = runge_kutta(a1, x, v, side, bend, crank, t, h, k)[1]
    between = Bracket(0.0, v * side, h, later * side, 0.0)
    for _ in range(60):
        if between.high - between.low < 1e-10:
            break
        middle = false_position(between)
        speed = runge_kutta(a1, x, v, side, bend, crank, t, middle, k)[1] * side
        if abs(speed) < 1e-10:
            return middle
        between = narrow(between, middle, speed)
    return 0.5 * (between.low + between.high)


@inlined
def time_to_break_away(x: float, bend: float, crank: Crank, t: float, k: FloatArray) -> tuple[float, float]:
    """Time until break-away (s) and its side (±1); infinity if the drive recedes.

    The drive is extrapolated linearly; the caller repeats the call after that time.
    """
    sine, rate, turn = beam(crank, t)
    now = drive(x, sine, rate, turn, k)
    if k.size > SIZE:
        now += push(x, 0.0, k)
    if k[PRESLIDING_LENGTH] > 0.0:
        now -= bend * dry_friction(x, 0.0, k)
    growth = k[GRAVITY] * crank.ratio * np.cos(crank.angle + t * crank.turning) * crank.turning
    level = hold(x, k)
    if now > level:
        return 0.0, 1.0
    if now < -level:
        return 0.0, -1.0
    if growth > 0.0:
        return (level - now) / growth, 1.0
    if growth < 0.0:
        return (-level - now) / growth, -1.0
    return np.inf, 0.0


@inlined
def advance(
    x: float, v: float, side: float, bend: float, crank: Crank, start: float, end: float, k: FloatArray
) -> tuple[float, float, float, float]:
    """Move the ball from ``start`` to ``end`` s into a stretch, through rest and break-away.

    ``side`` is +1 or −1 while it moves and 0 at rest. Returns the new x, v, side, bend.
    """
    t, length = start, k[PRESLIDING_LENGTH]
    while t < end:
        if side == 0.0:
            wait, towards = time_to_break_away(x, bend, crank, t, k)
            if wait >= end - t:
                return x, 0.0, 0.0, bend
            if wait == 0.0:
                side = towards
                bend = bristles.bend_after(bend, side, 0.0, length)
            else:
                t += wait + BREAK_AWAY_DELAY
            continue
        pull = acceleration(x, v, side, bend, crank, t, k)
        step = min(end - t, step_length(v, abs(side - bend), pull, k))
        x_new, v_new = runge_kutta(pull, x, v, side, bend, crank, t, step, k)
        if v_new * side >= 0.0:
            bend = bristles.bend_after(bend, side, x_new - x, length)
            x, v = x_new, v_new
            t += step
        elif v == 0.0:
            # the drive fell below break-away again within the step
            side = 0.0
            t += min(step, SHORTEST_STEP)
        else:
            stop = time_to_rest(pull, x, v, side, bend, crank, t, step, k)
            x_new, _ = runge_kutta(pull, x, v, side, bend, crank, t, stop, k)
            bend = bristles.bend_after(bend, side, x_new - x, length)
            x = x_new
            v, side = 0.0, 0.0
            t += stop
    return x, v, side, bend


@inlined
def begin_bend(x: float, v: float, crank: Crank, t: float, k: FloatArray) -> float:
    """Bend of the bristles at the start of a window, t s into a stretch."""
    sine, rate, turn = beam(crank, t)
    pull = drive(x, sine, rate, turn, k)
    return bristles.first_bend(pull, v, dry_friction(x, abs(v), k), k[PRESLIDING_LENGTH])


@inlined
def simulate(
    t: FloatArray,
    node_t: FloatArray,
    angle: FloatArray,
    ratio: float,
    first: IntArray,
    last: IntArray,
    states: FloatArray,
    k: FloatArray,
    out: FloatArray,
) -> None:
    """Simulate windows of a recording.

    Args:
        t: Times of the samples, (n,), s.
        node_t: Times of the nodes of the crank's angle, (m,), s.
        angle: Angle of the crank at the nodes, (m,), rad; linear in between, constant before and after.
        ratio: sin β = ratio·sin(angle). Without a linkage the ratio is 1 and the angle is that of the beam.
        first: First sample of each window, (w,).
        last: One past the last sample of each window, (w,).
        states: Initial (x, v + k[ROLLING]·β̇) of each window, (w, 2). Unlike v that is continuous at a node,
            so results do not jump when a delay moves nodes across the first sample.
        k: Coefficients over the effective mass, (17,), or longer with an additional force.
        out: Receives x and v of all windows one after another, (N, 2).
    """
    row = 0
    given = k.size > SIZE and k[ACTS] == 0.0
    constant = k[CONSTANT]
    k = k.copy() if given else k
    for w in range(first.size):
        now = t[first[w]]
        node = np.searchsorted(node_t, now, side="right")
        crank, began = stretch(node_t, angle, ratio, node)
        x = states[w, 0]
        v = states[w, 1] - k[ROLLING] * beam(crank, now - began)[1]
        side, bend = np.sign(v), begin_bend(x, v, crank, now - began, k)
        out[row, 0], out[row, 1] = x, v
        row += 1
        for i in range(first[w], last[w] - 1):
            end = t[i + 1]
            if given:
                k[CONSTANT] = constant + k[TABLE + int(k[N_TABLE]) + i]
            while now < end:
                until = min(end, node_t[node]) if node < node_t.size else end
                x, v, side, bend = advance(x, v, side, bend, crank, now - began, until - began, k)
                now = until
                if node < node_t.size and node_t[node] <= now:
                    node += 1
                    before = crank.turning
                    crank, began = stretch(node_t, angle, ratio, node)
                    v -= k[ROLLING] * lever(crank.angle, ratio) * (crank.turning - before)
                    side = np.sign(v)
                    bend = bristles.bend_after(bend, side, 0.0, k[PRESLIDING_LENGTH])
            out[row, 0], out[row, 1] = x, v
            row += 1


@inlined
def stretch(node_t: FloatArray, angle: FloatArray, ratio: float, node: int) -> tuple[Crank, float]:
    """Motion of the crank in the stretch before ``node`` (0: before the first), and the start of it, s."""
    if node == 0:
        return Crank(angle[0], 0.0, ratio), node_t[0]
    if node == node_t.size:
        return Crank(angle[node - 1], 0.0, ratio), node_t[node - 1]
    h = node_t[node] - node_t[node - 1]
    turning = (angle[node] - angle[node - 1]) / h if h > 0.0 else 0.0
    return Crank(angle[node - 1], turning, ratio), node_t[node - 1]
