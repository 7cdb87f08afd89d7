"""A mechanism of a MuJoCo file with one joint: its values, its acceleration, and its rollouts."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from labhil.extras import load_optional
from labhil.physics.model import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.rollouts import Driven, Push, roll_out
from labhil.simulators.stepped import Held, Nodes
from labhil.simulators.tables import Ask

PURPOSE = "an MJCF file"


class Field(StrEnum):
    """What of a MuJoCo model a value is."""

    DAMPING = "damping"
    QUADRATIC_DAMPING = "quadratic_damping"
    CUBIC_DAMPING = "cubic_damping"
    FRICTIONLOSS = "frictionloss"
    STIFFNESS = "stiffness"
    SPRINGREF = "springref"
    ARMATURE = "armature"
    MASS = "mass"
    GEAR = "gear"
    KP = "kp"
    KV = "kv"


RUBS = {
    Field.DAMPING: "viscous_friction.coefficient",
    Field.FRICTIONLOSS: "coulomb_friction.level",
    Field.QUADRATIC_DAMPING: "quadratic_viscous_friction.coefficient",
    Field.CUBIC_DAMPING: "cubic_viscous_friction.coefficient",
}
"""Values that are friction: each is an effect of the catalogue, of the very same law."""


@dataclass(frozen=True, slots=True)
class Value:
    """A value of a file: what it is, of which joint, body or actuator (its number), its name and unit."""

    name: str
    field: Field
    of: int
    unit: str
    start: float


class Place(NamedTuple):
    """Where a MuJoCo model has a value: an array, the column of it (None: it has none), and a sign."""

    array: str
    column: int | None = None
    sign: float = 1.0


PLACES = {
    Field.DAMPING: Place("dof_damping"),
    Field.QUADRATIC_DAMPING: Place("dof_dampingpoly", 0),
    Field.CUBIC_DAMPING: Place("dof_dampingpoly", 1),
    Field.FRICTIONLOSS: Place("dof_frictionloss"),
    Field.STIFFNESS: Place("jnt_stiffness"),
    Field.SPRINGREF: Place("qpos_spring"),
    Field.ARMATURE: Place("dof_armature"),
    Field.MASS: Place("body_mass"),
    Field.GEAR: Place("actuator_gear", 0),
    Field.KP: Place("actuator_gainprm", 0),
    Field.KV: Place("actuator_biasprm", 2, -1.0),
}


def read_value(model: Any, field: Field, of: int) -> float:
    """What a model has for a value; 0 where this MuJoCo has no such thing."""
    place = PLACES[field]
    values = getattr(model, place.array, None)
    if values is None:
        return 0.0
    return place.sign * float(values[of] if place.column is None else values[of][place.column])


def write_value(model: Any, field: Field, of: int, value: float) -> None:
    """Set a value of a model; with the mass of a body goes its inertia, for its shape stays the same."""
    place = PLACES[field]
    if value == 0.0 and not hasattr(model, place.array):
        return
    if field is Field.MASS:
        model.body_inertia[of] *= value / model.body_mass[of]
    if field is Field.KP:
        model.actuator_biasprm[of][1] = -value
    if field is Field.KV and model.actuator_biasprm[of][1] == 0.0:  # a servo of velocity
        model.actuator_gainprm[of][0] = value
    if place.column is None:
        getattr(model, place.array)[of] = place.sign * value
    else:
        getattr(model, place.array)[of][place.column] = place.sign * value


class Mechanism:
    """A MuJoCo model with one joint (satisfies ``simulators.stepped.Stepped``)."""

    def __init__(
        self, model: Any, driven: Driven, values: Sequence[Value], held: Held, late: float = 0.0
    ) -> None:
        self._model, self._driven, self.values, self._held, self._late = model, driven, values, held, late
        self._smooth = _smooth(model, driven)
        self.push: Push | None = None
        self._data = load_optional("mujoco", PURPOSE).MjData(self._smooth)

    @property
    def held(self) -> Held:
        """Ends of the way, limits and delay of the file.

        What all sensors are late by, the input may be as well: the recorded state is then the delayed one.
        """
        return replace(self._held, delay=self._held.delay + self._late)

    @property
    def input_delay(self) -> float:
        """How late the file's actuator alone is, s."""
        return self._held.delay

    @property
    def timestep(self) -> float:
        """MuJoCo's own step, s."""
        return float(self._model.opt.timestep)

    def with_values(self, numbers: Sequence[float]) -> Any:
        """The whole model at these values."""
        return self._at(self._model, numbers, smooth=False)

    def ask(self, numbers: Sequence[float]) -> Ask:
        """Accelerations without friction at the joint, contacts and limits."""
        mujoco = load_optional("mujoco", PURPOSE)
        model, data, driven = self._at(self._smooth, numbers, smooth=True), self._data, self._driven

        def accelerations(x: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
            out = np.empty(len(x))
            place = data.ctrl if driven.actuator >= 0 else data.qfrc_applied
            column = driven.control if driven.actuator >= 0 else 0
            points = zip(x.tolist(), v.tolist(), u.tolist(), strict=True)
            for k, (position, velocity, drive) in enumerate(points):
                data.qpos[0], data.qvel[0], place[column] = position, velocity, drive
                mujoco.mj_forward(model, data)
                out[k] = data.qacc[0]
            return out

        return accelerations

    def inertia(self, numbers: Sequence[float]) -> float:
        """What a force at the joint is divided by, kg·m² or kg."""
        mujoco = load_optional("mujoco", PURPOSE)
        model, data, accelerations = self._at(self._smooth, numbers, smooth=True), self._data, []
        data.qpos[0], data.qvel[0] = 0.0, 0.0
        for force in (0.0, 1.0):
            data.qfrc_applied[0] = force
            mujoco.mj_forward(model, data)
            accelerations.append(float(data.qacc[0]))
        data.qfrc_applied[0] = 0.0
        return 1.0 / (accelerations[1] - accelerations[0])

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Position and velocity (N, 2) of all windows, stepped by MuJoCo with all that the file has."""
        model, (t, u) = self.with_values(numbers), nodes
        nodes = (t + self._late, u)
        return roll_out(model, self._driven, record, nodes, windows, states, self.push)

    def _at(self, model: Any, numbers: Sequence[float], *, smooth: bool) -> Any:
        mujoco = load_optional("mujoco", PURPOSE)
        changed = model if smooth else deepcopy(model)
        for value, number in zip(self.values, numbers, strict=False):
            write_value(changed, value.field, value.of, number)
        mujoco.mj_setConst(changed, self._data if smooth else mujoco.MjData(changed))
        return changed


def _smooth(model: Any, driven: Driven) -> Any:
    """The model without what makes its acceleration jump or bend, all of which is solved apart."""
    mujoco = load_optional("mujoco", PURPOSE)
    smooth = deepcopy(model)
    off = mujoco.mjtDisableBit
    smooth.opt.disableflags |= int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT) | int(off.mjDSBL_FRICTIONLOSS)
    for field in RUBS:
        write_value(smooth, field, 0, 0.0)
    if driven.actuator >= 0:
        smooth.actuator_ctrllimited[:] = 0
        smooth.actuator_forcelimited[:] = 0
        if hasattr(smooth, "actuator_delay"):
            smooth.actuator_delay[:] = 0.0
    if hasattr(smooth, "jnt_actfrclimited"):
        smooth.jnt_actfrclimited[:] = 0
    return smooth
