"""A simulator's own acceleration together with the catalogue's forces, at the port of its coordinate.

v̇ = share·f(x, v, u) + (F₀ − k·x − k₃·x³ − cogging − friction)/M: rest is an event (``physics.stick_slip``),
so dry friction at the coordinate is solved and not smoothed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from labhil.compiled import specialised
from labhil.physics import friction, sliding
from labhil.physics.friction import Law
from labhil.physics.moving_part import TINY, Follows, Laws, Motion

Acceleration = Callable[[float, float, float, Any], float]
"""(x, v, u, p) to the acceleration of the coordinate."""


class Pushes(NamedTuple):
    """Everything over the inertia M: added forces, friction, and the share that f keeps of its own.

    ``load`` turns the size of the input into the load on what rubs. ``stiff`` and ``quick`` are bounds of
    what f changes with position (1/s²) and velocity (1/s).
    """

    extra: sliding.Part
    law: Law
    share: float
    load: float
    stiff: float
    quick: float


class Course(NamedTuple):
    """Nothing changes along a recording."""

    nothing: float


def laws_of(acceleration: Acceleration) -> Laws[Any, Any]:
    """Make the physics of the coordinate; a part is (what ``acceleration`` takes for p, pushes).

    Args:
        acceleration: Compiled ``(x, v, u, p)`` to the simulator's own acceleration.

    Returns:
        The laws, as :func:`physics.stick_slip.integrator` takes them.
    """

    @specialised
    def free(s: Motion, u: float, part: Any) -> float:
        p, pushes = part
        return pushes.share * acceleration(s.x, s.v, u, p) + sliding.drive_acceleration(
            0.0, s.x, pushes.extra
        )

    @specialised
    def pull(s: Motion, side: float, u: float, part: Any) -> float:
        pushes = part[1]
        return free(s, u, part) - friction.friction(s.x, s.v, side, pushes.load * abs(u), pushes.law)

    @specialised
    def grip(s: Motion, u: float, part: Any) -> tuple[float, float]:
        pushes = part[1]
        return free(s, u, part), friction.hold(s.x, pushes.load * abs(u), pushes.law)

    @specialised
    def none(s: Motion, u: float, part: Any) -> float:
        return 0.0

    @specialised
    def target(s: Motion, u: float, how: Follows, part: Any) -> float:
        return 0.0

    @specialised
    def follow(s: Motion, part: Any) -> Follows:
        return Follows(0.0, 0.0, 0.0, 0.0)

    @specialised
    def longest(
        s: Motion, side: float, u: float, rise: float, since: float, how: Follows, finest: float, part: Any
    ) -> float:
        if side == 0.0:
            return np.inf
        pushes = part[1]
        extra = pushes.extra
        bend = extra.cogging_order * (abs(extra.cogging_sine) + abs(extra.cogging_cosine))
        stiff = pushes.stiff + abs(extra.spring + 3.0 * extra.hardening * s.x * s.x) + abs(bend)
        size = min(sliding.SHARE_OF_SWING / np.sqrt(stiff + TINY), friction.RESOLVED / (pushes.quick + TINY))
        size = min(size, friction.pace(s.v, pull(s, side, u, part), pushes.law))
        if bend != 0.0:
            size = min(size, friction.RESOLVED / (abs(extra.cogging_order * s.v) + TINY))
        return max(size, finest)

    @specialised
    def no_damping(s: Motion, side: float, part: Any) -> tuple[float, float]:
        # f's own damping is not known: it is followed by small steps and never counts as creeping
        return 0.0, 0.0

    @specialised
    def at(part: Any, course: Any, k: int) -> Any:
        return part

    return Laws(pull, target, follow, none, grip, longest, no_damping, at)
