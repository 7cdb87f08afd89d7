"""Parameters of an arm itself: torque constants and grouped inertial parameters."""

from __future__ import annotations

import numpy as np

from labhil.physics.arm.first_estimate import FirstEstimate
from labhil.physics.terms import Parameter

TYPICAL_CONSTANT = 11.0
"""Typical torque constant behind the gear, N·m/A: about 0.11 at the motor times 101."""


def arm_parameters(joints: int, first: FirstEstimate | None, *, known: bool) -> tuple[Parameter, ...]:
    """Make the parameters: torque constants unless ``known``, and grouped inertial parameters if any."""
    constants = () if known else tuple(
        Parameter("torque_constant", "N·m/A", TYPICAL_CONSTANT, 0.01, 1e3, starts=(TYPICAL_CONSTANT,),
                  joint=joint)
        for joint in range(joints)
    )  # fmt: skip
    if first is None:
        return constants
    sizes = np.maximum(np.abs(first.values), first.errors)
    return constants + tuple(
        Parameter(name, unit, float(size), starts=(float(value),), linear=True, joint=link)
        for (name, unit, link), value, size in zip(first.grouped.names(), first.values, sizes, strict=True)
    )
