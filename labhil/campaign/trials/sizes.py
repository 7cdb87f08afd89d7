"""Random sizes of an effect's parameters, and the exponents with which they grow with its strength."""

from __future__ import annotations

import numpy as np

SHAPE_SUFFIXES = (
    ".velocity", ".order", ".phase", ".second", ".width", ".place", ".from", ".speed", ".share",
    "joint_elasticity.damping", "presliding_friction.damping", "maxwell_slip_friction.damping", ".spread",
    ".attraction",
)  # fmt: skip
"""Suffixes of parameters that determine where or how an effect acts, not how strongly."""
FIXED_SUFFIXES = (".phase", ".second", ".share")
INVERSE_PARAMETERS = (
    "saturation.limit", "rate_limit.rate", "presliding_friction.stiffness", "maxwell_slip_friction.stiffness",
)  # fmt: skip
"""Parameters with a smaller value for a stronger effect."""
SIGNED_PARAMETERS = (
    "constant_force.force", "sensor_gain.gain", "sensor_nonlinearity.cubic", "residual_magnetism.current",
    "friction_asymmetry.coefficient", "position_dependent_friction.slope", "sensor_offset.offset",
)  # fmt: skip
"""Parameters with either sign."""
MAX_SIZE_FACTOR = 1.6
"""Largest factor by which a parameter differs from its default."""


def draw_size(name: str, default: float, rng: np.random.Generator) -> float:
    """Draw a value about the default; parameters without a counterpart in a model are zero."""
    if name == "friction_asymmetry.level":
        return 0.0
    if name == "cogging_torque.phase":
        return float(rng.uniform(-np.pi, np.pi))
    if name.endswith(FIXED_SUFFIXES):
        return default
    value = abs(default) if name.endswith("stribeck_friction.level") else default
    value *= draw_factor(MAX_SIZE_FACTOR, rng)
    flipped = name in SIGNED_PARAMETERS or name.endswith(".place")
    return -value if flipped and rng.integers(2) else value


def draw_factor(max_factor: float, rng: np.random.Generator) -> float:
    """Draw a factor between one over ``max_factor`` and ``max_factor``, log-uniformly."""
    return float(np.exp(rng.uniform(-1.0, 1.0) * np.log(max_factor)))


def strength_exponent(name: str) -> int:
    """Return the exponent (−1, 0 or 1) of an effect's strength with which a parameter grows."""
    if name in INVERSE_PARAMETERS:
        return -1
    return 0 if name.endswith(SHAPE_SUFFIXES) else 1
