"""A plant's numbers in a model's terms, where the two say the same thing in different words."""

from __future__ import annotations

import math
from collections.abc import Mapping

from labhil.physics.model import Model

INVERSES: Mapping[str, str] = {
    "saturation.inverse_limit": "saturation.limit",
    "rate_limit.inverse_rate": "rate_limit.rate",
}
"""Parameters of a model that are one over the plant's."""


def model_values(model: Model, plant: Mapping[str, float]) -> dict[str, float]:
    """Values of the model's parameters, by key, that the plant's numbers (by full name) determine."""
    values = {}
    for parameter in model.parameters:
        value = _value(parameter.name, plant)
        if value is not None:
            values[parameter.key] = value
    return values


def _value(name: str, plant: Mapping[str, float]) -> float | None:
    if name in plant:
        return plant[name]
    if name in INVERSES:
        found = plant.get(INVERSES[name])
        return None if found is None else 1.0 / found
    # amplitude·sin(kx + φ) = amplitude·cos φ·sin kx + amplitude·sin φ·cos kx
    amplitude, phase = plant.get("cogging_torque.amplitude"), plant.get("cogging_torque.phase", 0.0)
    if amplitude is not None and name == "cogging_torque.sine":
        return amplitude * math.cos(phase)
    if amplitude is not None and name == "cogging_torque.cosine":
        return amplitude * math.sin(phase)
    return None
