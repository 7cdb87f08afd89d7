"""Parameters and effects of a simulated arm.

A parameter is one number for the whole arm, or one per joint: ``coulomb_friction.level`` is then that of all
joints, ``coulomb_friction.level[2]`` that of joint 2 (counted from 0). An effect may belong to one joint:
``load_dependent_friction[1]``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from labhil.errors import UnknownNameError, UsageError
from labhil.plants.arm.links import JOINTS
from labhil.signals import FloatArray

PerJoint = tuple[float, ...]
Overrides = Mapping[str, float | Sequence[float]]


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect of a simulated arm.

    Attributes:
        about: What it is, with units.
        strengths: Defaults (SI) by short name of the parameters at whose zero the effect vanishes.
        shapes: Defaults of its other parameters.
    """

    about: str
    strengths: Mapping[str, float | PerJoint]
    shapes: Mapping[str, float | PerJoint] = field(default_factory=dict)


def _same(value: float) -> PerJoint:
    return (value,) * JOINTS


BARE_ARM: Mapping[str, float | PerJoint] = {
    "torque_constant": (13.26, 11.13, 10.62, 11.03, 11.47, 11.61),  # N·m/A, gear ratio included
    "servo_bandwidth": 200.0,  # rad/s
    "stamp_jitter": 0.0,  # s, largest deviation of a sample from its regular time
    "q_noise": 1e-5,  # rad
    "qd_noise": 1e-3,  # rad/s
    "current_noise": (0.02, 0.02, 0.015, 0.006, 0.006, 0.006),  # A
    "current_noise_memory": 0.0,  # correlation of the noise of one sample with that of the next
    "current_resolution": 0.001,  # A
    "start_temperature": (27.0, 27.0, 27.0, 28.0, 28.0, 28.0),  # °C
    "ambient_temperature": 24.0,  # °C
    "warming": (15.0, 8.0, 12.0, 60.0, 80.0, 80.0),  # K/W
    "warming_time": 300.0,  # s
    "winding_resistance": (1.2, 1.2, 1.2, 2.0, 2.0, 2.0),  # Ω
    "temperature_noise": 0.03,  # K
    "temperature_resolution": 0.0625,  # K
    "supply_voltage": 48.0,  # V
    "supply_resistance": 0.15,  # Ω
    "voltage_noise": 0.05,  # V
}
"""The arm without any effect: parameters and their defaults (SI)."""

EFFECTS: Mapping[str, Effect] = {
    "viscous_friction": Effect(
        "resistance c·q̇, N·m·s/rad", {"coefficient": (0.9, 0.4, 0.89, 0.16, 0.17, 0.12)}
    ),
    "coulomb_friction": Effect(
        "dry friction of constant level, N·m", {"level": (0.91, 0.95, 0.59, 0.2, 0.17, 0.2)}
    ),
    "stribeck_friction": Effect(
        "dry friction that goes from its level at rest to zero with speed, N·m and rad/s",
        {"level": (-0.27, -0.45, -0.05, 0.03, 0.03, 0.09)},
        {"velocity": (0.045, 0.039, 0.04, 0.025, 0.04, 0.033)},
    ),
    "static_friction": Effect("extra hold at rest, N·m", {"level": (0.6, 0.6, 0.4, 0.15, 0.15, 0.15)}),
    "quadratic_viscous_friction": Effect(
        "resistance c·q̇|q̇|, N·m·s²/rad²", {"coefficient": (0.4, 0.4, 0.4, 0.1, 0.1, 0.1)}
    ),
    "cubic_viscous_friction": Effect(
        "resistance c·q̇³, N·m·s³/rad³", {"coefficient": (0.2, 0.2, 0.2, 0.05, 0.05, 0.05)}
    ),
    "friction_asymmetry": Effect(
        "resistance c·|q̇| (N·m·s/rad) and a dry level (N·m) that is added forwards and taken off backwards",
        {"coefficient": (0.3, 0.3, 0.3, 0.06, 0.06, 0.06), "level": (0.2, 0.2, 0.15, 0.05, 0.05, 0.05)},
    ),
    "position_dependent_friction": Effect(
        "dry friction that grows with the angle, N·m/rad", {"slope": (0.3, 0.3, 0.2, 0.08, 0.08, 0.08)}
    ),
    "load_dependent_friction": Effect(
        "dry friction μ·|τ_load| of the torque that the rigid body asks for", {"coefficient": _same(0.05)}
    ),
    "temperature_dependent_friction": Effect(
        "viscous friction times exp(−rate·(T − reference)), 1/K and °C (needs viscous friction)",
        {"rate": _same(0.03)},
        {"reference": _same(30.0)},
    ),
    "presliding_friction": Effect(
        "dry friction carried by bristles: N·m/rad and N·m·s/rad (needs a dry friction to carry)",
        {"stiffness": (600.0, 600.0, 400.0, 150.0, 150.0, 150.0)},
        {"damping": (1.0, 1.0, 0.7, 0.2, 0.2, 0.2)},
    ),
    "torque_ripple": Effect(
        "amplitude·sin(order·q + phase), N·m, cycles per turn and rad (harmonic drive: twice 101 a turn)",
        {"amplitude": (0.5, 0.5, 0.4, 0.15, 0.15, 0.15)},
        {"order": _same(202.0), "phase": _same(0.0)},
    ),
    "added_inertia": Effect(
        "inertia of the drives, kg·m² at the joint", {"inertia": (0.6, 0.6, 0.4, 0.08, 0.08, 0.08)}
    ),
    "payload": Effect(
        "a point mass (kg) at a place in the flange's frame (m) that the controller does not know of",
        {"mass": 1.5},
        {"centre_x": 0.0, "centre_y": 0.0, "centre_z": 0.08},
    ),
    "base_tilt": Effect(
        "the base is rolled about x, then pitched about y, rad", {"roll": 0.02, "pitch": 0.03}
    ),
    "joint_elasticity": Effect(
        "a spring (rad/(N·m)) between drive and link; relaxation (s) is its damping over its stiffness",
        {"compliance": (2e-4, 2e-4, 2e-4, 4e-4, 4e-4, 4e-4)},
        {"relaxation": _same(2e-3)},
    ),
    "constant_force": Effect("a torque that is always there, N·m", {"force": (0.4, 0.4, 0.3, 0.1, 0.1, 0.1)}),
    "sensor_offset": Effect(
        "measured current = current + offset, A", {"offset": (0.1, -0.08, 0.06, 0.05, -0.04, 0.03)}
    ),
    "sensor_gain": Effect("measured current = (1 + gain)·current", {"gain": _same(0.05)}),
    "clock_offset": Effect("currents are reported later than angles, s", {"offset": 0.008}),
}
"""All effects by name; an arm has those alone that it names."""

HIDDEN: Mapping[str, Effect] = {
    "hidden_cable": Effect(
        "a cable between forearm and flange that pulls on the wrist once it is taut, N/m and m",
        {"stiffness": 150.0},
        {"length": 0.16},
    ),
    "hidden_sticky_patch": Effect(
        "dry friction level·exp(−((q − centre)/width)²) of one joint, N·m and rad",
        {"level": (0.0, 0.0, 1.2, 0.0, 0.0, 0.0)},
        {"centre": _same(0.3), "width": _same(0.15)},
    ),
}
"""Effects that no list of terms contains: a diagnosis can only state them as unmodelled."""

ALL_EFFECTS: Mapping[str, Effect] = {**EFFECTS, **HIDDEN}

DRY = (
    "coulomb_friction", "stribeck_friction", "friction_asymmetry", "position_dependent_friction",
    "load_dependent_friction", "hidden_sticky_patch",
)  # fmt: skip
POSITIVE = {
    "torque_constant", "servo_bandwidth", "warming_time", "supply_voltage", "stribeck_friction.velocity",
    "hidden_sticky_patch.width", "torque_ripple.order",
}  # fmt: skip
NOT_NEGATIVE = {
    "stamp_jitter", "q_noise", "qd_noise", "current_noise", "current_noise_memory", "current_resolution",
    "warming", "winding_resistance", "temperature_noise", "temperature_resolution", "supply_resistance",
    "voltage_noise", "payload.mass", "presliding_friction.stiffness", "presliding_friction.damping",
    "joint_elasticity.compliance", "joint_elasticity.relaxation", "hidden_cable.stiffness",
    "hidden_cable.length", "clock_offset.offset",
}  # fmt: skip
UPPER_LIMITS: Mapping[str, float] = {"clock_offset.offset": 0.1, "current_noise_memory": 0.999}


@dataclass(frozen=True, slots=True)
class Values:
    """Parameters of an arm by name; those of an absent effect are zero."""

    numbers: Mapping[str, float]
    joints: Mapping[str, FloatArray]

    def number(self, name: str) -> float:
        """Return a parameter of the whole arm; 0 where its effect is absent."""
        return self.numbers.get(name, 0.0)

    def per_joint(self, name: str, absent: float = 0.0) -> FloatArray:
        """Return a parameter of the joints (6,); ``absent`` where its effect is."""
        return self.joints.get(name, np.full(JOINTS, absent))

    def by_key(self) -> dict[str, float]:
        """Return all parameters by key, ``coulomb_friction.level[2]`` for joint 2."""
        per_joint = {
            f"{name}[{j}]": float(x) for name, numbers in self.joints.items() for j, x in enumerate(numbers)
        }
        return dict(self.numbers) | per_joint


def parameters_of(effect: str) -> dict[str, float | PerJoint]:
    """Return the effect's parameters by full name (``effect.parameter``) with their defaults."""
    definition = ALL_EFFECTS[effect]
    return {
        f"{effect}.{name}": value
        for name, value in (*definition.strengths.items(), *definition.shapes.items())
    }


def all_parameters() -> dict[str, float | PerJoint]:
    """Return all parameters with their defaults (SI): one number, or one per joint."""
    known = dict(BARE_ARM)
    for effect in ALL_EFFECTS:
        known |= parameters_of(effect)
    return known


def resolve(terms: Iterable[str], overrides: Overrides) -> Values:
    """Return the parameters of an arm with some effects.

    Args:
        terms: Names of the effects, with a joint in brackets or without.
        overrides: Values by parameter name or key, SI.

    Returns:
        Values of all parameters.

    Raises:
        UnknownNameError: An effect or a parameter does not exist.
        UsageError: A joint does not exist, a parameter belongs to an effect that is not in ``terms``, or a
            value is out of range.
    """
    chosen = tuple(terms)
    values = {name: _array(value) for name, value in BARE_ARM.items()}
    for name, joints in _joints_by_effect(chosen).items():
        for parameter, default in parameters_of(name).items():
            values[parameter] = _array(default)
            if parameter.partition(".")[2] in ALL_EFFECTS[name].strengths and values[parameter].size > 1:
                values[parameter][[j for j in range(JOINTS) if j not in joints]] = 0.0
    # values of all joints come before those of one
    for key, value in sorted(overrides.items(), key=lambda item: "[" in item[0]):
        _set(values, key, value, chosen)
    _check(values)
    present = {split_key(term)[0] for term in chosen}
    _check_combination(present)
    return Values(
        {name: float(value[0]) for name, value in values.items() if value.size == 1},
        {name: value for name, value in values.items() if value.size > 1},
    )


def split_key(key: str) -> tuple[str, int | None]:
    """Split ``name[2]`` into name and joint; UsageError where the brackets do not contain a joint."""
    name, bracket, suffix = key.partition("[")
    if not bracket:
        return key, None
    if not re.fullmatch(rf"[0-{JOINTS - 1}]\]", suffix):
        raise UsageError(f"{key}: expected a joint from 0 to {JOINTS - 1} in brackets, such as {name}[2]")
    return name, int(suffix[0])


def _joints_by_effect(terms: tuple[str, ...]) -> dict[str, set[int]]:
    """Return the joints of each effect."""
    joints: dict[str, set[int]] = {}
    for term in terms:
        name, joint = split_key(term)
        if name not in ALL_EFFECTS:
            raise UnknownNameError("effect", name, EFFECTS)
        is_per_joint = any(isinstance(value, tuple) for value in ALL_EFFECTS[name].strengths.values())
        if joint is not None and not is_per_joint:
            raise UsageError(f"{term}: {name} belongs to the whole arm and takes no joint")
        joints.setdefault(name, set()).update(range(JOINTS) if joint is None else (joint,))
    return joints


def _array(value: float | Sequence[float]) -> FloatArray:
    return np.atleast_1d(np.array(value, dtype=np.float64))


def _set(
    values: dict[str, FloatArray], key: str, value: float | Sequence[float], chosen: tuple[str, ...]
) -> None:
    """Set a parameter of one joint or of all."""
    name, joint = split_key(key)
    if name not in values:
        _refuse(name, chosen)
    target, array = values[name], _array(value)
    if joint is not None and target.size == 1:
        raise UsageError(f"{key}: {name} belongs to the whole arm and takes no joint")
    if array.size not in ({1} if joint is not None else {1, target.size}) or array.ndim != 1:
        wanted = "one number" if joint is not None or target.size == 1 else f"one number, or {JOINTS}"
        raise UsageError(f"{key}: expected {wanted}, found {value!r}")
    target[slice(None) if joint is None else joint] = array if joint is None else array[0]


def _refuse(name: str, chosen: tuple[str, ...]) -> None:
    known = all_parameters()
    if name not in known:
        raise UnknownNameError("parameter", name, known)
    effect = name.partition(".")[0]
    raise UsageError(
        f"{name} belongs to {effect}, which is not among the terms: {', '.join(chosen) or 'none'}"
    )


def _check(values: Mapping[str, FloatArray]) -> None:
    for name, value in values.items():
        positive, signed = name in POSITIVE, name not in NOT_NEGATIVE
        wanted = "positive" if positive else "finite" if signed else "finite and not negative"
        bad = ~np.isfinite(value) | (positive & (value <= 0.0)) | ((not signed) & (value < 0.0))
        if np.any(bad):
            raise UsageError(f"{name} must be {wanted}, found {value[bad][0]:g}")
        if name in UPPER_LIMITS and np.any(value > UPPER_LIMITS[name]):
            raise UsageError(f"{name} must be at most {UPPER_LIMITS[name]:g}, found {value.max():g}")


def _check_combination(present: set[str]) -> None:
    if "presliding_friction" in present and not set(DRY) & present:
        raise UsageError(
            f"presliding_friction needs a dry friction to carry; add one of: {', '.join(DRY[:-1])}"
        )
    if "temperature_dependent_friction" in present and "viscous_friction" not in present:
        raise UsageError("temperature_dependent_friction needs viscous_friction")
