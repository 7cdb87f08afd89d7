"""Terms of a robot arm: those of each joint, and those of the whole arm.

τ is a joint's torque (N·m), q its angle (rad), i the motor current (A), K the torque constant (N·m/A).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labhil.kinds import JOINTS
from labhil.physics.friction_law import laws
from labhil.physics.record import Record
from labhil.physics.terms import Enters, Parameter, Term
from labhil.signals import FloatArray

FRICTION_SOURCE = "eq. 4.64 of the reference text, its Stribeck exponent with the minus sign"
GEAR_RATIO = (101.0,) * JOINTS
"""Ratio of the harmonic drives of a UR's joints, unless the rig file states another."""

RIPPLE_CYCLES = 2.0
"""Periods of torque ripple per turn of a harmonic drive's wave generator: both of its lobes pass a tooth."""

TEMPERATURE_CHANNELS = ("joint_temperatures",)
FRICTION_SHARE = 0.1
"""Typical friction over the torque of a joint."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """Typical torque (N·m), current (A), velocity (rad/s) and acceleration (rad/s²) of each joint, (6,)."""

    torque: FloatArray
    current: FloatArray
    speed: FloatArray
    acceleration: FloatArray

    @classmethod
    def of(cls, record: Record | None, torque_constant: FloatArray) -> Sizes:
        """Take sizes from a record, or those of a UR5 in fast motion if there is none."""
        if record is None:
            torque = np.resize([15.0, 40.0, 20.0, 4.0, 4.0, 2.0], len(torque_constant))
            return cls(torque, torque / torque_constant, np.full(len(torque), 0.5), np.ones(len(torque)))
        joints = record.outputs.shape[1]
        qd = record.inputs[:, joints : 2 * joints]
        current = np.maximum(_rms(record.outputs), 1e-3)
        speed = np.maximum(_rms(qd), 0.02)
        return cls(current * torque_constant, current, speed, 2.0 * speed)


def _rms(columns: FloatArray) -> FloatArray:
    """Root mean square of each column."""
    return np.asarray(np.sqrt(np.mean(columns**2, axis=0)))


def catalogue(sizes: Sizes, gear_ratio: Sequence[float | None], unit: str = "A") -> dict[str, Term]:
    """Make all terms of an arm.

    Args:
        sizes: Typical sizes of the joints, for scales and starts.
        gear_ratio: Gear ratio of each joint; None where it is not known, and with it the order of the ripple.
        unit: Unit of the outputs.

    Returns:
        The terms by key.
    """
    terms = []
    for joint, ratio in enumerate(gear_ratio):
        rippling = () if ratio is None else (ripple(sizes, joint, RIPPLE_CYCLES * ratio),)
        terms += [*friction(sizes, joint), *rippling, *drive(sizes, joint, unit)]
    return {term.key: term for term in (*terms, *whole_arm())}


def _joint_term(
    name: str, joint: int, enters: Enters, words: tuple[str, str, str, str], *parameters: Parameter,
    needs: tuple[str, ...] = (), with_terms: tuple[str, ...] = (), known: tuple[Parameter, ...] = (),
) -> Term:  # fmt: skip
    """The term of a joint; ``words`` are statement, equation, source and excitation."""
    statement, equation, source, revealed_by = words
    together = tuple(f"{other}[{joint}]" for other in with_terms)
    return Term(
        name, enters, statement, equation, source, revealed_by, parameters, needs, together, joint=joint,
        known=known,
    )  # fmt: skip


def friction(sizes: Sizes, joint: int) -> tuple[Term, ...]:
    """Make the friction terms of one joint."""
    level = FRICTION_SHARE * float(sizes.torque[joint])
    return (*_friction_of_velocity(level, float(sizes.speed[joint]), joint), *_other_friction(level, joint))


def _linear(joint: int, name: str, unit: str, scale: float, lower: float = float("-inf")) -> Parameter:
    """A parameter in which the outputs are linear."""
    return Parameter(name, unit, scale, lower, linear=True, joint=joint)


def _friction_of_velocity(level: float, speed: float, joint: int) -> tuple[Term, ...]:
    """Friction that depends on the velocity alone; ``level`` N·m and ``speed`` rad/s are typical."""
    slope = level / speed
    return (
        _joint_term("viscous_friction", joint, Enters.FORCE,
             ("friction that grows in proportion to velocity", "τ = c·q̇", FRICTION_SOURCE,
              "motion at several speeds"),
             _linear(joint, "viscous_friction.coefficient", "N·m·s/rad", slope, 0.0)),
        _joint_term("coulomb_friction", joint, Enters.FORCE,
             ("dry friction: a torque of constant size against the motion", "τ = τ_c·sgn q̇", FRICTION_SOURCE,
              "motion both ways"),
             _linear(joint, "coulomb_friction.level", "N·m", level, 0.0)),
        _joint_term("stribeck_friction", joint, Enters.FORCE,
             ("dry friction that falls from its break-away value as motion sets in",
              "τ = τ_st·exp(−|q̇|/q̇_s)·sgn q̇", FRICTION_SOURCE, "creeping motion and reversals"),
             Parameter("stribeck_friction.level", "N·m", level, -10 * level, 10 * level,
                       starts=(0.1 * level,), linear=True, joint=joint),
             Parameter("stribeck_friction.velocity", "rad/s", 0.1 * speed, 5e-3 * speed, 3.0 * speed,
                       starts=(0.1 * speed, 0.4 * speed), shape=True, step=1e-3, joint=joint),
             with_terms=("coulomb_friction",)),
        _joint_term("quadratic_viscous_friction", joint, Enters.FORCE,
             ("friction that grows with the square of velocity", "τ = c₂·q̇·|q̇|", FRICTION_SOURCE,
              "fast motion"),
             _linear(joint, "quadratic_viscous_friction.coefficient", "N·m·s²/rad²", slope / speed)),
        _joint_term("cubic_viscous_friction", joint, Enters.FORCE,
             ("friction that grows with the cube of velocity (falls off, where negative)", "τ = c₃·q̇³",
              FRICTION_SOURCE, "fast motion"),
             _linear(joint, "cubic_viscous_friction.coefficient", "N·m·s³/rad³", slope / speed**2)),
        _joint_term("friction_asymmetry", joint, Enters.FORCE,
             ("friction that differs with the direction of motion", "τ = c_a·|q̇|",
              "even part of a friction curve; its constant part is the same as an offset of the current",
              "several speeds both ways"),
             _linear(joint, "friction_asymmetry.coefficient", "N·m·s/rad", slope)),
        *(law.term("N·m", "rad", level, speed, joint) for law in laws()),
    )  # fmt: skip


def _other_friction(level: float, joint: int) -> tuple[Term, ...]:
    """Friction that depends on position, load, temperature or history."""
    return (
        _joint_term("position_dependent_friction", joint, Enters.FORCE,
             ("dry friction that changes along the way", "τ = s·q·sgn q̇", "first-order expansion of τ_c(q)",
              "the same speeds at different places"),
             _linear(joint, "position_dependent_friction.slope", "N·m/rad", level)),
        _joint_term("load_dependent_friction", joint, Enters.FORCE,
             ("dry friction that grows with the load on the gear", "τ = μ·|τ_load|·sgn q̇",
              "efficiency of the gear; τ_load is the rigid body's torque", "motion under different loads"),
             _linear(joint, "load_dependent_friction.coefficient", "1", FRICTION_SHARE)),
        _joint_term("temperature_dependent_friction", joint, Enters.FORCE,
             ("viscous friction that falls as the joint warms",
              "c(T) = c·exp(−α·(T − T_0)), T_0 the first temperature", "viscosity of grease",
              "long runs that warm the joints"),
             Parameter("temperature_dependent_friction.rate", "1/K", 0.02, -1.0, 1.0, starts=(0.01,),
                       joint=joint),
             needs=TEMPERATURE_CHANNELS, with_terms=("viscous_friction",)),
        _joint_term("presliding_friction", joint, Enters.FORCE,
             ("dry friction that turns over a short way after a reversal (bristles)",
              "ds = (dq − s·|dq|)/ℓ in the place of sgn q̇", "Dahl 1968; ℓ is level over stiffness",
              "reversals"),
             Parameter("presliding_friction.length", "rad", 2e-3, 0.0, 0.1, starts=(2e-3,), step=1e-3,
                       joint=joint),
             with_terms=("coulomb_friction",)),
    )  # fmt: skip


def ripple(sizes: Sizes, joint: int, order: float) -> Term:
    """Make the torque ripple with ``order`` periods per turn of a joint."""
    size = float(sizes.torque[joint])
    begin = (0.01 * size,)
    sine, cosine = (
        Parameter(
            f"torque_ripple.{wave}",
            "N·m",
            FRICTION_SHARE * size,
            starts=begin,
            linear=True,
            joint=joint,
        )
        for wave in ("sine", "cosine")
    )
    return _joint_term(
        "torque_ripple", joint, Enters.FORCE,
        ("a torque that repeats with the angle (the gear's teeth)",
         f"τ = a·sin N·q + b·cos N·q, N = {order:g}",
         "harmonic drive: N is twice the gear's ratio; beyond half the sampling rate, N·|q̇| = π·rate, it is "
         "aliased, beyond the filter's cut-off it is filtered as the current is", "slow motion"),
        sine, cosine,
        known=(Parameter("torque_ripple.order", "1", order, joint=joint, waves_over="actual_q"),),
    )  # fmt: skip


def drive(sizes: Sizes, joint: int, unit: str) -> tuple[Term, ...]:
    """Make the other terms of one joint: rotor inertia, elasticity, current offset and gain."""
    torque, current = float(sizes.torque[joint]), float(sizes.current[joint])
    compliance = 2e-3 / torque
    inertia = FRICTION_SHARE * torque / float(sizes.acceleration[joint])
    return (
        _joint_term("added_inertia", joint, Enters.FORCE,
             ("more (or less) inertia than the links' (the rotor, seen through the gear)", "τ = J·q̈",
              "rotor inertia times the gear ratio squared", "fast motion"),
             Parameter("added_inertia.inertia", "kg·m²", inertia, linear=True, joint=joint)),
        _joint_term("joint_elasticity", joint, Enters.FORCE,
             ("a joint that gives way: the link is not where the drive is", "q_link = q − κ·τ_load",
              "spring between drive and link, to first order in κ", "fast motion under load"),
             Parameter("joint_elasticity.compliance", "rad/(N·m)", compliance, 0.0, 100.0 * compliance,
                       starts=(0.1 * compliance,), step=1e-3, joint=joint)),
        _joint_term("sensor_offset", joint, Enters.OUTPUT,
             ("an offset of the measured current", "i = τ/K + i_0",
              "standard; a constant torque is the same", "motion both ways"),
             Parameter("sensor_offset.offset", unit, FRICTION_SHARE * current, linear=True, joint=joint)),
        _joint_term("torque_constant", joint, Enters.OUTPUT,
             ("a torque constant that is not the one assumed", "i = (1 + g)·τ/K + i_0",
              "the known inertias are the reference", "large torques"),
             Parameter("torque_constant.gain", "1", FRICTION_SHARE, -0.9, 10.0, joint=joint)),
    )  # fmt: skip


def whole_arm() -> tuple[Term, ...]:
    """Make the terms of the whole arm: payload, tilt of the base, clock offset."""
    return (
        Term("payload", Enters.LOAD, "a mass at the flange that the model does not know of",
             "a point m at (x, y, z) in the flange's frame joins the last link", "rigid body",
             "poses and motions that load several joints",
             (Parameter("payload.mass", "kg", 1.0, 0.0, 50.0, starts=(1.0,)),
              *(Parameter(f"payload.centre_{axis}", "m", 0.1, -0.5, 0.5, starts=(0.02,), shape=False)
                for axis in "xyz"))),
        Term("base_tilt", Enters.LOAD, "a base that does not stand upright",
             "gravity in the base's frame, rolled about x, then pitched about the floor's y", "rigid body",
             "the first joint turned all the way; poses in all directions",
             (Parameter("base_tilt.roll", "rad", 0.05, -3.2, 3.2),
              Parameter("base_tilt.pitch", "rad", 0.05, -1.6, 1.6))),
        Term("clock_offset", Enters.OUTPUT, "currents that are reported later than the motion",
             "i(t) is the current at t − T_d", "two clocks, or two filters, in the controller",
             "fast motion and reversals",
             (Parameter("clock_offset.offset", "s", 0.01, -0.1, 0.1, starts=(0.004,), step=1e-2),)),
    )  # fmt: skip


UNOBSERVABLE_TERMS: Mapping[str, str] = {
    "static_friction": "it shows only where a joint rests, and there the current may be anything it can hold",
    "constant_force": "a constant torque is the same as sensor_offset, an offset of the current",
    "time_delay": "the input is the measured motion; the other clock's is clock_offset",
}
