"""Which plant belongs to which kind of rig."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

from labhil.errors import UnknownNameError
from labhil.plants.axis import AXIS, AxisPlant
from labhil.plants.dc_motor import MOTOR, DcMotorPlant
from labhil.plants.solenoid import SOLENOID, SolenoidPlant
from labhil.plants.trajectory import Trajectory
from labhil.plants.world import World
from labhil.signals import FloatArray


class Plant(Protocol):
    """A simulated rig with one input; begins at rest."""

    def simulate(self, values: FloatArray, /) -> Trajectory:
        """Go on through the input's values (n,) at the samples; begins with now."""
        ...


WORLDS: Mapping[str, World] = {"dc_motor": MOTOR, "axis": AXIS, "solenoid": SOLENOID}
"""What the rigs that one input drives can be made of; ball and beam and arm have their own rooms."""

PLANTS: Mapping[str, type[DcMotorPlant] | type[AxisPlant] | type[SolenoidPlant]] = {
    "dc_motor": DcMotorPlant,
    "axis": AxisPlant,
    "solenoid": SolenoidPlant,
}


def plant_of(
    kind: str, parameters: Mapping[str, float], terms: Iterable[str], seed: int, period: float
) -> Plant:
    """A plant of that kind; UnknownNameError lists those that one input drives."""
    if kind not in PLANTS:
        raise UnknownNameError("plant", kind, PLANTS)
    return PLANTS[kind](parameters, terms, seed, period)
