"""The simulation kernel of a DC motor: winding, rotor, and a rotor that can stand still.

U = R·i + L·di/dt + K·ω + brush drop and J·ω̇ = K·i − friction − load (equations 4.1 to 4.7 of the reference
text). The current is solved exactly within a step, so an inductance may be as small as it likes, zero
included. The brush drop is V_b·sgn i, straight across ±``brush_width``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from labhil.compiled import inlined
from labhil.physics.extra_force import CompiledForce, Pushed, PushedCourse, with_extra
from labhil.physics.friction import RESOLVED, Law, damping, friction, hold, law_of, pace, scale_viscous
from labhil.physics.moving_part import NO_STOPS, TINY, Follows, Laws, Motion
from labhil.physics.stick_slip import FINEST, integrator
from labhil.signals import FloatArray, IntArray

FIRST_SHARE = 0.5
"""Share of the electrical time constant that the first step after a jump of the voltage may take."""

FADES = 5.0
"""Electrical time constants in which the allowed step grows by e, as the current settles."""


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


class Rotor(NamedTuple):
    """A motor as it is between two samples: its warm resistance, its friction."""

    motor: Motor
    resistance: float
    law: Law


class Course(NamedTuple):
    """What changes along a recording, (n,) each: warm over cold resistance, the same of viscous friction."""

    warm: FloatArray
    change: FloatArray
    cold: Rotor


@inlined
def at(r: Rotor, c: Course, k: int) -> Rotor:
    """The motor between samples k and k + 1."""
    cold = c.cold
    return Rotor(cold.motor, cold.resistance * c.warm[k], scale_viscous(cold.law, c.change[k]))


@inlined
def follow(s: Motion, r: Rotor) -> Follows:
    """Rate of the current, the resistance that damps it (Ω; near zero brushes add to it), their drop, V."""
    m = r.motor
    gauge, bias = r.resistance, 0.0
    if m.brush_drop != 0.0:
        if abs(s.a) < m.brush_width:
            gauge += m.brush_drop / m.brush_width
        else:
            bias = m.brush_drop * np.sign(s.a)
    return Follows(gauge / m.inductance if m.inductance > 0.0 else np.inf, gauge, bias, 0.0)


@inlined
def settled(s: Motion, u: float, r: Rotor) -> float:
    """Current (A) that flows when the inductance has no say."""
    m = r.motor
    volts = u - m.constant * s.v
    if m.brush_drop != 0.0:
        within = volts / (r.resistance + m.brush_drop / m.brush_width)
        if abs(within) < m.brush_width:
            return within
        volts -= m.brush_drop * np.sign(volts)
    return volts / r.resistance


@inlined
def target(s: Motion, u: float, how: Follows, r: Rotor) -> float:
    """The current towards which the present one moves, A."""
    if how.rate == np.inf:
        return settled(s, u, r)
    return (u - r.motor.constant * s.v - how.bias) / how.gauge


@inlined
def pull_of(i: float, angle: float, m: Motor) -> float:
    """Angular acceleration by everything but friction, rad/s²."""
    pull = m.constant * i / m.inertia - m.load - m.spring * angle
    if m.cogging_sine != 0.0 or m.cogging_cosine != 0.0:
        turned = m.cogging_order * angle
        pull -= m.cogging_sine * np.sin(turned) + m.cogging_cosine * np.cos(turned)
    return pull


@inlined
def load_of(i: float, m: Motor) -> float:
    """Size of the drive, rad/s²."""
    return abs(m.constant * i) / m.inertia


@inlined
def pull(s: Motion, side: float, u: float, r: Rotor) -> float:
    """Angular acceleration of a turning rotor, rad/s²."""
    return pull_of(s.a, s.x, r.motor) - friction(s.x, s.v, side, load_of(s.a, r.motor), r.law)


@inlined
def grip(s: Motion, u: float, r: Rotor) -> tuple[float, float]:
    """Angular acceleration that a rotor at rest would have, and the largest that it withstands."""
    return pull_of(s.a, s.x, r.motor), hold(s.x, load_of(s.a, r.motor), r.law)


@inlined
def longest(
    s: Motion, side: float, u: float, rise: float, since: float, how: Follows, finest: float, r: Rotor
) -> float:
    """The longest step, s.

    After a jump of the voltage the current's own decay must be resolved as far as it deviates from the course
    that it settles on, and ever less the longer the jump is past.
    """
    m = r.motor
    goal = target(s, u, how, r)
    size = np.inf
    if m.brush_drop != 0.0 and how.rate < np.inf:
        width = m.brush_width + 0.3 * max(abs(s.a) - m.brush_width, 0.0)
        size = max(RESOLVED * width / (abs(how.rate * (goal - s.a)) + TINY), finest)
    if side == 0.0:
        return size
    turning = pull(s, side, u, r)
    coupling = m.constant * m.constant / m.inertia
    swift = min(coupling / how.gauge, np.sqrt(coupling / (m.inductance + TINY)))
    steady = np.inf if how.creep > 0.0 else pace(s.v, turning, r.law)
    size = min(size, max(min(steady, RESOLVED / (swift + TINY)), finest))
    if how.rate * min(size, finest / FINEST) <= FIRST_SHARE or how.rate == np.inf:
        return size
    course = goal - (rise - m.constant * turning) / (how.gauge * how.rate)
    deviation = max(abs(s.a - course) / (abs(s.a) + abs(goal) + TINY), 1e-12)
    return min(size, FIRST_SHARE / how.rate * np.exp(min(since * how.rate / FADES, 50.0)) * deviation**-0.2)


@inlined
def rotor_damping(s: Motion, side: float, r: Rotor) -> tuple[float, float]:
    """How friction damps a turning rotor."""
    return damping(s.v, side, r.law)


LAWS = Laws(pull, target, follow, settled, grip, longest, rotor_damping, at)
run = integrator(LAWS)
run_pushed = integrator(with_extra(LAWS))


@inlined
def accelerations(i: FloatArray, angle: FloatArray, w: FloatArray, m: Motor, f: FloatArray) -> FloatArray:
    """Angular accelerations of turning rotors at many places at once, rad/s²; zero where the rotor rests."""
    out = np.zeros(w.size)
    law = law_of(f)
    for k in range(w.size):
        if w[k] != 0.0:
            drag = friction(angle[k], w[k], np.sign(w[k]), load_of(i[k], m), law)
            out[k] = pull_of(i[k], angle[k], m) - drag
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
    """Simulate windows of a recording; ``out`` (rows of all windows after each other, 3) gets ω, i, angle.

    The voltage is straight between ``node_t`` (m,) and its values ``voltage`` (m,), and keeps its last one;
    ``warm`` (n,) is the resistance over its value when cold, ``viscous_change`` (n,) the same of viscous
    friction. Window w covers the samples first[w] … last[w] − 1 and begins with states[w] = (ω, i, angle).
    """
    starts = np.empty_like(states)
    for w in range(first.size):
        starts[w, 0], starts[w, 1], starts[w, 2] = states[w, 2], states[w, 0], states[w, 1]
    cold = Rotor(m, m.resistance, law_of(f))
    course = Course(warm, viscous_change, cold)
    run(t, node_t, voltage, first, last, starts, NO_STOPS, cold, course, out)
    for row in range(out.shape[0]):
        out[row, 0], out[row, 1], out[row, 2] = out[row, 1], out[row, 2], out[row, 0]


@inlined
def simulate_pushed(
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
    beyond: CompiledForce,
    along: FloatArray,
    out: FloatArray,
) -> None:
    """:func:`simulate` under one more torque: ``beyond`` a curve, ``along`` (n,) a course, over inertia."""
    starts = np.empty_like(states)
    for w in range(first.size):
        starts[w, 0], starts[w, 1], starts[w, 2] = states[w, 2], states[w, 0], states[w, 1]
    cold = Rotor(m, m.resistance, law_of(f))
    course = PushedCourse(Course(warm, viscous_change, cold), along)
    run_pushed(t, node_t, voltage, first, last, starts, NO_STOPS, Pushed(cold, beyond), course, out)
    for row in range(out.shape[0]):
        out[row, 0], out[row, 1], out[row, 2] = out[row, 1], out[row, 2], out[row, 0]
