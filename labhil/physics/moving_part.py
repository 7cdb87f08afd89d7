"""The laws of one moving part, and one time step of its motion without events.

A part has a position x, a velocity v and a quantity a with a first-order lag (the current of a winding):
ẋ = v, v̇ = acceleration(x, v, a, u), ȧ = rate·(target(x, v, u) − a). The classical Runge-Kutta method steps x
and v. In each of its stages a is solved exactly for a target that is a parabola in time, so its rate may be
anything from zero to infinity. A part that friction damps much faster than the step creeps at the velocity
that balances its drive: there an exponential step is taken (Rosenbrock-Euler; Hochbruck and Ostermann,
Exponential integrators, Acta Numerica 19, 2010), since explicit steps would have to be as short as the decay.
Events (rest, break-away, stops) are in ``physics.stick_slip``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from labhil.compiled import inlined, specialised

Part = TypeVar("Part")
"""What the laws of a kernel need: coefficients over the inertia."""

Course = TypeVar("Course")
"""What changes the part along the recording."""

TINY = 1e-300
"""Added to divisors that may be zero."""


class Motion(NamedTuple):
    """Position x, velocity v, and the lagging quantity a, ȧ = rate·(target − a); SI units.

    ``bend`` is the share of dry friction that acts, from −1 to 1: the side to which the part moves, but for a
    short way after a reversal where it presses on bristles (:mod:`physics.bristles`).
    """

    x: float
    v: float
    a: float
    bend: float


class Stops(NamedTuple):
    """End stops (infinite where there are none) and their coefficient of restitution."""

    low: float
    high: float
    restitution: float


NO_STOPS = Stops(-np.inf, np.inf, 0.0)


class Follows(NamedTuple):
    """How a lags during one step: its rate, 1/s, and two numbers that its target may depend on.

    ``creep`` is the rate at which the velocity of a creeping part follows the drive, 1/s; 0 where inertia
    matters.
    """

    rate: float
    gauge: float
    bias: float
    creep: float


class Laws(NamedTuple, Generic[Part, Course]):
    """The physics of one kind of part, as compiled functions.

    ``side`` is +1 or −1 while the part moves and 0 at rest; u is the input.
    """

    acceleration: Callable[[Motion, float, float, Part], float]
    """(state, side, u, part) to the acceleration of a moving part, friction included."""

    target: Callable[[Motion, float, Follows, Part], float]
    """(state, u, lag, part) to the target of a; must not depend on a itself."""

    follow: Callable[[Motion, float, Part], Follows]
    """(state, u, part) to the lag of a in the coming step."""

    steady_value: Callable[[Motion, float, Part], float]
    """(state, u, part) to the steady value of a, which it has at an infinite rate."""

    pull_and_hold: Callable[[Motion, float, Part], tuple[float, float]]
    """(state, u, part) to the acceleration without friction, and the one up to which a part at rest holds."""

    max_step: Callable[[Motion, float, float, float, float, Follows, float, Part], float]
    """(state, side, u, slope of u, time since the last node of the input, lag, finest, part) to the longest
    step, s; ``finest`` is the shortest step that friction may ask for."""

    damping: Callable[[Motion, float, Part], tuple[float, float]]
    """(state, side, part) to the damping −∂acceleration/∂v, 1/s (0 or less: not damped), and a bound of its
    derivative by velocity, 1/m."""

    part_at: Callable[[Part, Course, int], Part]
    """(part, course, k) to the part between samples k and k + 1."""

    bend_after: Callable[[float, float, float, Part], float]
    """(bend, side, way, part) to the bend after a way towards ``side``."""

    first_bend: Callable[[Motion, float, Part], float]
    """(state, u, part) to the bend at the start of a window."""


@inlined
def step_responses(y: float) -> tuple[float, float, float, float, float]:
    """Responses of a first-order lag over a step of y/rate, y = rate·h.

    Returns:
        After half of the step to a unit target and to a unit ramp; after the step to a unit target, to a unit
        ramp, and to its square.
    """
    if y < 2e-2:
        z = 0.5 * y
        one, two = phi_functions(z)
        short, ramp = z * one, z * two
        one, two = phi_functions(y)
        return short, ramp, y * one, y * two, 1.0 - 2.0 * two
    decay = np.exp(-0.5 * y)
    short, whole = 1.0 - decay, 1.0 - decay * decay
    long_ramp = 1.0 - whole / y
    return short, 1.0 - 2.0 * short / y, whole, long_ramp, 1.0 - 2.0 * long_ramp / y


@inlined
def phi_functions(y: float) -> tuple[float, float]:
    """φ₁ = (1 − e⁻ʸ)/y and (1 − φ₁)/y by their series, for a small y at which these forms would cancel."""
    one = 1.0 - y * (0.5 - y * (1.0 / 6.0 - y * (1.0 / 24.0 - y / 120.0)))
    return one, 0.5 - y * (1.0 / 6.0 - y * (1.0 / 24.0 - y * (1.0 / 120.0 - y / 720.0)))


@inlined
def follow_parabola(
    a: float, first: float, middle: float, last: float, whole: float, ramp: float, bend: float
) -> float:
    """Value of a after a step, for a target that is a parabola through three values."""
    slope = 4.0 * middle - 3.0 * first - last
    return a + whole * (first - a) + ramp * slope + bend * 2.0 * (first - 2.0 * middle + last)


Step = Callable[[Motion, float, float, float, float, Follows, Part], Motion]
"""(state, side, u, rise, h, lag, part) to the state h s later, while u rises by ``rise`` per second."""


def compile_step(laws: Laws[Part, Course]) -> Step[Part]:
    """Compile one time step without events; a part at rest stays where it is."""
    acceleration, target, bend_after = laws.acceleration, laws.target, laws.bend_after

    @specialised
    def creep(s: Motion, side: float, u: float, rise: float, h: float, lag: Follows, part: Part) -> Motion:
        end, goal, start = u + h * rise, target(s, u, lag, part), acceleration(s, side, u, part)
        _, _, long, long_ramp, curvature = step_responses(h * lag.rate)
        _, _, whole, ramp, _ = step_responses(h * lag.creep)
        x, v, a = s.x + h * s.v, s.v, s.a
        for _ in range(2):  # the second pass knows the drive at the end of the step
            last = target(Motion(x, v, s.a, s.bend), end, lag, part)
            a = follow_parabola(s.a, goal, 0.5 * (goal + last), last, long, long_ramp, curvature)
            drift = acceleration(Motion(x, s.v, a, s.bend), side, end, part) - start
            v = s.v + (whole * start + ramp * drift) / lag.creep
            way = ramp * start + (0.5 - ramp / (h * lag.creep)) * drift
            x = s.x + h * (s.v + way / lag.creep)
        return Motion(x, v, a, bend_after(s.bend, side, x - s.x, part))

    @specialised
    def step(s: Motion, side: float, u: float, rise: float, h: float, lag: Follows, part: Part) -> Motion:
        if lag.creep > 0.0 and side != 0.0 and h > 0.0:
            return creep(s, side, u, rise, h, lag, part)
        moves = 0.0 if side == 0.0 else 1.0
        half = 0.5 * h
        middle, end = u + half * rise, u + h * rise
        short, ramp, whole, long_ramp, curvature = step_responses(h * lag.rate)
        goal1 = target(s, u, lag, part)
        acceleration1 = moves * acceleration(s, side, u, part)
        v2 = s.v + half * acceleration1
        goal2 = target(Motion(s.x + half * s.v, v2, s.a, s.bend), middle, lag, part)
        a2 = s.a + short * (goal1 - s.a) + ramp * (goal2 - goal1)
        s2 = Motion(s.x + half * s.v, v2, a2, bend_after(s.bend, side, half * s.v, part))
        acceleration2 = moves * acceleration(s2, side, middle, part)
        v3 = s.v + half * acceleration2
        goal3 = target(Motion(s.x + half * v2, v3, s.a, s.bend), middle, lag, part)
        a3 = s.a + short * (goal1 - s.a) + ramp * (goal3 - goal1)
        s3 = Motion(s.x + half * v2, v3, a3, bend_after(s.bend, side, half * v2, part))
        acceleration3 = moves * acceleration(s3, side, middle, part)
        v4 = s.v + h * acceleration3
        goal4 = target(Motion(s.x + h * v3, v4, s.a, s.bend), end, lag, part)
        a4 = follow_parabola(s.a, goal1, goal3, goal4, whole, long_ramp, curvature)
        s4 = Motion(s.x + h * v3, v4, a4, bend_after(s.bend, side, h * v3, part))
        acceleration4 = moves * acceleration(s4, side, end, part)
        x = s.x + h * (s.v + 2.0 * (v2 + v3) + v4) / 6.0
        v = s.v + h * (acceleration1 + 2.0 * (acceleration2 + acceleration3) + acceleration4) / 6.0
        goal = target(Motion(x, v, s.a, s.bend), end, lag, part)
        a = follow_parabola(s.a, goal1, 0.5 * (goal2 + goal3), goal, whole, long_ramp, curvature)
        return Motion(x, v, a, bend_after(s.bend, side, x - s.x, part))

    return step
