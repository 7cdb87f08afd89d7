"""The acceleration of a user's simulator together with the forces of the catalogue at its coordinate.

v̇ = share·f(x, v, u) + (F₀ − k·x − k₃·x³ − cogging − friction)/M, with the simulator's acceleration f (m/s² or
rad/s²), the share of its inertia in the total inertia M, and the forces of ``physics.sliding``. Rest is an
event (``physics.stick_slip``): dry friction at the coordinate is exact and not smoothed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from labhil.compiled import specialised
from labhil.physics import friction, sliding
from labhil.physics.friction import Law
from labhil.physics.moving_part import TINY, Follows, Laws, Motion
from labhil.signals import FloatArray

Acceleration = Callable[[float, float, float, Any], float]
"""Maps (x, v, u, p) to the acceleration of the coordinate."""


class Pushes(NamedTuple):
    """Forces at the port, all over the total inertia M.

    Attributes:
        extra: Forces of the catalogue but friction.
        law: Friction.
        share: Inertia of the simulator over the total inertia.
        load: Load on the friction contact per unit of the input's absolute value.
        stiff: Bound of |∂f/∂x|, 1/s².
        quick: Bound of |∂f/∂v|, 1/s.
    """

    extra: sliding.Part
    law: Law
    share: float
    load: float
    stiff: float
    quick: float


class Course(NamedTuple):
    """What changes along a recording: viscous friction over that of ``law``, (n,)."""

    change: FloatArray
    law: Law


def compile_laws_at_port(acceleration: Acceleration) -> Laws[Any, Any]:
    """Compile the laws of the coordinate for :func:`physics.stick_slip.compile_integrator`.

    A part is the pair (p of ``acceleration``, :class:`Pushes`).

    Args:
        acceleration: Compiled function of (x, v, u, p) that gives the simulator's own acceleration.

    Returns:
        The laws.
    """

    @specialised
    def frictionless(s: Motion, u: float, part: Any) -> float:
        p, pushes = part
        return pushes.share * acceleration(s.x, s.v, u, p) + sliding.frictionless_acceleration(
            0.0, s.x, pushes.extra
        )

    @specialised
    def total(s: Motion, side: float, u: float, part: Any) -> float:
        pushes = part[1]
        return frictionless(s, u, part) - friction.friction(
            s.x, s.v, s.bend, pushes.load * abs(u), pushes.law
        )

    @specialised
    def pull_and_hold(s: Motion, u: float, part: Any) -> tuple[float, float]:
        pushes = part[1]
        load = pushes.load * abs(u)
        return friction.pull_and_hold(frictionless(s, u, part), s.x, s.bend, load, pushes.law)

    @specialised
    def first_bend(s: Motion, u: float, part: Any) -> float:
        pushes = part[1]
        return friction.first_bend(frictionless(s, u, part), s.x, s.v, pushes.load * abs(u), pushes.law)

    max_step = _compile_max_step(total)
    return Laws(
        total, _no_target, _no_follower, _no_value, pull_and_hold, max_step, _no_damping, _part_at,
        _bend_after, first_bend,
    )  # fmt: skip


def _compile_max_step(
    total: Callable[[Motion, float, float, Any], float],
) -> Callable[[Motion, float, float, float, float, Follows, float, Any], float]:
    """Compile the longest step, s, of a part whose acceleration is ``total``."""

    @specialised
    def max_step(
        s: Motion, side: float, u: float, rise: float, since: float, lag: Follows, finest: float, part: Any
    ) -> float:
        if side == 0.0:
            return np.inf
        pushes = part[1]
        extra = pushes.extra
        bend = extra.cogging_order * (abs(extra.cogging_sine) + abs(extra.cogging_cosine))
        stiff = pushes.stiff + abs(extra.spring + 3.0 * extra.hardening * s.x * s.x) + abs(bend)
        size = min(
            sliding.MAX_STEP_OF_OSCILLATION / np.sqrt(stiff + TINY),
            friction.MAX_STEP_SHARE / (pushes.quick + TINY),
        )
        size = min(size, friction.max_friction_step(s.v, side, s.bend, total(s, side, u, part), pushes.law))
        if bend != 0.0:
            size = min(size, friction.MAX_STEP_SHARE / (abs(extra.cogging_order * s.v) + TINY))
        return max(size, finest)

    return max_step


@specialised
def _no_value(s: Motion, u: float, part: Any) -> float:
    return 0.0


@specialised
def _no_target(s: Motion, u: float, lag: Follows, part: Any) -> float:
    return 0.0


@specialised
def _no_follower(s: Motion, u: float, part: Any) -> Follows:
    return Follows(0.0, 0.0, 0.0, 0.0)


@specialised
def _no_damping(s: Motion, side: float, part: Any) -> tuple[float, float]:
    # the damping of f is not known: it is resolved by small steps and never counts as creeping
    return 0.0, 0.0


@specialised
def _bend_after(bend: float, side: float, way: float, part: Any) -> float:
    return friction.bend_after(bend, side, way, part[1].law)


@specialised
def _part_at(part: Any, course: Any, k: int) -> Any:
    """The part between samples k and k + 1."""
    p, of = part
    law = friction.scale_viscous(course.law, course.change[k])
    return p, Pushes(of.extra, law, of.share, of.load, of.stiff, of.quick)
