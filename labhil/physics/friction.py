"""The friction law of one moving part as compiled functions of an array of coefficients.

F(x, v) = b·[F_c + s·x + μ·|F_drive| + F_st·exp(−|v|/v_s)] + c·v + c₂·v·|v| + c₃·v³ + c_a·|v|

with position x and velocity v; Coulomb level F_c, its slope s along the position, load coefficient μ (1) on
the force of the drive, Stribeck level F_st (friction at creeping speed above the Coulomb level) and velocity
v_s; viscous coefficients c, c₂, c₃ and asymmetry c_a. b is sgn v, and a part at rest holds up to F_c + s·x +
μ·|F_drive| + F_st + static level. With a presliding length ℓ, b is the share of it that bristles with a
time constant carry (``physics.bristles``), and these do not hold. SI units; all but v_s, μ, ℓ and the time
constant are divided by the inertia here, and zero where absent.
Equations 4.6 and 4.17 of the reference text, with the minus sign in the Stribeck exponent.
"""

from __future__ import annotations

import numpy as np

from labhil.compiled import inlined
from labhil.physics import bristles
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
    BRISTLE_TIME,
    PRESLIDING_LENGTH,
) = range(12)
SIZE = 12

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
    BRISTLE_TIME: "presliding_friction.time_constant",
    PRESLIDING_LENGTH: "presliding_friction.length",
}
"""Parameters of these places that are not divided by the inertia."""

DRY = (COULOMB, STRIBECK, DRY_SLOPE, LOAD_SHARE)
"""Places of dry friction; bristles bend under no other, and do nothing without it."""

STRIBECK_RANGE = 30.0
"""Speed, in Stribeck velocities, above which the Stribeck peak counts as zero (e^−30)."""

MAX_STEP_SHARE = 0.3
"""Longest step, as a share of a time constant or of the width of the Stribeck peak."""

Law = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float
]  # fmt: skip
"""Coefficients in the order of the places, as kernels hold them."""


@inlined
def law_from_array(f: FloatArray) -> Law:
    """Coefficients of an array (12,)."""
    return f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8], f[9], f[10], f[11]


@inlined
def scale_viscous(f: Law, change: float) -> Law:
    """Multiply viscous friction by ``change``."""
    return f[0] * change, f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8], f[9], f[10], f[11]


@inlined
def dry_friction(x: float, speed: float, load: float, f: Law) -> float:
    """Dry friction over the inertia at ``x`` and ``speed``, with the drive's absolute force ``load``."""
    dry = f[COULOMB] + f[DRY_SLOPE] * x + f[LOAD_SHARE] * load
    if f[STRIBECK] != 0.0 and speed < STRIBECK_RANGE * f[STRIBECK_VELOCITY]:
        dry += f[STRIBECK] * np.exp(-speed / f[STRIBECK_VELOCITY])
    return dry


@inlined
def friction(x: float, v: float, bend: float, load: float, f: Law) -> float:
    """Friction over the inertia of a part that moves with ``v`` on bristles with this bend.

    ``load`` is the absolute force of its drive over the inertia.
    """
    speed = abs(v)
    viscous = v * (f[VISCOUS] + f[QUADRATIC] * speed + f[CUBIC] * v * v) + f[ASYMMETRIC_VISCOUS] * speed
    share = bristles.share_of_dry_friction(v, bend, f[PRESLIDING_LENGTH], f[BRISTLE_TIME])
    return share * dry_friction(x, speed, load, f) + viscous


@inlined
def pull_and_hold(drive: float, x: float, bend: float, load: float, f: Law) -> tuple[float, float]:
    """Acceleration of a part at rest by all but a hold, and the one up to which it holds; never negative.

    ``drive`` is the acceleration without friction. Bristles do not hold: they pull.
    """
    if f[PRESLIDING_LENGTH] > 0.0:
        return drive - bend * dry_friction(x, 0.0, load, f), 0.0
    return drive, max(dry_friction(x, 0.0, load, f) + f[STATIC], 0.0)


@inlined
def bend_after(bend: float, side: float, way: float, f: Law) -> float:
    """Bend of the bristles after a way towards ``side``; ``side`` itself where there are none."""
    return bristles.bend_after(bend, side, way, f[PRESLIDING_LENGTH])


@inlined
def first_bend(drive: float, x: float, v: float, load: float, f: Law) -> float:
    """Bend of the bristles at the start of a window; ``drive`` is the acceleration without friction."""
    return bristles.first_bend(drive, v, dry_friction(x, abs(v), load, f), f[PRESLIDING_LENGTH])


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
def max_friction_step(v: float, side: float, bend: float, pull: float, f: Law) -> float:
    """Longest step at acceleration ``pull``, s: it must not jump over a narrow Stribeck peak, or bristles."""
    speed = abs(v)
    stiffness = abs(f[VISCOUS]) + 2.0 * abs(f[QUADRATIC]) * speed + 3.0 * abs(f[CUBIC]) * v * v
    longest = np.inf
    if f[STRIBECK] != 0.0:
        width = f[STRIBECK_VELOCITY]
        if speed < STRIBECK_RANGE * width:
            stiffness += abs(f[STRIBECK]) / width * np.exp(-speed / width)
        longest = MAX_STEP_SHARE * (width + 0.3 * max(speed - width, 0.0)) / (abs(pull) + 1e-300)
    dry, left = f[COULOMB] + f[STRIBECK], abs(side - bend)
    on_bristles = bristles.max_step(v, left, dry, f[PRESLIDING_LENGTH], f[BRISTLE_TIME])
    longest = min(longest, on_bristles)
    return min(longest, MAX_STEP_SHARE / (stiffness + 1e-300))
