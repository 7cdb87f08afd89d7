"""The simulation kernel of one sliding part: a driven mass with friction, a spring and two stops.

m·ẍ = F(u, x) + F₀ − k·x − k₃·x³ − friction, everything divided by the mass. The drive F is a table of
powers, Σ C[a, b]·uᵃ·xᵇ (a straight gain for an axis, the default magnet of a solenoid), or a chart: the
spline through a table of measured forces (``physics.mapped``). Every kernel here takes either.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from labhil.compiled import by_type, inlined
from labhil.physics.extra_force import CompiledForce, Pushed, PushedCourse, with_extra
from labhil.physics.friction import RESOLVED, Law, damping, friction, hold, law_of, pace, scale_viscous
from labhil.physics.mapped import Chart, charted_force, charted_slope
from labhil.physics.moving_part import TINY, Follows, Laws, Motion, Stops
from labhil.physics.stick_slip import integrator
from labhil.signals import FloatArray, IntArray

POWERS = 4

SHARE_OF_SWING = 0.1
"""Share of 1/ω that one step may take in a spring-mass system of natural frequency ω."""


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


Row = tuple[float, float, float, float]
Table = tuple[Row, Row, Row, Row]
"""C[a][b] as kernels hold it."""

Drive = Table | Chart


class Slider(NamedTuple):
    """A part as it is between two samples."""

    part: Part
    drive: Drive
    law: Law


class Course(NamedTuple):
    """What changes along a recording: viscous friction over its value at first, (n,)."""

    change: FloatArray
    first: Slider


def table_of(c: FloatArray) -> Table:
    """The coefficients of an array (4, 4)."""
    rows = [(float(a), float(b), float(c), float(d)) for a, b, c, d in c]
    return rows[0], rows[1], rows[2], rows[3]


@inlined
def at(p: Slider, c: Course, k: int) -> Slider:
    """The part between samples k and k + 1."""
    return Slider(p.part, p.drive, scale_viscous(c.first.law, c.change[k]))


@inlined
def power(x: float, c: Row) -> float:
    """Σ c[b]·xᵇ."""
    return c[0] + x * (c[1] + x * (c[2] + x * c[3]))


@inlined
def slope(x: float, c: Row) -> float:
    """d/dx of Σ c[b]·xᵇ."""
    return c[1] + x * (2.0 * c[2] + x * 3.0 * c[3])


@inlined
def powers_force(u: float, x: float, c: Table) -> float:
    """Σ C[a, b]·uᵃ·xᵇ."""
    return power(x, c[0]) + u * (power(x, c[1]) + u * (power(x, c[2]) + u * power(x, c[3])))


@inlined
def powers_slope(u: float, x: float, c: Table) -> float:
    """d/dx of Σ C[a, b]·uᵃ·xᵇ."""
    return slope(x, c[0]) + u * (slope(x, c[1]) + u * (slope(x, c[2]) + u * slope(x, c[3])))


def drive_force(u: float, x: float, drive: Drive) -> float:
    """The drive's force over the mass, m/s²."""
    return charted_force(u, x, drive) if isinstance(drive, Chart) else powers_force(u, x, drive)


def rise(u: float, x: float, drive: Drive) -> float:
    """The slope of that along the way, 1/s²."""
    return charted_slope(u, x, drive) if isinstance(drive, Chart) else powers_slope(u, x, drive)


by_type(drive_force, {Chart: charted_force}, powers_force)
by_type(rise, {Chart: charted_slope}, powers_slope)


@inlined
def stiffness(u: float, x: float, p: Slider) -> float:
    """How fast the acceleration falls along the way, 1/s²."""
    part = p.part
    cogging = part.cogging_order * (abs(part.cogging_sine) + abs(part.cogging_cosine))
    return abs(part.spring + 3.0 * part.hardening * x * x - rise(u, x, p.drive)) + abs(cogging)


@inlined
def drive_acceleration(drive: float, x: float, part: Part) -> float:
    """Acceleration by everything but friction, of which ``drive`` is the drive's part, m/s²."""
    push = drive + part.force - x * (part.spring + part.hardening * x * x)
    if part.cogging_sine != 0.0 or part.cogging_cosine != 0.0:
        turned = part.cogging_order * x
        push -= part.cogging_sine * np.sin(turned) + part.cogging_cosine * np.cos(turned)
    return push


@inlined
def pull(s: Motion, side: float, u: float, p: Slider) -> float:
    """Acceleration of a moving part, m/s²."""
    drive = drive_force(u, s.x, p.drive)
    return drive_acceleration(drive, s.x, p.part) - friction(s.x, s.v, side, abs(drive), p.law)


@inlined
def grip(s: Motion, u: float, p: Slider) -> tuple[float, float]:
    """Acceleration that a part at rest would have, and the largest that it withstands."""
    drive = drive_force(u, s.x, p.drive)
    return drive_acceleration(drive, s.x, p.part), hold(s.x, abs(drive), p.law)


@inlined
def target(s: Motion, u: float, how: Follows, p: Slider) -> float:
    """Nothing follows here."""
    return 0.0


@inlined
def settled(s: Motion, u: float, p: Slider) -> float:
    """Nothing follows here."""
    return 0.0


@inlined
def follow(s: Motion, p: Slider) -> Follows:
    """Nothing follows here."""
    return Follows(0.0, 0.0, 0.0, 0.0)


@inlined
def longest(
    s: Motion, side: float, u: float, climbs: float, since: float, how: Follows, finest: float, p: Slider
) -> float:
    """The longest step, s: short against the swing on the spring, the Stribeck peak and the cogging."""
    if side == 0.0:
        return np.inf
    stiff = stiffness(u, s.x, p) + TINY
    if how.creep > 0.0:
        size = RESOLVED * how.creep / stiff
    else:
        size = min(SHARE_OF_SWING / np.sqrt(stiff), pace(s.v, pull(s, side, u, p), p.law))
    if p.part.cogging_sine != 0.0 or p.part.cogging_cosine != 0.0:
        size = min(size, RESOLVED / (abs(p.part.cogging_order * s.v) + TINY))
    return max(size, finest)


@inlined
def part_damping(s: Motion, side: float, p: Slider) -> tuple[float, float]:
    """How friction damps a moving part."""
    return damping(s.v, side, p.law)


LAWS = Laws(pull, target, follow, settled, grip, longest, part_damping, at)
run = integrator(LAWS)
run_pushed = integrator(with_extra(LAWS))


@inlined
def accelerations(
    u: FloatArray, x: FloatArray, v: FloatArray, drive: Drive, p: Part, f: FloatArray
) -> FloatArray:
    """Accelerations of moving parts at many places at once, m/s²; zero where the part rests."""
    out = np.zeros(u.size)
    slider = Slider(p, drive, law_of(f))
    for k in range(u.size):
        if v[k] != 0.0:
            out[k] = pull(Motion(x[k], v[k], 0.0), np.sign(v[k]), u[k], slider)
    return out


@inlined
def simulate(
    t: FloatArray,
    node_t: FloatArray,
    values: FloatArray,
    first: IntArray,
    last: IntArray,
    states: FloatArray,
    drive: Drive,
    p: Part,
    f: FloatArray,
    viscous_change: FloatArray,
    out: FloatArray,
) -> None:
    """Simulate windows of a recording; ``out`` (rows of all windows after each other, 3) gets x, v and 0.

    The input is straight between ``node_t`` (m,) and its ``values`` (m,), and keeps its last one;
    ``viscous_change`` (n,) scales viscous friction at each sample. Window w covers the samples
    first[w] … last[w] − 1 and begins with states[w] = (x, v).
    """
    starts = np.zeros((first.size, 3))
    for w in range(first.size):
        starts[w, 0], starts[w, 1] = states[w, 0], states[w, 1]
    slider = Slider(p, drive, law_of(f))
    stops = Stops(p.low, p.high, p.restitution)
    course = Course(viscous_change, slider)
    run(t, node_t, values, first, last, starts, stops, slider, course, out)


@inlined
def simulate_pushed(
    t: FloatArray,
    node_t: FloatArray,
    values: FloatArray,
    first: IntArray,
    last: IntArray,
    states: FloatArray,
    drive: Drive,
    p: Part,
    f: FloatArray,
    viscous_change: FloatArray,
    beyond: CompiledForce,
    along: FloatArray,
    out: FloatArray,
) -> None:
    """:func:`simulate` under one more force: ``beyond`` a curve, ``along`` (n,) a course, over the mass."""
    starts = np.zeros((first.size, 3))
    for w in range(first.size):
        starts[w, 0], starts[w, 1] = states[w, 0], states[w, 1]
    slider = Slider(p, drive, law_of(f))
    stops = Stops(p.low, p.high, p.restitution)
    course = PushedCourse(Course(viscous_change, slider), along)
    run_pushed(t, node_t, values, first, last, starts, stops, Pushed(slider, beyond), course, out)
