"""The plants and their definitions by rig kind."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from labhil.errors import UnknownNameError
from labhil.plants.axis import AXIS, AxisPlant
from labhil.plants.ball_beam_definition import BALL_BEAM
from labhil.plants.ball_beam_rig import BallBeamRig
from labhil.plants.dc_motor import DcMotorPlant
from labhil.plants.dc_motor_definition import MOTOR
from labhil.plants.definition import Effect, PlantDefinition
from labhil.plants.solenoid import SolenoidPlant
from labhil.plants.solenoid_definition import SOLENOID
from labhil.plants.trajectory import Trajectory
from labhil.signals import FloatArray


class Plant(Protocol):
    """A simulated rig with one input; it starts at rest."""

    @property
    def time(self) -> float:
        """Time since the start, s."""
        ...

    def step(self, value: float, /) -> Mapping[str, float]:
        """Simulate one sample period with this input; return the signals at its end."""
        ...

    def simulate(self, values: FloatArray, /) -> Trajectory:
        """Simulate with the input's values (n,) at the samples; the first is now."""
        ...


PLANT_DEFINITIONS: Mapping[str, PlantDefinition] = {
    "ball_beam": BALL_BEAM,
    "dc_motor": MOTOR,
    "solenoid": SOLENOID,
    "axis": AXIS,
}
"""Definitions of the plants with one input; the arm has its own package."""

PLANTS: Mapping[str, Callable[[Mapping[str, float] | None, Iterable[str], int, float], Plant]] = {
    "ball_beam": BallBeamRig,
    "dc_motor": DcMotorPlant,
    "solenoid": SolenoidPlant,
    "axis": AxisPlant,
}


def plant_of(
    kind: str, parameters: Mapping[str, float], terms: Iterable[str], seed: int, period: float
) -> Plant:
    """Make a plant of a kind; UnknownNameError lists the kinds with one input."""
    if kind not in PLANTS:
        raise UnknownNameError("plant", kind, PLANTS)
    return PLANTS[kind](parameters, terms, seed, period)


def effects_of(kind: str, hidden: bool = False) -> Mapping[str, Effect]:
    """Return the effects by name that a plant of a kind can have, or the hidden ones."""
    if kind not in PLANT_DEFINITIONS:
        raise UnknownNameError("plant", kind, PLANT_DEFINITIONS)
    return PLANT_DEFINITIONS[kind].hidden if hidden else PLANT_DEFINITIONS[kind].effects
