"""The friction law of one moving part, on an array of strengths that are divided by its inertia.

Eq. 4.6 and 4.17 of the reference text with the minus sign in the Stribeck exponent: levels add up, so the
Stribeck level is what creeping friction exceeds Coulomb friction by; every strength is neutral at zero.
"""

from __future__ import annotations

import numpy as np

from labhil.compiled import compiled
from labhil.signals import FloatArray

(
    VISCOUS,
    COULOMB,
    STATIC,
    STRIBECK,
    STRIBECK_VELOCITY,
    QUADRATIC,
    CUBIC,
    ASYMMETRIC_VISCOUS,
    ASYMMETRIC_LEVEL,
    DRY_SLOPE,
) = range(10)
SIZE = 10

NAMES = {
    VISCOUS: "viscous_friction.coefficient",
    COULOMB: "coulomb_friction.level",
    STATIC: "static_friction.level",
    STRIBECK: "stribeck_friction.level",
    QUADRATIC: "quadratic_viscous_friction.coefficient",
    CUBIC: "cubic_viscous_friction.coefficient",
    ASYMMETRIC_VISCOUS: "friction_asymmetry.coefficient",
    ASYMMETRIC_LEVEL: "friction_asymmetry.level",
    DRY_SLOPE: "position_dependent_friction.slope",
}
"""Parameters of the places, all but the Stribeck velocity in units of force."""

NARROW = 30.0
SHORTEST_STEP = 2e-4


@compiled
def hold(x: float, side: float, f: FloatArray) -> float:
    """Drive towards ``side`` that a part at rest at ``x`` just withstands; never negative."""
    level = f[COULOMB] + f[STRIBECK] + f[STATIC] + side * f[ASYMMETRIC_LEVEL] + f[DRY_SLOPE] * x
    return max(level, 0.0)


@compiled
def friction(x: float, v: float, side: float, f: FloatArray) -> float:
    """Deceleration of a part that moves towards ``side`` with ``v``."""
    speed = abs(v)
    dry = f[COULOMB] + side * f[ASYMMETRIC_LEVEL] + f[DRY_SLOPE] * x
    if f[STRIBECK] != 0.0 and speed < NARROW * f[STRIBECK_VELOCITY]:
        dry += f[STRIBECK] * np.exp(-speed / f[STRIBECK_VELOCITY])
    viscous = v * (f[VISCOUS] + f[QUADRATIC] * speed + f[CUBIC] * v * v) + f[ASYMMETRIC_VISCOUS] * speed
    return side * dry + viscous


@compiled
def longest_step(v: float, pull: float, longest: float, f: FloatArray) -> float:
    """How far one step may go at acceleration ``pull``: a narrow Stribeck peak must not be jumped over."""
    speed = abs(v)
    stiffness = abs(f[VISCOUS]) + 2.0 * abs(f[QUADRATIC]) * speed + 3.0 * abs(f[CUBIC]) * v * v
    h = longest
    if f[STRIBECK] != 0.0:
        width = f[STRIBECK_VELOCITY]
        stiffness += abs(f[STRIBECK]) / (width * (1.0 + speed * speed / (width * width)))
        h = min(h, 0.5 * (width + 0.25 * speed) / (abs(pull) + 1e-9))
    return max(min(h, 0.5 / (stiffness + 1e-9)), SHORTEST_STEP)
