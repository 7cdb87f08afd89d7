"""Simulation kernel of a DC motor: the current of the winding and a rotor with dry friction.

U = R·i + L·di/dt + K·ω + V_b·sgn i
J·ω̇ = K·i − T₀ − k·θ − a·sin(N·θ) − b·cos(N·θ) − friction

with voltage U (V), current i (A), speed ω (rad/s), angle θ (rad), resistance R (Ω), inductance L (H), torque
constant K (N·m/A), brush drop V_b (V), inertia J (kg·m²), load T₀ (N·m), stiffness k (N·m/rad) and cogging
amplitudes a, b (N·m) of order N (1). Equations 4.1 to 4.7 of the reference text. The current is solved
exactly within a step, so the inductance may be arbitrarily small or zero. The brush drop is linear across
±``brush_width``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from labhil.compiled import inlined
from labhil.physics import friction
from labhil.physics.bracket import Bracket, false_position, narrow
from labhil.physics.extra_force import CompiledForce, Pushed, PushedCourse, with_extra_force
from labhil.physics.friction import MAX_STEP_SHARE, Law, law_from_array, scale_viscous
from labhil.physics.moving_part import NO_STOPS, TINY, Follows, Laws, Motion
from labhil.physics.stick_slip import (
    MAX_ROOT_STEPS,
    MIN_STEP_IN_PERIODS,
    TIME_TOLERANCE,
    compile_integrator,
)
from labhil.signals import FloatArray, IntArray

MAX_FIRST_STEP_SHARE = 0.5
"""Longest first step after a jump of the voltage, in electrical time constants."""

STEP_GROWTH_TIME = 5.0
"""Electrical time constants in which the longest step grows by e as the current settles."""

PASSED_SHARE = 1e-6
"""Share of the brushes' narrow range by which a step passes its edge."""


class Motor(NamedTuple):
    """Coefficients in SI units; ``load``, ``spring`` and cogging amplitudes are torques over the inertia."""

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


class Rotor(NamedTuple):
    """A motor between two samples, with its warm resistance and its friction."""

    motor: Motor
    resistance: float
    law: Law


class Course(NamedTuple):
    """What changes along a recording, (n,) each: resistance and viscous friction, warm over cold."""

    warm: FloatArray
    change: FloatArray
    cold: Rotor


@inlined
def part_at(r: Rotor, c: Course, k: int) -> Rotor:
    """The motor between samples k and k + 1."""
    cold = c.cold
    return Rotor(cold.motor, cold.resistance * c.warm[k], scale_viscous(cold.law, c.change[k]))


@inlined
def follow(s: Motion, u: float, r: Rotor) -> Follows:
    """Lag of the current: rate (1/s), resistance (Ω; brushes add to it near zero current), brush drop (V).

    Near zero current brushes take what voltage there is up to their drop: a current that stays there is the
    steady one. The resistance of this narrow range is no winding's, and nor is its lag.
    """
    m = r.motor
    gauge, bias = r.resistance, 0.0
    rate = gauge / m.inductance if m.inductance > 0.0 else np.inf
    if m.brush_drop != 0.0:
        if abs(s.a) < m.brush_width:
            gauge += m.brush_drop / m.brush_width
            stays = abs(u - m.constant * s.v) < gauge * m.brush_width
            rate = np.inf if stays else rate * gauge / r.resistance
        else:
            bias = m.brush_drop * np.sign(s.a)
    return Follows(rate, gauge, bias, 0.0)


@inlined
def steady_value(s: Motion, u: float, r: Rotor) -> float:
    """Steady current without inductance, A."""
    m = r.motor
    volts = u - m.constant * s.v
    if m.brush_drop != 0.0:
        within = volts / (r.resistance + m.brush_drop / m.brush_width)
        if abs(within) < m.brush_width:
            return within
        volts -= m.brush_drop * np.sign(volts)
    return volts / r.resistance


@inlined
def target(s: Motion, u: float, lag: Follows, r: Rotor) -> float:
    """The current towards which the present one moves, A."""
    if lag.rate == np.inf:
        return steady_value(s, u, r)
    return (u - r.motor.constant * s.v - lag.bias) / lag.gauge


@inlined
def frictionless_acceleration(i: float, angle: float, m: Motor) -> float:
    """Angular acceleration without friction, rad/s²."""
    pull = m.constant * i / m.inertia - m.load - m.spring * angle
    if m.cogging_sine != 0.0 or m.cogging_cosine != 0.0:
        turned = m.cogging_order * angle
        pull -= m.cogging_sine * np.sin(turned) + m.cogging_cosine * np.cos(turned)
    return pull


@inlined
def drive_size(i: float, m: Motor) -> float:
    """Absolute torque of the current over the inertia, rad/s²."""
    return abs(m.constant * i) / m.inertia


@inlined
def acceleration(s: Motion, side: float, u: float, r: Rotor) -> float:
    """Angular acceleration of a turning rotor, friction included, rad/s²."""
    return frictionless_acceleration(s.a, s.x, r.motor) - friction.friction(
        s.x, s.v, s.bend, drive_size(s.a, r.motor), r.law
    )


@inlined
def pull_and_hold(s: Motion, u: float, r: Rotor) -> tuple[float, float]:
    """Angular acceleration without friction, and the one up to which a rotor at rest holds, rad/s²."""
    pull = frictionless_acceleration(s.a, s.x, r.motor)
    return friction.pull_and_hold(pull, s.x, s.bend, drive_size(s.a, r.motor), r.law)


@inlined
def max_step(
    s: Motion, side: float, u: float, rise: float, since: float, lag: Follows, finest: float, r: Rotor
) -> float:
    """Longest step, s.

    A step ends where the current comes to the brushes' narrow range, or leaves it.
    """
    turning = acceleration(s, side, u, r) if side != 0.0 else 0.0
    goal = target(s, u, lag, r)
    longest = max_turning_step(s, side, turning, goal, rise, since, lag, finest, r)
    if r.motor.brush_drop == 0.0:
        return longest
    drift = (rise - r.motor.constant * turning) / lag.gauge
    within = min(longest, finest / MIN_STEP_IN_PERIODS)
    until = time_to_brush_edge(s.a, goal, drift, lag.rate, within, r.motor.brush_width)
    return until if until < within else longest


@inlined
def current_after(t: float, i: float, goal: float, drift: float, rate: float) -> float:
    """Current after t s towards a goal that drifts, A: exact for a constant drift in A/s."""
    if rate == np.inf:
        return goal + drift * t
    behind = drift / rate
    return goal + drift * t - behind + (i - goal + behind) * np.exp(-rate * t)


@inlined
def time_to_brush_edge(
    i: float, goal: float, drift: float, rate: float, within: float, width: float
) -> float:
    """Time until a current enters or leaves the range of ±width, s; ``within`` where it does not.

    The edge is passed by a little, so that the next step begins behind it.
    """
    last = current_after(within, i, goal, drift, rate)
    if abs(i) < width:
        edge = np.copysign(width * (1.0 + PASSED_SHARE), last)
        if abs(last) <= width * (1.0 + PASSED_SHARE):
            return within
    else:
        edge = np.copysign(width * (1.0 - PASSED_SHARE), i)
        if (last - edge) * i >= 0.0:
            return within
    between = Bracket(0.0, i - edge, within, last - edge, 0.0)
    for _ in range(MAX_ROOT_STEPS):
        if between.high - between.low < TIME_TOLERANCE:
            break
        middle = false_position(between)
        value = current_after(middle, i, goal, drift, rate) - edge
        if abs(value) < PASSED_SHARE * width:
            return middle
        between = narrow(between, middle, value)
    return between.high


@inlined
def max_turning_step(
    s: Motion, side: float, turning: float, goal: float, rise: float, since: float, lag: Follows,
    finest: float, r: Rotor,
) -> float:  # fmt: skip
    """Longest step without brushes, s.

    After a jump of the voltage the decay of the current towards its slow course must be resolved, the less
    the longer ago the jump was.
    """
    if side == 0.0:
        return np.inf
    m = r.motor
    coupling = m.constant * m.constant / m.inertia
    swift = min(coupling / lag.gauge, np.sqrt(coupling / (m.inductance + TINY)))
    steady = np.inf if lag.creep > 0.0 else friction.max_friction_step(s.v, side, s.bend, turning, r.law)
    size = max(min(steady, MAX_STEP_SHARE / (swift + TINY)), finest)
    if lag.rate * min(size, finest / MIN_STEP_IN_PERIODS) <= MAX_FIRST_STEP_SHARE or lag.rate == np.inf:
        return size
    course = goal - (rise - m.constant * turning) / (lag.gauge * lag.rate)
    deviation = max(abs(s.a - course) / (abs(s.a) + abs(goal) + TINY), 1e-12)
    return min(
        size,
        MAX_FIRST_STEP_SHARE
        / lag.rate
        * np.exp(min(since * lag.rate / STEP_GROWTH_TIME, 50.0))
        * deviation**-0.2,
    )


@inlined
def rotor_damping(s: Motion, side: float, r: Rotor) -> tuple[float, float]:
    """Damping of a turning rotor by friction."""
    return friction.damping(s.v, side, r.law)


@inlined
def bend_after(bend: float, side: float, way: float, r: Rotor) -> float:
    """Bend of the bristles after a way towards ``side``."""
    return friction.bend_after(bend, side, way, r.law)


@inlined
def first_bend(s: Motion, u: float, r: Rotor) -> float:
    """Bend of the bristles at the start of a window."""
    pull = frictionless_acceleration(s.a, s.x, r.motor)
    return friction.first_bend(pull, s.x, s.v, drive_size(s.a, r.motor), r.law)


LAWS = Laws(
    acceleration, target, follow, steady_value, pull_and_hold, max_step, rotor_damping, part_at, bend_after,
    first_bend,
)  # fmt: skip
run = compile_integrator(LAWS)
run_pushed = compile_integrator(with_extra_force(LAWS))


@inlined
def accelerations(
    i: FloatArray, angle: FloatArray, w: FloatArray, bend: FloatArray, m: Motor, f: FloatArray
) -> FloatArray:
    """Angular accelerations (n,) at currents, angles, speeds and bends (n,), rad/s²; zero at rest."""
    out = np.zeros(w.size)
    law = law_from_array(f)
    for k in range(w.size):
        if w[k] != 0.0:
            drag = friction.friction(angle[k], w[k], bend[k], drive_size(i[k], m), law)
            out[k] = frictionless_acceleration(i[k], angle[k], m) - drag
    return out


@inlined
def simulate(
    t: FloatArray,
    node_t: FloatArray,
    voltage: FloatArray,
    first: IntArray,
    last: IntArray,
    states: FloatArray,
    m: Motor,
    f: FloatArray,
    warm: FloatArray,
    viscous_change: FloatArray,
    out: FloatArray,
) -> None:
    """Simulate windows of a recording.

    Args:
        t: Times of the samples, (n,), s.
        node_t: Times of the nodes of the voltage, (m,), s; it is linear in between.
        voltage: Voltage at the nodes, (m,), V.
        first: First sample of each window, (w,).
        last: One past the last sample of each window, (w,).
        states: Initial speed, current and angle of each window, (w, 3).
        m: The motor.
        f: Friction coefficients over the inertia, (12,), in the order of ``physics.friction``.
        warm: Warm over cold resistance at each sample, (n,).
        viscous_change: Factor on viscous friction at each sample, (n,).
        out: Receives ω, i and angle of all windows one after another, (N, 3).
    """
    starts = np.empty_like(states)
    for w in range(first.size):
        starts[w, 0], starts[w, 1], starts[w, 2] = states[w, 2], states[w, 0], states[w, 1]
    cold = Rotor(m, m.resistance, law_from_array(f))
    course = Course(warm, viscous_change, cold)
    run(t, node_t, voltage, first, last, starts, NO_STOPS, cold, course, out)
    for row in range(out.shape[0]):
        out[row, 0], out[row, 1], out[row, 2] = out[row, 1], out[row, 2], out[row, 0]


@inlined
def simulate_with_force(
    t: FloatArray,
    node_t: FloatArray,
    voltage: FloatArray,
    first: IntArray,
    last: IntArray,
    states: FloatArray,
    m: Motor,
    f: FloatArray,
    warm: FloatArray,
    viscous_change: FloatArray,
    extra: CompiledForce,
    along: FloatArray,
    out: FloatArray,
) -> None:
    """Simulate under one more torque, over the inertia: a curve ``extra`` and a course ``along`` (n,)."""
    starts = np.empty_like(states)
    for w in range(first.size):
        starts[w, 0], starts[w, 1], starts[w, 2] = states[w, 2], states[w, 0], states[w, 1]
    cold = Rotor(m, m.resistance, law_from_array(f))
    course = PushedCourse(Course(warm, viscous_change, cold), along)
    run_pushed(t, node_t, voltage, first, last, starts, NO_STOPS, Pushed(cold, extra), course, out)
    for row in range(out.shape[0]):
        out[row, 0], out[row, 1], out[row, 2] = out[row, 1], out[row, 2], out[row, 0]
