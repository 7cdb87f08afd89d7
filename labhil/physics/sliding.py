"""Simulation kernel of one sliding part: a driven mass with friction, a spring, cogging and two end stops.

m·ẍ = F(u, x) + F₀ − k·x − k₃·x³ − a·sin(N·x) − b·cos(N·x) − friction, with mass m (kg), position x (m), input
u, drive force F (N), constant force F₀ (N), stiffness k (N/m), hardening k₃ (N/m³; Duffing 1918), cogging
amplitudes a, b (N) of order N (rad/m). Kernels hold everything divided by the mass. The drive F is either a
polynomial Σ C[a, b]·uᵃ·xᵇ (a gain for an axis, the default magnet of a solenoid) or a chart, the spline
through a table of measured forces (``physics.mapped``). Friction is that of ``physics.friction``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from labhil.compiled import by_type, inlined
from labhil.physics import friction
from labhil.physics.extra_force import CompiledForce, Pushed, PushedCourse, with_extra_force
from labhil.physics.friction import MAX_STEP_SHARE, Law, law_from_array, scale_viscous
from labhil.physics.mapped import Chart, charted_force, charted_slope
from labhil.physics.moving_part import TINY, Follows, Laws, Motion, Stops
from labhil.physics.stick_slip import compile_integrator
from labhil.signals import FloatArray, IntArray

N_POWERS = 4
"""Coefficients of the drive polynomial in each variable: third order."""

MAX_STEP_OF_OSCILLATION = 0.1
"""Longest step times the natural angular frequency of mass and spring."""


class Part(NamedTuple):
    """Coefficients over the mass, SI; ``low`` and ``high`` are the stops (infinite where there are none)."""

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
"""Coefficients C[a][b] of the drive polynomial."""

Drive = Table | Chart


class Slider(NamedTuple):
    """A part between two samples."""

    part: Part
    drive: Drive
    law: Law


class Course(NamedTuple):
    """What changes along a recording: viscous friction over that of ``first``, (n,)."""

    change: FloatArray
    first: Slider


def table_from_array(c: FloatArray) -> Table:
    """Coefficients of an array (4, 4) as kernels hold them."""
    rows = [(float(a), float(b), float(c), float(d)) for a, b, c, d in c]
    return rows[0], rows[1], rows[2], rows[3]


@inlined
def part_at(p: Slider, c: Course, k: int) -> Slider:
    """The part between samples k and k + 1."""
    return Slider(p.part, p.drive, scale_viscous(c.first.law, c.change[k]))


@inlined
def polynomial(x: float, c: Row) -> float:
    """Σ c[b]·xᵇ."""
    return c[0] + x * (c[1] + x * (c[2] + x * c[3]))


@inlined
def polynomial_slope(x: float, c: Row) -> float:
    """Derivative of Σ c[b]·xᵇ by x."""
    return c[1] + x * (2.0 * c[2] + x * 3.0 * c[3])


@inlined
def powers_force(u: float, x: float, c: Table) -> float:
    """Σ C[a, b]·uᵃ·xᵇ."""
    return polynomial(x, c[0]) + u * (
        polynomial(x, c[1]) + u * (polynomial(x, c[2]) + u * polynomial(x, c[3]))
    )


@inlined
def powers_slope(u: float, x: float, c: Table) -> float:
    """Derivative of Σ C[a, b]·uᵃ·xᵇ by x."""
    return polynomial_slope(x, c[0]) + u * (
        polynomial_slope(x, c[1]) + u * (polynomial_slope(x, c[2]) + u * polynomial_slope(x, c[3]))
    )


def drive_force(u: float, x: float, drive: Drive) -> float:
    """Force of the drive over the mass, m/s²."""
    return charted_force(u, x, drive) if isinstance(drive, Chart) else powers_force(u, x, drive)


def drive_slope(u: float, x: float, drive: Drive) -> float:
    """Derivative of the force of the drive by position, over the mass, 1/s²."""
    return charted_slope(u, x, drive) if isinstance(drive, Chart) else powers_slope(u, x, drive)


by_type(drive_force, {Chart: charted_force}, powers_force)
by_type(drive_slope, {Chart: charted_slope}, powers_slope)


@inlined
def stiffness(u: float, x: float, p: Slider) -> float:
    """Bound of the derivative of the acceleration by position, 1/s²."""
    part = p.part
    cogging = part.cogging_order * (abs(part.cogging_sine) + abs(part.cogging_cosine))
    return abs(part.spring + 3.0 * part.hardening * x * x - drive_slope(u, x, p.drive)) + abs(cogging)


@inlined
def frictionless_acceleration(drive: float, x: float, part: Part) -> float:
    """Acceleration without friction, m/s²; ``drive`` is the force of the drive over the mass."""
    push = drive + part.force - x * (part.spring + part.hardening * x * x)
    if part.cogging_sine != 0.0 or part.cogging_cosine != 0.0:
        turned = part.cogging_order * x
        push -= part.cogging_sine * np.sin(turned) + part.cogging_cosine * np.cos(turned)
    return push


@inlined
def acceleration(s: Motion, side: float, u: float, p: Slider) -> float:
    """Acceleration of a moving part, friction included, m/s²."""
    drive = drive_force(u, s.x, p.drive)
    return frictionless_acceleration(drive, s.x, p.part) - friction.friction(
        s.x, s.v, s.bend, abs(drive), p.law
    )


@inlined
def pull_and_hold(s: Motion, u: float, p: Slider) -> tuple[float, float]:
    """Acceleration without friction, and the one up to which a part at rest holds, m/s²."""
    drive = drive_force(u, s.x, p.drive)
    pull = frictionless_acceleration(drive, s.x, p.part)
    return friction.pull_and_hold(pull, s.x, s.bend, abs(drive), p.law)


@inlined
def target(s: Motion, u: float, lag: Follows, p: Slider) -> float:
    """Zero: a sliding part has no lagging quantity."""
    return 0.0


@inlined
def steady_value(s: Motion, u: float, p: Slider) -> float:
    """Zero: a sliding part has no lagging quantity."""
    return 0.0


@inlined
def follow(s: Motion, u: float, p: Slider) -> Follows:
    """Zero: a sliding part has no lagging quantity."""
    return Follows(0.0, 0.0, 0.0, 0.0)


@inlined
def max_step(
    s: Motion, side: float, u: float, rise: float, since: float, lag: Follows, finest: float, p: Slider
) -> float:
    """Longest step, s: short against the oscillation on the spring, the Stribeck peak and the cogging."""
    if side == 0.0:
        return np.inf
    stiff = stiffness(u, s.x, p) + TINY
    if lag.creep > 0.0:
        size = MAX_STEP_SHARE * lag.creep / stiff
    else:
        size = min(
            MAX_STEP_OF_OSCILLATION / np.sqrt(stiff),
            friction.max_friction_step(s.v, side, s.bend, acceleration(s, side, u, p), p.law),
        )
    if p.part.cogging_sine != 0.0 or p.part.cogging_cosine != 0.0:
        size = min(size, MAX_STEP_SHARE / (abs(p.part.cogging_order * s.v) + TINY))
    return max(size, finest)


@inlined
def part_damping(s: Motion, side: float, p: Slider) -> tuple[float, float]:
    """Damping of a moving part by friction."""
    return friction.damping(s.v, side, p.law)


@inlined
def bend_after(bend: float, side: float, way: float, p: Slider) -> float:
    """Bend of the bristles after a way towards ``side``."""
    return friction.bend_after(bend, side, way, p.law)


@inlined
def first_bend(s: Motion, u: float, p: Slider) -> float:
    """Bend of the bristles at the start of a window."""
    drive = drive_force(u, s.x, p.drive)
    pull = frictionless_acceleration(drive, s.x, p.part)
    return friction.first_bend(pull, s.x, s.v, abs(drive), p.law)


LAWS = Laws(
    acceleration, target, follow, steady_value, pull_and_hold, max_step, part_damping, part_at, bend_after,
    first_bend,
)  # fmt: skip
run = compile_integrator(LAWS)
run_pushed = compile_integrator(with_extra_force(LAWS))


@inlined
def accelerations(
    u: FloatArray, x: FloatArray, v: FloatArray, bend: FloatArray, drive: Drive, p: Part, f: FloatArray
) -> FloatArray:
    """Accelerations (n,) at inputs, positions, velocities and bends (n,), m/s²; zero at rest."""
    out = np.zeros(u.size)
    slider = Slider(p, drive, law_from_array(f))
    for k in range(u.size):
        side = np.sign(v[k])
        if side != 0.0:
            out[k] = acceleration(Motion(x[k], v[k], 0.0, bend[k]), side, u[k], slider)
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
    """Simulate windows of a recording.

    Args:
        t: Times of the samples, (n,), s.
        node_t: Times of the nodes of the input, (m,), s; it is linear in between.
        values: Input at the nodes, (m,).
        first: First sample of each window, (w,).
        last: One past the last sample of each window, (w,).
        states: Initial position and velocity of each window, (w, 2).
        drive: The drive over the mass.
        p: The part over the mass.
        f: Friction coefficients over the mass, (12,), in the order of ``physics.friction``.
        viscous_change: Factor on viscous friction at each sample, (n,).
        out: Receives x, v and 0 of all windows one after another, (N, 3).
    """
    starts = np.zeros((first.size, 3))
    for w in range(first.size):
        starts[w, 0], starts[w, 1] = states[w, 0], states[w, 1]
    slider = Slider(p, drive, law_from_array(f))
    stops = Stops(p.low, p.high, p.restitution)
    course = Course(viscous_change, slider)
    run(t, node_t, values, first, last, starts, stops, slider, course, out)


@inlined
def simulate_with_force(
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
    extra: CompiledForce,
    along: FloatArray,
    out: FloatArray,
) -> None:
    """Simulate under one more force, over the mass: a curve ``extra`` and a course ``along`` (n,)."""
    starts = np.zeros((first.size, 3))
    for w in range(first.size):
        starts[w, 0], starts[w, 1] = states[w, 0], states[w, 1]
    slider = Slider(p, drive, law_from_array(f))
    stops = Stops(p.low, p.high, p.restitution)
    course = PushedCourse(Course(viscous_change, slider), along)
    run_pushed(t, node_t, values, first, last, starts, stops, Pushed(slider, extra), course, out)
