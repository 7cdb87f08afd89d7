"""The sliding part of ``physics.sliding`` under a force that is a table: a bicubic spline through its points.

The spline is kept as one polynomial of third order in each direction for each cell, so a kernel finds the
cell and evaluates that. Beyond the table's edges it goes on straight, with the slope that it has there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled, inlined
from labhil.physics.extra_force import Beyond, Pushed, PushedCourse, with_extra
from labhil.physics.friction import RESOLVED, Law, damping, friction, hold, law_of, pace, thinned
from labhil.physics.moving_part import TINY, Follows, Laws, Motion, Stops
from labhil.physics.sliding import SHARE_OF_SWING, Part, pushed
from labhil.physics.stick_slip import integrator
from labhil.signals import FloatArray, IntArray


class Axis(NamedTuple):
    """``cells`` equal ones from ``low`` to ``high``, ``per_unit`` of them to a unit."""

    low: float
    high: float
    cells: int
    per_unit: float


class Chart(NamedTuple):
    """A force over drive and position: C[a, b]·fᵃ·gᵇ in each cell, times ``scale``.

    f and g are 0 at the cell's begin and 1 at its end; ``numbers`` are the cells', (n·m·16,).
    """

    u: Axis
    x: Axis
    numbers: FloatArray
    scale: float


class Slider(NamedTuple):
    """A part as it is between two samples."""

    part: Part
    chart: Chart
    law: Law


class Course(NamedTuple):
    """What changes along a recording: viscous friction over its value at first, (n,)."""

    change: FloatArray
    first: Slider


@inlined
def row(b: float, at: int, c: FloatArray) -> float:
    """Σ c[at + n]·bⁿ of four coefficients."""
    return c[at] + b * (c[at + 1] + b * (c[at + 2] + b * c[at + 3]))


@inlined
def row_slope(b: float, at: int, c: FloatArray) -> float:
    """d/db of that."""
    return c[at + 1] + b * (2.0 * c[at + 2] + b * 3.0 * c[at + 3])


@inlined
def rise_at(a: float, b: float, k: int, c: FloatArray) -> float:
    """Slope along the way, at ``a`` and ``b`` within the cell whose coefficients begin at ``k``."""
    inner = row_slope(b, k + 8, c) + a * row_slope(b, k + 12, c)
    return row_slope(b, k, c) + a * (row_slope(b, k + 4, c) + a * inner)


@inlined
def located(u: float, x: float, c: Chart) -> tuple[float, float, int]:
    """Where in its cell (or how far beyond the last one) a place is, and where the cell's numbers begin."""
    a, b = (u - c.u.low) * c.u.per_unit, (x - c.x.low) * c.x.per_unit
    i, j = min(max(int(a), 0), c.u.cells - 1), min(max(int(b), 0), c.x.cells - 1)
    return a - i, b - j, 16 * (i * c.x.cells + j)


@inlined
def driven(u: float, x: float, c: Chart) -> float:
    """The force."""
    a, b, k = located(u, x, c)
    n = c.numbers
    if a < 0.0 or a > 1.0 or b < 0.0 or b > 1.0:
        return beyond_edges(a, b, k, c)
    r0, r1, r2, r3 = row(b, k, n), row(b, k + 4, n), row(b, k + 8, n), row(b, k + 12, n)
    return c.scale * (r0 + a * (r1 + a * (r2 + a * r3)))


@compiled
def beyond_edges(a: float, b: float, k: int, c: Chart) -> float:
    """The force beyond the edges: straight on from the nearest place of the table."""
    f, g, n = min(max(a, 0.0), 1.0), min(max(b, 0.0), 1.0), c.numbers
    r0, r1, r2, r3 = row(g, k, n), row(g, k + 4, n), row(g, k + 8, n), row(g, k + 12, n)
    force = r0 + f * (r1 + f * (r2 + f * r3))
    force += (a - f) * (r1 + f * (2.0 * r2 + 3.0 * f * r3)) + (b - g) * rise_at(f, g, k, n)
    return c.scale * force


@compiled
def rise(u: float, x: float, c: Chart) -> float:
    """The slope of the force along the way."""
    a, b, k = located(u, x, c)
    f, g = min(max(a, 0.0), 1.0), min(max(b, 0.0), 1.0)
    return c.scale * c.x.per_unit * rise_at(f, g, k, c.numbers)


@inlined
def at(p: Slider, c: Course, k: int) -> Slider:
    """The part between samples k and k + 1."""
    return Slider(p.part, p.chart, thinned(c.first.law, c.change[k]))


@inlined
def pull(s: Motion, side: float, u: float, p: Slider) -> float:
    """Acceleration of a moving part, m/s²."""
    drive = driven(u, s.x, p.chart)
    return pushed(drive, s.x, p.part) - friction(s.x, s.v, side, abs(drive), p.law)


@inlined
def grip(s: Motion, u: float, p: Slider) -> tuple[float, float]:
    """Acceleration that a part at rest would have, and the largest that it withstands."""
    drive = driven(u, s.x, p.chart)
    return pushed(drive, s.x, p.part), hold(s.x, abs(drive), p.law)


@inlined
def longest(
    s: Motion, side: float, u: float, climbs: float, since: float, how: Follows, finest: float, p: Slider
) -> float:
    """The longest step, s: short against the swing on the spring and the Stribeck peak."""
    if side == 0.0:
        return np.inf
    stiff = abs(p.part.spring + 3.0 * p.part.hardening * s.x * s.x - rise(u, s.x, p.chart)) + TINY
    if how.creep > 0.0:
        return max(RESOLVED * how.creep / stiff, finest)
    return max(min(SHARE_OF_SWING / np.sqrt(stiff), pace(s.v, pull(s, side, u, p), p.law)), finest)


@inlined
def damped(s: Motion, side: float, p: Slider) -> tuple[float, float]:
    """How friction damps a moving part."""
    return damping(s.v, side, p.law)


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


LAWS = Laws(pull, target, follow, settled, grip, longest, damped, at)
run = integrator(LAWS)
run_pushed = integrator(with_extra(LAWS))


@inlined
def drive(u: float, x: float, c: Chart) -> float:
    """The force at one place."""
    return driven(u, x, c)


@inlined
def accelerations(
    u: FloatArray, x: FloatArray, v: FloatArray, c: Chart, p: Part, f: FloatArray
) -> FloatArray:
    """Accelerations of moving parts at many places at once, m/s²; zero where the part rests."""
    out = np.zeros(u.size)
    slider = Slider(p, c, law_of(f))
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
    c: Chart,
    p: Part,
    f: FloatArray,
    viscous_change: FloatArray,
    out: FloatArray,
) -> None:
    """As ``sliding.simulate``, with a chart of the drive in the place of powers."""
    begun = np.zeros((first.size, 3))
    for w in range(first.size):
        begun[w, 0], begun[w, 1] = states[w, 0], states[w, 1]
    slider = Slider(p, c, law_of(f))
    stops = Stops(p.low, p.high, p.restitution)
    run(t, node_t, values, first, last, begun, stops, slider, Course(viscous_change, slider), out)


@inlined
def simulate_pushed(
    t: FloatArray,
    node_t: FloatArray,
    values: FloatArray,
    first: IntArray,
    last: IntArray,
    states: FloatArray,
    c: Chart,
    p: Part,
    f: FloatArray,
    viscous_change: FloatArray,
    beyond: Beyond,
    along: FloatArray,
    out: FloatArray,
) -> None:
    """:func:`simulate` under one more force: ``beyond`` a curve, ``along`` (n,) a course, over the mass."""
    begun = np.zeros((first.size, 3))
    for w in range(first.size):
        begun[w, 0], begun[w, 1] = states[w, 0], states[w, 1]
    slider = Slider(p, c, law_of(f))
    stops = Stops(p.low, p.high, p.restitution)
    course = PushedCourse(Course(viscous_change, slider), along)
    run_pushed(t, node_t, values, first, last, begun, stops, Pushed(slider, beyond), course, out)
