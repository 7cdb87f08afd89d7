"""A simulated arm of the UR class.

:class:`ArmPlant` with MuJoCo (extra ``arm``), :class:`LiveArm` without.
"""

from labhil.plants.arm.effects import EFFECTS, HIDDEN, all_parameters, parameters_of
from labhil.plants.arm.links import ARMS, UR3E, UR5, UR10E, Link, Links
from labhil.plants.arm.live import LiveArm, Sample, Setpoint
from labhil.plants.arm.plant import ArmPlant, Trajectory, Truth

__all__ = [
    "ARMS",
    "EFFECTS",
    "HIDDEN",
    "UR3E",
    "UR5",
    "UR10E",
    "ArmPlant",
    "Link",
    "Links",
    "LiveArm",
    "Sample",
    "Setpoint",
    "Trajectory",
    "Truth",
    "all_parameters",
    "parameters_of",
]
