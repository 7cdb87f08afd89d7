"""Friction of the simulated joints, and their heating.

The motion is given, so dry friction needs no events: a moving joint has its level against the motion; one
that stops keeps its friction until it has moved by ``STICKING_ANGLE`` again. Bristles replace that law.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from labhil.compiled import compiled
from labhil.plants.arm.effects import Values
from labhil.signals import FloatArray

STICKING_ANGLE = 1e-6
"""Angle (rad) from full dry friction in one direction to none, and again to full in the other."""
STATIC_VELOCITY = 1e-3
"""Speed (rad/s) over which the extra static friction is lost."""
MIN_LEVEL = 1e-9
"""Dry level (N·m) below which bristles have no torque."""
N_SUBSTEPS = 8
"""Substeps between two samples for the memory of friction."""


class Friction(NamedTuple):
    """Parameters of all friction effects, (6,) each (SI, eq. 4.64 and more); zero where one is absent."""

    viscous: FloatArray
    quadratic: FloatArray
    cubic: FloatArray
    asymmetric: FloatArray
    coulomb: FloatArray
    stribeck: FloatArray
    stribeck_velocity: FloatArray
    static: FloatArray
    asymmetric_level: FloatArray
    slope: FloatArray
    load: FloatArray
    patch: FloatArray
    patch_centre: FloatArray
    patch_width: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    viscosity_rate: FloatArray
    reference: FloatArray

    @classmethod
    def of(cls, values: Values) -> Friction:
        """Pick them out of a plant's parameters."""
        return cls(
            viscous=values.per_joint("viscous_friction.coefficient"),
            quadratic=values.per_joint("quadratic_viscous_friction.coefficient"),
            cubic=values.per_joint("cubic_viscous_friction.coefficient"),
            asymmetric=values.per_joint("friction_asymmetry.coefficient"),
            coulomb=values.per_joint("coulomb_friction.level"),
            stribeck=values.per_joint("stribeck_friction.level"),
            stribeck_velocity=values.per_joint("stribeck_friction.velocity", 1.0),
            static=values.per_joint("static_friction.level"),
            asymmetric_level=values.per_joint("friction_asymmetry.level"),
            slope=values.per_joint("position_dependent_friction.slope"),
            load=values.per_joint("load_dependent_friction.coefficient"),
            patch=values.per_joint("hidden_sticky_patch.level"),
            patch_centre=values.per_joint("hidden_sticky_patch.centre"),
            patch_width=values.per_joint("hidden_sticky_patch.width", 1.0),
            stiffness=values.per_joint("presliding_friction.stiffness"),
            damping=values.per_joint("presliding_friction.damping"),
            viscosity_rate=values.per_joint("temperature_dependent_friction.rate"),
            reference=values.per_joint("temperature_dependent_friction.reference"),
        )


class ThermalModel(NamedTuple):
    """Heating of the joints: K/W (6,), s, °C, Ω (6,), N·m/A (6,)."""

    warming: FloatArray
    time: float
    ambient: float
    resistance: FloatArray
    torque_constant: FloatArray

    @classmethod
    def of(cls, values: Values) -> ThermalModel:
        """Pick it out of a plant's parameters."""
        return cls(
            warming=values.per_joint("warming"),
            time=values.number("warming_time"),
            ambient=values.number("ambient_temperature"),
            resistance=values.per_joint("winding_resistance"),
            torque_constant=values.per_joint("torque_constant"),
        )


class JointMemory(NamedTuple):
    """State of the joints' friction, (6,) each.

    Attributes:
        angle: At the last sample, rad.
        velocity: At the last sample, rad/s.
        sticking: Dry friction over its level, −1 to 1.
        bristle: Deflection, rad.
        temperature: °C.
    """

    angle: FloatArray
    velocity: FloatArray
    sticking: FloatArray
    bristle: FloatArray
    temperature: FloatArray


@compiled
def dry_level(q: float, speed: float, side: float, load: float, j: int, f: Friction) -> float:
    """Return the dry friction (N·m) of joint j at q (rad) that moves towards ``side``; never negative."""
    level = f.coulomb[j] + side * f.asymmetric_level[j] + f.slope[j] * q + f.load[j] * abs(load)
    if f.stribeck[j] != 0.0:
        level += f.stribeck[j] * math.exp(-speed / f.stribeck_velocity[j])
    if f.patch[j] != 0.0:
        level += f.patch[j] * math.exp(-(((q - f.patch_centre[j]) / f.patch_width[j]) ** 2))
    if f.static[j] != 0.0:
        level += f.static[j] * math.exp(-speed / STATIC_VELOCITY)
    return max(level, 0.0)


@compiled
def viscous_torque(v: float, temperature: float, j: int, f: Friction) -> float:
    """Return the resistance (N·m) of joint j at velocity v (rad/s) that vanishes at rest."""
    speed = abs(v)
    viscosity = f.viscous[j]
    if f.viscosity_rate[j] != 0.0:
        viscosity *= math.exp(-f.viscosity_rate[j] * (temperature - f.reference[j]))
    return v * (viscosity + speed * (f.quadratic[j] + f.cubic[j] * speed)) + f.asymmetric[j] * speed


@compiled
def side_of(v: float) -> float:
    """Return the sign of v, 0 for none."""
    if v == 0.0:
        return 0.0
    return 1.0 if v > 0.0 else -1.0


@compiled
def relax_bristles(z: float, q: float, v: float, h: float, load: float, j: int, f: Friction) -> float:
    """Return the bristles' deflection (rad) after h (s) at steady v: ż = v − (σ₀|v|/g)·z, solved exactly."""
    level = dry_level(q, abs(v), side_of(v), load, j, f)
    if level < MIN_LEVEL:
        return 0.0
    rate = f.stiffness[j] * abs(v) / level
    if rate * h < 1e-12:
        return z + v * h
    return v / rate + (z - v / rate) * math.exp(-rate * h)


@compiled
def dry_torque(q: float, v: float, load: float, j: int, m: JointMemory, f: Friction) -> float:
    """Return the dry friction (N·m) of joint j, by its bristles where it has some: σ₀·z + σ₁·ż."""
    if f.stiffness[j] == 0.0:
        share = m.sticking[j]
        return share * dry_level(q, abs(v), side_of(share), load, j, f)
    level = dry_level(q, abs(v), side_of(v), load, j, f)
    if level < MIN_LEVEL:
        return 0.0
    z = m.bristle[j]
    return f.stiffness[j] * z + f.damping[j] * (v - f.stiffness[j] * abs(v) / level * z)


@compiled
def update_memory(q: float, v: float, h: float, load: float, j: int, m: JointMemory, f: Friction) -> None:
    """Advance the memory of joint j by h (s) to angle q and velocity v, with a linear velocity in between."""
    d = h / N_SUBSTEPS
    begin, angle = m.velocity[j], m.angle[j]
    # the integral of the linear velocity may differ from q; the difference is distributed over the motion
    correction = ((q - angle) / h - 0.5 * (begin + v)) if h > 0.0 else 0.0
    for k in range(N_SUBSTEPS):
        if h == 0.0:
            break
        speed = begin + (k + 0.5) / N_SUBSTEPS * (v - begin) + correction
        angle += 0.5 * d * speed
        if f.stiffness[j] > 0.0:
            m.bristle[j] = relax_bristles(m.bristle[j], angle, speed, d, load, j, f)
        else:
            m.sticking[j] = min(max(m.sticking[j] + d * speed / STICKING_ANGLE, -1.0), 1.0)
        angle += 0.5 * d * speed
    m.angle[j], m.velocity[j] = q, v


@compiled
def apply_friction(
    q: FloatArray,
    qd: FloatArray,
    h: FloatArray,
    load: FloatArray,
    other_torque: FloatArray,
    m: JointMemory,
    f: Friction,
    w: ThermalModel,
    out: FloatArray,
    temperatures: FloatArray,
) -> None:
    """Write friction (n, 6) N·m and temperatures (n, 6) °C along a motion.

    Row i comes ``h[i]`` s after the one before.

    ``load`` and ``other_torque`` (n, 6) N·m are the other torques of the drive: that of the rigid body, on
    which dry friction may depend, and the rest. Both heat the windings.
    """
    for i in range(h.size):
        decay = math.exp(-h[i] / w.time)
        for j in range(q.shape[1]):
            update_memory(q[i, j], qd[i, j], h[i], load[i, j], j, m, f)
            temperature = m.temperature[j]
            torque = dry_torque(q[i, j], qd[i, j], load[i, j], j, m, f)
            torque += viscous_torque(qd[i, j], temperature, j, f)
            current = (load[i, j] + other_torque[i, j] + torque) / w.torque_constant[j]
            heat = abs(torque * qd[i, j]) + w.resistance[j] * current * current
            final = w.ambient + w.warming[j] * heat
            m.temperature[j] = final + (temperature - final) * decay
            out[i, j], temperatures[i, j] = torque, m.temperature[j]
