"""What the joints add to the rigid body's torque, as columns that parameters multiply.

Every column is computed at the full rate of the motion, passes the filter of the currents and is then
read at the rows of a record. Dry friction points along a direction s of size one: sgn q̇, or, with a
presliding length ℓ, the bristles' ds = (dq − s·|dq|)/ℓ (Dahl 1968), which after a reversal turn over a way
of about ℓ and hold what they had while the joint rests.
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
    """Angle rad, velocity rad/s, acceleration rad/s², K above the reference, direction; (n,) each.

    ``shape`` is what its law depends on in another way than in proportion: the value of ``shaped_by``.
    """

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    warmer: FloatArray
    direction: FloatArray
    shape: float


@dataclass(frozen=True, slots=True)
class Law:
    """Torque per unit of one linear parameter, (n,); ``dry`` laws depend on the direction of friction."""

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
    """All laws of a joint by their linear parameter, those of one's own behind labhil's."""
    return {**BUILT_IN, **{law.coefficient: _of_speed(law) for law in friction_law.laws()}}


def _of_speed(law: friction_law.FrictionLaw) -> Law:
    return Law(lambda m: m.direction * law.values(np.abs(m.qd), m.shape), law.shaped_by, dry=True)


def directions(q: FloatArray, qd: FloatArray, length: float) -> FloatArray:
    """Direction (n,) from −1 to 1 of dry friction against a motion (n,); ``length`` rad of its bristles."""
    out = np.empty(len(q))
    turn(np.ascontiguousarray(q), np.ascontiguousarray(qd), length, out)
    return out


@inlined
def turn(q: FloatArray, qd: FloatArray, length: float, out: FloatArray) -> None:
    """Fill ``out`` (n,); see :func:`directions`."""
    s = np.sign(qd[0])
    for n in range(len(q)):
        if length <= 0.0:
            s = np.sign(qd[n]) if qd[n] != 0.0 else s
        elif n > 0:
            way = q[n] - q[n - 1]
            side = np.sign(way)
            s = side + (s - side) * np.exp(-abs(way) / length)
        out[n] = s
