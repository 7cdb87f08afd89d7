"""How large an effect is drawn, and which of its numbers grow with its strength."""

from __future__ import annotations

import numpy as np

SHAPES = (
    ".velocity", ".order", ".phase", ".second", ".width", ".place", ".from", ".speed", ".share",
    "joint_elasticity.damping", ".spread", ".attraction",
)  # fmt: skip
"""Endings of parameters that say where or how an effect acts, not how strongly."""
NOT_SHIFTED = (".phase", ".second", ".share")
INVERSE = (
    "saturation.limit", "rate_limit.rate", "presliding_friction.stiffness", "maxwell_slip_friction.stiffness",
)  # fmt: skip
"""Parameters of which a smaller value means a stronger effect."""
SIGNED = (
    "constant_force.force", "sensor_gain.gain", "sensor_nonlinearity.cubic", "residual_magnetism.current",
    "friction_asymmetry.coefficient", "position_dependent_friction.slope", "sensor_offset.offset",
)  # fmt: skip
"""Parameters that a rig may have with either sign."""
SPREAD = 1.6
"""Largest factor by which a number differs from its default."""


def draw_size(name: str, default: float, random: np.random.Generator) -> float:
    """A value about the default; what has no counterpart in a model stays away."""
    if name == "friction_asymmetry.level":
        return 0.0
    if name == "cogging_torque.phase":
        return float(random.uniform(-np.pi, np.pi))
    if name.endswith(NOT_SHIFTED):
        return default
    value = abs(default) if name.endswith("stribeck_friction.level") else default
    value *= spread(SPREAD, random)
    flipped = name in SIGNED or name.endswith(".place")
    return -value if flipped and random.integers(2) else value


def spread(factor: float, random: np.random.Generator) -> float:
    """A random factor between one over ``factor`` and ``factor``."""
    return float(np.exp(random.uniform(-1.0, 1.0) * np.log(factor)))


def power_of(name: str) -> int:
    """The power of an effect's strength with which a number of it grows."""
    if name in INVERSE:
        return -1
    return 0 if name.endswith(SHAPES) else 1
