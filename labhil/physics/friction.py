"""The friction law of one moving part, on an array of strengths that are divided by its inertia.

Eq. 4.6 and 4.17 of the reference text with the minus sign in the Stribeck exponent: levels add up, so the
Stribeck level is what creeping friction exceeds Coulomb friction by; every strength is neutral at zero.
"""

from __future__ import annotations

import numpy as np

from labhil.compiled import inlined
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
    DRY_SLOPE,
    LOAD_SHARE,
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
    DRY_SLOPE: "position_dependent_friction.slope",
}
"""Parameters of the places, in units of force."""

PURE = {
    STRIBECK_VELOCITY: "stribeck_friction.velocity",
    LOAD_SHARE: "load_dependent_friction.coefficient",
}
"""Parameters that are not divided by the inertia."""

NARROW = 30.0
"""Stribeck velocities beyond which nothing is left of the Stribeck level."""

RESOLVED = 0.3
"""Share of a time constant, or of the width of a Stribeck peak, that one step may pass."""

Law = tuple[float, float, float, float, float, float, float, float, float, float]
"""Strengths in the order of the places, as kernels hold them."""


@inlined
def law_of(f: FloatArray) -> Law:
    """The strengths of an array (10,)."""
    return f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8], f[9]


@inlined
def scale_viscous(f: Law, change: float) -> Law:
    """The same law with viscous friction times ``change``."""
    return f[0] * change, f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8], f[9]


@inlined
def hold(x: float, load: float, f: Law) -> float:
    """Largest pull that a part at rest at ``x`` under ``load`` withstands; never negative."""
    return max(f[COULOMB] + f[STRIBECK] + f[STATIC] + f[DRY_SLOPE] * x + f[LOAD_SHARE] * load, 0.0)


@inlined
def friction(x: float, v: float, side: float, load: float, f: Law) -> float:
    """Deceleration of a part that moves towards ``side`` with ``v``; ``load`` is the size of its drive."""
    speed = abs(v)
    dry = f[COULOMB] + f[DRY_SLOPE] * x + f[LOAD_SHARE] * load
    if f[STRIBECK] != 0.0 and speed < NARROW * f[STRIBECK_VELOCITY]:
        dry += f[STRIBECK] * np.exp(-speed / f[STRIBECK_VELOCITY])
    viscous = v * (f[VISCOUS] + f[QUADRATIC] * speed + f[CUBIC] * v * v) + f[ASYMMETRIC_VISCOUS] * speed
    return side * dry + viscous


@inlined
def damping(v: float, side: float, f: Law) -> tuple[float, float]:
    """How fast friction rises with velocity, 1/s, and at most how fast that changes with it, 1/m."""
    speed, peak = abs(v), 0.0
    if f[STRIBECK] != 0.0 and speed < NARROW * f[STRIBECK_VELOCITY]:
        peak = f[STRIBECK] / f[STRIBECK_VELOCITY] * np.exp(-speed / f[STRIBECK_VELOCITY])
    rate = f[VISCOUS] + 2.0 * f[QUADRATIC] * speed + 3.0 * f[CUBIC] * v * v + side * f[ASYMMETRIC_VISCOUS]
    bend = 2.0 * abs(f[QUADRATIC]) + 6.0 * abs(f[CUBIC]) * speed
    return rate - peak, bend + (abs(peak) / f[STRIBECK_VELOCITY] if peak != 0.0 else 0.0)


@inlined
def pace(v: float, pull: float, f: Law) -> float:
    """How long one step may be (s) at acceleration ``pull``: it must not jump over a narrow Stribeck peak."""
    speed = abs(v)
    stiffness = abs(f[VISCOUS]) + 2.0 * abs(f[QUADRATIC]) * speed + 3.0 * abs(f[CUBIC]) * v * v
    longest = np.inf
    if f[STRIBECK] != 0.0:
        width = f[STRIBECK_VELOCITY]
        if speed < NARROW * width:
            stiffness += abs(f[STRIBECK]) / width * np.exp(-speed / width)
        longest = RESOLVED * (width + 0.3 * max(speed - width, 0.0)) / (abs(pull) + 1e-300)
    return min(longest, RESOLVED / (stiffness + 1e-300))
