"""The friction law of one moving part as compiled functions of an array of coefficients.

F(x, v) = sgn v·[F_c + s·x + μ·|F_drive| + F_st·exp(−|v|/v_s)] + c·v + c₂·v·|v| + c₃·v³ + c_a·|v|

with position x and velocity v; Coulomb level F_c, its slope s along the position, load coefficient μ (1) on
the force of the drive, Stribeck level F_st (friction at creeping speed above the Coulomb level) and velocity
v_s; viscous coefficients c, c₂, c₃ and asymmetry c_a. At rest the part holds up to F_c + s·x + μ·|F_drive| +
F_st + static level. SI units; all but v_s and μ are divided by the inertia here, and zero where absent.
Equations 4.6 and 4.17 of the reference text, with the minus sign in the Stribeck exponent.
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
"""Parameters of these places that are divided by the inertia."""

NAMES_WITHOUT_INERTIA = {
    STRIBECK_VELOCITY: "stribeck_friction.velocity",
    LOAD_SHARE: "load_dependent_friction.coefficient",
}
"""Parameters of these places that are not divided by the inertia."""

STRIBECK_RANGE = 30.0
"""Speed, in Stribeck velocities, above which the Stribeck peak counts as zero (e^−30)."""

MAX_STEP_SHARE = 0.3
"""Longest step, as a share of a time constant or of the width of the Stribeck peak."""

Law = tuple[float, float, float, float, float, float, float, float, float, float]
"""Coefficients in the order of the places, as kernels hold them."""


@inlined
def law_from_array(f: FloatArray) -> Law:
    """Coefficients of an array (10,)."""
    return f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8], f[9]


@inlined
def scale_viscous(f: Law, change: float) -> Law:
    """Multiply viscous friction by ``change``."""
    return f[0] * change, f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8], f[9]


@inlined
def break_away_force(x: float, load: float, f: Law) -> float:
    """Break-away force over the inertia of a part at rest at ``x`` under ``load``; never negative."""
    return max(f[COULOMB] + f[STRIBECK] + f[STATIC] + f[DRY_SLOPE] * x + f[LOAD_SHARE] * load, 0.0)


@inlined
def friction(x: float, v: float, side: float, load: float, f: Law) -> float:
    """Friction over the inertia of a part that moves towards ``side`` (±1) with ``v``.

    ``load`` is the absolute force of its drive over the inertia.
    """
    speed = abs(v)
    dry = f[COULOMB] + f[DRY_SLOPE] * x + f[LOAD_SHARE] * load
    if f[STRIBECK] != 0.0 and speed < STRIBECK_RANGE * f[STRIBECK_VELOCITY]:
        dry += f[STRIBECK] * np.exp(-speed / f[STRIBECK_VELOCITY])
    viscous = v * (f[VISCOUS] + f[QUADRATIC] * speed + f[CUBIC] * v * v) + f[ASYMMETRIC_VISCOUS] * speed
    return side * dry + viscous


@inlined
def damping(v: float, side: float, f: Law) -> tuple[float, float]:
    """Slope of friction by velocity, 1/s, and a bound of its second derivative, 1/m."""
    speed, peak = abs(v), 0.0
    if f[STRIBECK] != 0.0 and speed < STRIBECK_RANGE * f[STRIBECK_VELOCITY]:
        peak = f[STRIBECK] / f[STRIBECK_VELOCITY] * np.exp(-speed / f[STRIBECK_VELOCITY])
    rate = f[VISCOUS] + 2.0 * f[QUADRATIC] * speed + 3.0 * f[CUBIC] * v * v + side * f[ASYMMETRIC_VISCOUS]
    bend = 2.0 * abs(f[QUADRATIC]) + 6.0 * abs(f[CUBIC]) * speed
    return rate - peak, bend + (abs(peak) / f[STRIBECK_VELOCITY] if peak != 0.0 else 0.0)


@inlined
def max_friction_step(v: float, pull: float, f: Law) -> float:
    """Longest step at acceleration ``pull``, s: it must not jump over a narrow Stribeck peak."""
    speed = abs(v)
    stiffness = abs(f[VISCOUS]) + 2.0 * abs(f[QUADRATIC]) * speed + 3.0 * abs(f[CUBIC]) * v * v
    longest = np.inf
    if f[STRIBECK] != 0.0:
        width = f[STRIBECK_VELOCITY]
        if speed < STRIBECK_RANGE * width:
            stiffness += abs(f[STRIBECK]) / width * np.exp(-speed / width)
        longest = MAX_STEP_SHARE * (width + 0.3 * max(speed - width, 0.0)) / (abs(pull) + 1e-300)
    return min(longest, MAX_STEP_SHARE / (stiffness + 1e-300))
