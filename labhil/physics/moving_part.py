"""One moving part, whatever drives it: its laws, and a step of its motion without events.

A part has a position, a velocity and one quantity that follows on its own (the current of a winding).
Position and velocity are stepped by the classical Runge-Kutta method. The following quantity is solved
exactly in each of its stages for a target that is a parabola through those known so far, so that its rate
may be anything from zero to infinity. Where friction damps so fast that a part creeps at the velocity that
balances its drive, the velocity follows that balance by an exponential step (the Rosenbrock-Euler method of
Hochbruck and Ostermann, Exponential integrators, Acta Numerica 19, 2010, with the drive's slope), for
explicit steps would have to be as short as the decay.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from labhil.compiled import inlined, specialised

Part = TypeVar("Part")
"""Whatever a kernel's laws need to know: strengths over the inertia."""

Course = TypeVar("Course")
"""What changes it along the recording."""

TINY = 1e-300


class Motion(NamedTuple):
    """Position x, velocity v, and a, which follows by ȧ = rate·(target − a); SI units."""

    x: float
    v: float
    a: float


class Stops(NamedTuple):
    """Where the way ends (infinite where it does not) and what share of its speed comes back there."""

    low: float
    high: float
    restitution: float


NO_STOPS = Stops(-np.inf, np.inf, 0.0)


class Follows(NamedTuple):
    """How a follows during one step: its rate, 1/s, and two numbers that its target may depend on.

    ``creep`` is the rate at which the velocity follows the drive, 1/s; 0 where inertia matters.
    """

    rate: float
    gauge: float
    bias: float
    creep: float


class Laws(NamedTuple, Generic[Part, Course]):
    """The physics of one kind of part, compiled functions all.

    ``side`` is +1 or −1 while the part moves, 0 at rest; u is the input.
    """

    pull: Callable[[Motion, float, float, Part], float]
    """(state, side, u, part) to the acceleration of a moving part."""

    target: Callable[[Motion, float, Follows, Part], float]
    """(state, u, how a follows, part) to what a moves towards; must not depend on a itself."""

    follow: Callable[[Motion, Part], Follows]
    """(state, part) to how a follows in the coming step."""

    settled: Callable[[Motion, float, Part], float]
    """(state, u, part) to the value of a that an infinite rate leads to."""

    grip: Callable[[Motion, float, Part], tuple[float, float]]
    """(state, u, part) to the pull on a resting part, and the largest one that it withstands."""

    pace: Callable[[Motion, float, float, float, float, Follows, float, Part], float]
    """(state, side, u, its rise per second, time since the input last bent, how a follows, finest, part) to
    the longest step, s; ``finest`` is the least that friction may ask for."""

    damping: Callable[[Motion, float, Part], tuple[float, float]]
    """(state, side, part) to how fast the pull of a moving part falls with its velocity, 1/s (0 or less: it
    does not), and at most how fast that changes with velocity, 1/m."""

    at: Callable[[Part, Course, int], Part]
    """(part, what changes along the recording, k) to the part as it is between samples k and k + 1."""


@inlined
def step_responses(y: float) -> tuple[float, float, float, float, float]:
    """How a unit target is followed over a step of y/rate.

    Half of the step: answer to a constant target and to one that rises straight from 0; the whole step: to
    a constant, to a straight rise from 0, and to its square.
    """
    if y < 2e-2:
        z = 0.5 * y
        one, two = shares(z)
        short, ramp = z * one, z * two
        one, two = shares(y)
        return short, ramp, y * one, y * two, 1.0 - 2.0 * two
    decay = np.exp(-0.5 * y)
    short, whole = 1.0 - decay, 1.0 - decay * decay
    long_ramp = 1.0 - whole / y
    return short, 1.0 - 2.0 * short / y, whole, long_ramp, 1.0 - 2.0 * long_ramp / y


@inlined
def shares(y: float) -> tuple[float, float]:
    """(1 − e⁻ʸ)/y and (1 − (1 − e⁻ʸ)/y)/y for a small y, where these forms would cancel."""
    one = 1.0 - y * (0.5 - y * (1.0 / 6.0 - y * (1.0 / 24.0 - y / 120.0)))
    return one, 0.5 - y * (1.0 / 6.0 - y * (1.0 / 24.0 - y * (1.0 / 120.0 - y / 720.0)))


@inlined
def follow_parabola(
    a: float, first: float, middle: float, last: float, whole: float, ramp: float, bend: float
) -> float:
    """What a becomes over a step with a parabola of targets."""
    slope = 4.0 * middle - 3.0 * first - last
    return a + whole * (first - a) + ramp * slope + bend * 2.0 * (first - 2.0 * middle + last)


Step = Callable[[Motion, float, float, float, float, Follows, Part], Motion]
"""(state, side, u, rise, h, how a follows, part) to the state h s later, while u rises by ``rise``/s."""


def stepper(laws: Laws[Part, Course]) -> Step[Part]:
    """Compile a step without events; a part at rest stays where it is."""
    pull, target = laws.pull, laws.target

    @specialised
    def creep(s: Motion, side: float, u: float, rise: float, h: float, how: Follows, part: Part) -> Motion:
        end, goal, pulled = u + h * rise, target(s, u, how, part), pull(s, side, u, part)
        _, _, long, long_ramp, bend = step_responses(h * how.rate)
        _, _, whole, ramp, _ = step_responses(h * how.creep)
        x, v, a = s.x + h * s.v, s.v, s.a
        for _ in range(2):  # the way there shows where the drive will be
            last = target(Motion(x, v, s.a), end, how, part)
            a = follow_parabola(s.a, goal, 0.5 * (goal + last), last, long, long_ramp, bend)
            drift = pull(Motion(x, s.v, a), side, end, part) - pulled
            v = s.v + (whole * pulled + ramp * drift) / how.creep
            way = ramp * pulled + (0.5 - ramp / (h * how.creep)) * drift
            x = s.x + h * (s.v + way / how.creep)
        return Motion(x, v, a)

    @specialised
    def step(s: Motion, side: float, u: float, rise: float, h: float, how: Follows, part: Part) -> Motion:
        if how.creep > 0.0 and side != 0.0 and h > 0.0:
            return creep(s, side, u, rise, h, how, part)
        moves = 0.0 if side == 0.0 else 1.0
        half = 0.5 * h
        middle, end = u + half * rise, u + h * rise
        short, ramp, whole, long_ramp, bend = step_responses(h * how.rate)
        goal1 = target(s, u, how, part)
        pull1 = moves * pull(s, side, u, part)
        v2 = s.v + half * pull1
        goal2 = target(Motion(s.x + half * s.v, v2, s.a), middle, how, part)
        s2 = Motion(s.x + half * s.v, v2, s.a + short * (goal1 - s.a) + ramp * (goal2 - goal1))
        pull2 = moves * pull(s2, side, middle, part)
        v3 = s.v + half * pull2
        goal3 = target(Motion(s.x + half * v2, v3, s.a), middle, how, part)
        s3 = Motion(s.x + half * v2, v3, s.a + short * (goal1 - s.a) + ramp * (goal3 - goal1))
        pull3 = moves * pull(s3, side, middle, part)
        v4 = s.v + h * pull3
        goal4 = target(Motion(s.x + h * v3, v4, s.a), end, how, part)
        a4 = follow_parabola(s.a, goal1, goal3, goal4, whole, long_ramp, bend)
        pull4 = moves * pull(Motion(s.x + h * v3, v4, a4), side, end, part)
        x = s.x + h * (s.v + 2.0 * (v2 + v3) + v4) / 6.0
        v = s.v + h * (pull1 + 2.0 * (pull2 + pull3) + pull4) / 6.0
        goal = target(Motion(x, v, s.a), end, how, part)
        return Motion(x, v, follow_parabola(s.a, goal1, 0.5 * (goal2 + goal3), goal, whole, long_ramp, bend))

    return step
