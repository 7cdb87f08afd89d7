"""Friction of one simulated part: an event-based law, or presliding by bristles or elements.

The event-based law has two modes. A part that moves towards ``side`` (±1) feels the dry level for
that side; a part at rest (side 0) feels whatever keeps it there, up to the hold. Bristles (LuGre), or the
elements of :mod:`labhil.plants.maxwell`, take the place of that law; both bend up to the same level.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from labhil.compiled import compiled

STATIC_VELOCITY = 1e-3
"""Speed (m/s) over which bristles and elements lose the extra static friction."""
MIN_LEVEL = 1e-9
MIN_LEVEL_SHARE = 1e-3
"""Dry level, N and over that at rest, below which bristles have no force: they would relax without end."""
ELEMENTS = 4
"""Number of elements of the generalised Maxwell-slip model."""


class Friction(NamedTuple):
    """Strengths of all friction effects (SI); zero where an effect is absent.

    Bristles and elements share ``stiffness`` and ``damping``, and only elements have an ``attraction``.
    ``stiffest`` is the first element's part of the stiffness, ``softening`` each one's over that before.
    """

    viscous: float
    quadratic: float
    cubic: float
    asymmetric: float
    coulomb: float
    stribeck: float
    stribeck_velocity: float
    static: float
    asymmetric_level: float
    slope: float
    stiffness: float
    damping: float
    attraction: float
    stiffest: float
    softening: float

    @classmethod
    def of(cls, values: Mapping[str, float]) -> Friction:
        """Take them from the parameters of a plant."""
        attraction = values.get("maxwell_slip_friction.attraction", 0.0)
        carrier = "maxwell_slip_friction" if attraction else "presliding_friction"
        stiffness = values.get(f"{carrier}.stiffness", 0.0)
        softening = values.get("maxwell_slip_friction.spread", 1.0) ** (-1.0 / (ELEMENTS - 1))
        return cls(
            viscous=values.get("viscous_friction.coefficient", 0.0),
            quadratic=values.get("quadratic_viscous_friction.coefficient", 0.0),
            cubic=values.get("cubic_viscous_friction.coefficient", 0.0),
            asymmetric=values.get("friction_asymmetry.coefficient", 0.0),
            coulomb=values.get("coulomb_friction.level", 0.0),
            stribeck=values.get("stribeck_friction.level", 0.0),
            stribeck_velocity=values.get("stribeck_friction.velocity", 1.0),
            static=values.get("static_friction.level", 0.0),
            asymmetric_level=values.get("friction_asymmetry.level", 0.0),
            slope=values.get("position_dependent_friction.slope", 0.0),
            stiffness=stiffness,
            damping=values.get(f"{carrier}.damping", 0.0),
            attraction=attraction,
            stiffest=stiffness / sum(softening**i for i in range(ELEMENTS)),
            softening=softening,
        )


@compiled
def side_of(v: float) -> float:
    """Return +1 or −1 for a part that moves with v (m/s), 0 for one at rest."""
    if v == 0.0:
        return 0.0
    return 1.0 if v > 0.0 else -1.0


@compiled
def dry_level(x: float, speed: float, side: float, f: Friction, extra_level: float = 0.0) -> float:
    """Return the dry friction (N) of a part at x (m) that moves towards ``side``; never negative.

    ``extra_level`` (N) is friction of the rig: by a load, or of a sticky patch.
    """
    level = f.coulomb + side * f.asymmetric_level + f.slope * x + extra_level
    if f.stribeck != 0.0:
        level += f.stribeck * math.exp(-speed / f.stribeck_velocity)
    return max(level, 0.0)


@compiled
def hold_level(x: float, side: float, f: Friction, extra_level: float = 0.0) -> float:
    """Return the static friction (N) against a force towards ``side`` of a part at rest at x (m)."""
    return dry_level(x, 0.0, side, f, extra_level) + max(f.static, 0.0)


@compiled
def viscous_force(v: float, f: Friction) -> float:
    """Return the resistance (N) at velocity v (m/s) that vanishes at rest."""
    speed = abs(v)
    return v * (f.viscous + speed * (f.quadratic + f.cubic * speed)) + f.asymmetric * speed


@compiled
def resistance(x: float, v: float, side: float, f: Friction, extra_level: float = 0.0) -> float:
    """Return the whole friction (N) of a part that moves towards ``side``."""
    return side * dry_level(x, abs(v), side, f, extra_level) + viscous_force(v, f)


@compiled
def on_bristles(f: Friction) -> bool:
    """Whether bristles replace the event-based law, so that friction has no events."""
    return f.stiffness > 0.0 and f.attraction == 0.0


@compiled
def bristle_level(x: float, v: float, side: float, f: Friction, extra_level: float = 0.0) -> float:
    """Return the dry friction (N) that bristles or elements bend up to at velocity v (m/s)."""
    speed = abs(v)
    return dry_level(x, speed, side, f, extra_level) + f.static * math.exp(-speed / STATIC_VELOCITY)


@compiled
def slips_freely(level: float, f: Friction) -> bool:
    """Whether the dry level is so low that bristles have no force."""
    return level < max(MIN_LEVEL, MIN_LEVEL_SHARE * (abs(f.coulomb) + abs(f.stribeck) + abs(f.static)))


@compiled
def bristle_rate(z: float, v: float, level: float, f: Friction) -> float:
    """Return how fast bristles bend (m/s), ż = v − (σ₀|v|/g)·z, where they bend up to ``level`` (N)."""
    return 0.0 if slips_freely(level, f) else v - f.stiffness * abs(v) / level * z


@compiled
def relax_bristles(z: float, v: float, level: float, h: float, f: Friction) -> float:
    """Return the bristles' deflection (m) after h (s) at constant v and level, solved exactly."""
    if slips_freely(level, f):
        return 0.0
    rate = f.stiffness * abs(v) / level
    if rate * h < 1e-12:
        return z + v * h
    settled = v / rate
    return settled + (z - settled) * math.exp(-rate * h)


@compiled
def bristle_force(z: float, v: float, level: float, f: Friction) -> float:
    """Return the dry friction (N) of bristles bent by z (m): σ₀·z + σ₁·ż."""
    return 0.0 if slips_freely(level, f) else f.stiffness * z + f.damping * bristle_rate(z, v, level, f)
