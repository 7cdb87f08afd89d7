"""Joint torques beside the rigid body (friction, ripple, inertia) as columns that parameters multiply.

A column is computed at the full sampling rate, passes the filter of the currents and is then read at the rows
of a record. Dry friction acts along a direction s from −1 to 1: sgn q̇, or, with a presliding length ℓ (rad),
ds = (dq − s·|dq|)/ℓ (Dahl 1968), which after a reversal changes its sign over a way of about ℓ and keeps its
value while the joint is at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from labhil.compiled import inlined
from labhil.physics import friction_law
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class JointMotion:
    """Motion of one joint, (n,) each, and the value of the shape parameter of a law.

    ``q`` rad, ``qd`` rad/s, ``qdd`` rad/s², ``warmer`` K above the reference temperature, ``direction`` of
    dry friction from −1 to 1. ``shape`` is the value of ``Law.shaped_by``, in which the law is not linear.
    """

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    warmer: FloatArray
    direction: FloatArray
    shape: float


@dataclass(frozen=True, slots=True)
class Law:
    """Torque (n,) per unit of a linear parameter; ``dry`` laws depend on the direction of dry friction."""

    column: Callable[[JointMotion], FloatArray]
    shaped_by: str | None = None
    dry: bool = False


BUILT_IN: Mapping[str, Law] = {
    "viscous_friction.coefficient": Law(
        lambda m: m.qd * np.exp(-m.shape * m.warmer), shaped_by="temperature_dependent_friction.rate"
    ),
    "coulomb_friction.level": Law(lambda m: m.direction, dry=True),
    "stribeck_friction.level": Law(
        lambda m: m.direction * np.exp(-np.abs(m.qd) / m.shape),
        shaped_by="stribeck_friction.velocity",
        dry=True,
    ),
    "quadratic_viscous_friction.coefficient": Law(lambda m: m.qd * np.abs(m.qd)),
    "cubic_viscous_friction.coefficient": Law(lambda m: m.qd**3),
    "friction_asymmetry.coefficient": Law(lambda m: np.abs(m.qd)),
    "position_dependent_friction.slope": Law(lambda m: m.direction * m.q, dry=True),
    "torque_ripple.sine": Law(lambda m: np.sin(m.shape * m.q), shaped_by="torque_ripple.order"),
    "torque_ripple.cosine": Law(lambda m: np.cos(m.shape * m.q), shaped_by="torque_ripple.order"),
    "added_inertia.inertia": Law(lambda m: m.qdd),
}


def laws() -> Mapping[str, Law]:
    """All laws of a joint by linear parameter: built-in laws, then user-defined ones."""
    return {**BUILT_IN, **{law.coefficient: _of_speed(law) for law in friction_law.laws()}}


def _of_speed(law: friction_law.FrictionLaw) -> Law:
    """Convert a user-defined friction law."""
    return Law(lambda m: m.direction * law.values(np.abs(m.qd), m.shape), law.shaped_by, dry=True)


def directions(q: FloatArray, qd: FloatArray, length: float) -> FloatArray:
    """Direction of dry friction along a motion.

    Args:
        q: Angles, (n,), rad.
        qd: Velocities, (n,), rad/s.
        length: Presliding length, rad; 0 for the sign of the velocity.

    Returns:
        Direction from −1 to 1, (n,).
    """
    out = np.empty(len(q))
    fill_directions(np.ascontiguousarray(q), np.ascontiguousarray(qd), length, out)
    return out


@inlined
def fill_directions(q: FloatArray, qd: FloatArray, length: float, out: FloatArray) -> None:
    """Fill ``out`` (n,) with :func:`directions`."""
    s = np.sign(qd[0])
    for n in range(len(q)):
        if length <= 0.0:
            s = np.sign(qd[n]) if qd[n] != 0.0 else s
        elif n > 0:
            way = q[n] - q[n - 1]
            side = np.sign(way)
            s = side + (s - side) * np.exp(-abs(way) / length)
        out[n] = s
