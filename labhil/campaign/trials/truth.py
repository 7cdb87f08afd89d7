"""Conversion of a plant's parameters to those of a model, where the two correspond."""

from __future__ import annotations

import math
from collections.abc import Mapping

from labhil.physics.model import Model
from labhil.physics.terms import keyed

INVERSES: Mapping[str, str] = {
    "saturation.inverse_limit": "saturation.limit",
    "rate_limit.inverse_rate": "rate_limit.rate",
}
"""Parameters of a model that are the inverse of the plant's."""

OTHER_NAMES: Mapping[str, str] = {"torque_constant.gain": "sensor_gain.gain"}
"""Parameters of a model with another name in the plant."""
RATE = "temperature_dependent_friction.rate"
WAVES = ("cogging_torque", "torque_ripple")


def model_values(model: Model, plant: Mapping[str, float]) -> dict[str, float]:
    """Return the values of the model's parameters, by key, that the plant's (by full name) determine."""
    values = {}
    for parameter in model.parameters:
        value = _value(parameter.name, parameter.joint, plant)
        if value is not None:
            values[parameter.key] = value
    return values


def _bristle_force(joint: int | None, plant: Mapping[str, float]) -> float:
    """Force at which bristles slip: that of creeping motion, of an arm that of Coulomb friction alone."""
    level = plant.get(keyed("coulomb_friction.level", joint), 0.0)
    return level if joint is not None else level + plant.get("stribeck_friction.level", 0.0)


def _value(name: str, joint: int | None, plant: Mapping[str, float]) -> float | None:
    def of(name: str) -> float | None:
        return plant.get(keyed(name, joint))

    term, _, part = name.partition(".")
    if name == "viscous_friction.coefficient" and joint is not None and of(RATE):
        return None  # an arm's model has it at the first temperature
    if name in INVERSES:
        plain = of(INVERSES[name])
        return None if plain is None else 1.0 / plain
    if name == "presliding_friction.length":
        stiffness = of("presliding_friction.stiffness")
        force = _bristle_force(joint, plant)
        return force / stiffness if force and stiffness else None
    if name == "presliding_friction.time_constant":
        stiffness = of("presliding_friction.stiffness")
        return (of("presliding_friction.damping") or 0.0) / stiffness if stiffness else None
    amplitude, phase = of(f"{term}.amplitude"), of(f"{term}.phase") or 0.0
    if term in WAVES and part in ("sine", "cosine") and amplitude is not None:
        # amplitude·sin(kx + φ) = amplitude·cos φ·sin kx + amplitude·sin φ·cos kx
        return amplitude * (math.cos(phase) if part == "sine" else math.sin(phase))
    return of(OTHER_NAMES.get(name, name))
