"""Which plant belongs to which kind of rig, and what it can be made of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from labhil.errors import UnknownNameError
from labhil.plants.axis import AXIS, AxisPlant
from labhil.plants.ball_beam_rig import BALL_BEAM, BallBeamRig
from labhil.plants.dc_motor import DcMotorPlant
from labhil.plants.dc_motor_definition import MOTOR
from labhil.plants.definition import PlantDefinition
from labhil.plants.effects import Effect
from labhil.plants.solenoid import SolenoidPlant
from labhil.plants.solenoid_definition import SOLENOID
from labhil.plants.trajectory import Trajectory
from labhil.signals import FloatArray


class Plant(Protocol):
    """A simulated rig with one input; begins at rest."""

    @property
    def time(self) -> float:
        """Time since the plant began, s."""
        ...

    def step(self, value: float, /) -> Mapping[str, float]:
        """Let one sample period pass with this value of the input; return the signals at its end."""
        ...

    def simulate(self, values: FloatArray, /) -> Trajectory:
        """Go on through the input's values (n,) at the samples; begins with now."""
        ...


PLANT_DEFINITIONS: Mapping[str, PlantDefinition] = {
    "ball_beam": BALL_BEAM,
    "dc_motor": MOTOR,
    "solenoid": SOLENOID,
    "axis": AXIS,
}
"""What the rigs that one input drives can be made of; the arm has a room of its own."""

PLANTS: Mapping[str, Callable[[Mapping[str, float] | None, Iterable[str], int, float], Plant]] = {
    "ball_beam": BallBeamRig,
    "dc_motor": DcMotorPlant,
    "solenoid": SolenoidPlant,
    "axis": AxisPlant,
}


def plant_of(
    kind: str, parameters: Mapping[str, float], terms: Iterable[str], seed: int, period: float
) -> Plant:
    """A plant of that kind; UnknownNameError lists those that one input drives."""
    if kind not in PLANTS:
        raise UnknownNameError("plant", kind, PLANTS)
    return PLANTS[kind](parameters, terms, seed, period)


def effects_of(kind: str, hidden: bool = False) -> Mapping[str, Effect]:
    """Effects by name that a plant of that kind can have, or those in no list of names."""
    if kind not in PLANT_DEFINITIONS:
        raise UnknownNameError("plant", kind, PLANT_DEFINITIONS)
    return PLANT_DEFINITIONS[kind].hidden if hidden else PLANT_DEFINITIONS[kind].effects
