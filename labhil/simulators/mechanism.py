"""A MuJoCo model with one joint: its values, its acceleration, and its simulation by MuJoCo."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from labhil.extras import load_optional
from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.rollouts import Actuation, roll_out
from labhil.simulators.stepped import JointForce, Nodes, NonSmooth
from labhil.simulators.tables import Acceleration

PURPOSE = "an MJCF file"


class Field(StrEnum):
    """Quantities of a MuJoCo model that may be estimated."""

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
    MOTORCONST = "motorconst"
    RESISTANCE = "resistance"


FRICTION_FIELDS = {
    Field.DAMPING: "viscous_friction.coefficient",
    Field.FRICTIONLOSS: "coulomb_friction.level",
    Field.QUADRATIC_DAMPING: "quadratic_viscous_friction.coefficient",
    Field.CUBIC_DAMPING: "cubic_viscous_friction.coefficient",
}
"""Quantities that are friction, and the parameter of the catalogue with the same law."""


@dataclass(frozen=True, slots=True)
class Value:
    """A value of a file.

    Attributes:
        name: Name of the parameter.
        field: Which quantity it is.
        index: Number of its joint, body or actuator.
        unit: SI unit.
        start: Value in the file.
    """

    name: str
    field: Field
    index: int
    unit: str
    start: float


class ArrayElement(NamedTuple):
    """Where a MuJoCo model keeps a quantity: array, column (None for a vector), and sign."""

    array: str
    column: int | None = None
    sign: float = 1.0


ARRAY_ELEMENTS = {
    Field.DAMPING: ArrayElement("dof_damping"),
    Field.QUADRATIC_DAMPING: ArrayElement("dof_dampingpoly", 0),
    Field.CUBIC_DAMPING: ArrayElement("dof_dampingpoly", 1),
    Field.FRICTIONLOSS: ArrayElement("dof_frictionloss"),
    Field.STIFFNESS: ArrayElement("jnt_stiffness"),
    Field.SPRINGREF: ArrayElement("qpos_spring"),
    Field.ARMATURE: ArrayElement("dof_armature"),
    Field.MASS: ArrayElement("body_mass"),
    Field.GEAR: ArrayElement("actuator_gear", 0),
    Field.KP: ArrayElement("actuator_gainprm", 0),
    Field.KV: ArrayElement("actuator_biasprm", 2, -1.0),
    Field.RESISTANCE: ArrayElement("actuator_gainprm", 0),
    Field.MOTORCONST: ArrayElement("actuator_gainprm", 1),
}


COGGING_COLUMN = 0
"""Where ``actuator_biasprm`` keeps the amplitude of a DC motor's cogging; poles and phase follow."""


def is_dc_motor(model: Any, actuator: int) -> bool:
    """Whether an actuator is a ``dcmotor``; false in versions of MuJoCo that have none."""
    kind = getattr(load_optional("mujoco", PURPOSE).mjtGain, "mjGAIN_DCMOTOR", None)
    return actuator >= 0 and kind is not None and int(model.actuator_gaintype[actuator]) == int(kind)


def read_value(model: Any, field: Field, index: int) -> float:
    """Read a quantity of a model; 0 where this version of MuJoCo does not have it."""
    element = ARRAY_ELEMENTS[field]
    values = getattr(model, element.array, None)
    if values is None:
        return 0.0
    return element.sign * float(values[index] if element.column is None else values[index][element.column])


def write_value(model: Any, field: Field, index: int, value: float) -> None:
    """Set a quantity of a model; the inertia of a body changes in proportion to its mass."""
    element = ARRAY_ELEMENTS[field]
    if value == 0.0 and not hasattr(model, element.array):
        return
    if field is Field.MASS:
        model.body_inertia[index] *= value / model.body_mass[index]
    if field is Field.KP:
        model.actuator_biasprm[index][1] = -value
    if field is Field.KV and model.actuator_biasprm[index][1] == 0.0:  # a velocity servo
        model.actuator_gainprm[index][0] = value
    if element.column is None:
        getattr(model, element.array)[index] = element.sign * value
    else:
        getattr(model, element.array)[index][element.column] = element.sign * value


class Mechanism:
    """A MuJoCo model with one joint (a ``simulators.stepped.SteppedSimulator``).

    ``joint_force`` is an additional force in :meth:`roll_out`.
    """

    def __init__(
        self,
        model: Any,
        actuation: Actuation,
        values: Sequence[Value],
        non_smooth: NonSmooth,
        sensor_delay: float = 0.0,
    ) -> None:
        self._model, self._actuation, self.values, self._non_smooth, self._sensor_delay = (
            model,
            actuation,
            values,
            non_smooth,
            sensor_delay,
        )
        self._smooth = _smooth_model(model, actuation)
        self._last_smooth: tuple[tuple[float, ...], Any] | None = None
        self._of_thread = threading.local()  # structures are refitted side by side
        self.joint_force: JointForce | None = None

    @property
    def non_smooth(self) -> NonSmooth:
        """Stops, limits and delay of the file.

        The delay of the sensors is added to that of the input: the recorded state is the delayed one.
        """
        return replace(self._non_smooth, delay=self._non_smooth.delay + self._sensor_delay)

    @property
    def input_delay(self) -> float:
        """Delay of the file's actuator alone, s."""
        return self._non_smooth.delay

    @property
    def timestep(self) -> float:
        """MuJoCo's own step, s."""
        return float(self._model.opt.timestep)

    def with_values(self, numbers: Sequence[float]) -> Any:
        """Return a copy of the model, friction and limits included, with these values."""
        return self._with_values(self._model, numbers)

    def acceleration_at(self, numbers: Sequence[float]) -> Acceleration:
        """Return the acceleration without friction at the joint, contacts and limits."""
        mujoco, actuation = load_optional("mujoco", PURPOSE), self._actuation
        model = self._smooth_at(numbers)

        def accelerations(x: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
            data, out = self._fresh_data(model), np.empty(len(x))
            target = data.ctrl if actuation.actuator >= 0 else data.qfrc_applied
            control = actuation.control if actuation.actuator >= 0 else 0
            points = zip(x.tolist(), v.tolist(), u.tolist(), strict=True)
            for k, (position, velocity, drive) in enumerate(points):
                data.qpos[0], data.qvel[0], target[control] = position, velocity, drive
                mujoco.mj_forward(model, data)
                out[k] = data.qacc[0]
            return out

        return accelerations

    def inertia(self, numbers: Sequence[float]) -> float:
        """Return the inertia at the joint, kg·m² or kg; infinite where a force does not accelerate it."""
        mujoco = load_optional("mujoco", PURPOSE)
        model = self._smooth_at(numbers)
        data, accelerations = self._fresh_data(model), []
        data.qpos[0] = 0.0
        for force in (0.0, 1.0):
            data.qfrc_applied[0] = force
            mujoco.mj_forward(model, data)
            accelerations.append(float(data.qacc[0]))
        per_force = accelerations[1] - accelerations[0]
        return 1.0 / per_force if per_force else float("inf")

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Let MuJoCo step all windows with everything that the file contains, (N, 2)."""
        model, (t, u) = self.with_values(numbers), nodes
        nodes = (t + self._sensor_delay, u)
        return roll_out(model, self._actuation, record, nodes, windows, states, self.joint_force)

    def _smooth_at(self, numbers: Sequence[float]) -> Any:
        """The smooth model with these values, which nobody changes; the last one is kept."""
        key, last = tuple(numbers), self._last_smooth
        if last is None or last[0] != key:
            last = self._last_smooth = (key, self._with_values(self._smooth, numbers))
        return last[1]

    def _with_values(self, model: Any, numbers: Sequence[float]) -> Any:
        mujoco = load_optional("mujoco", PURPOSE)
        changed = deepcopy(model)
        for value, number in zip(self.values, numbers, strict=False):
            write_value(changed, value.field, value.index, number)
        mujoco.mj_setConst(changed, self._fresh_data(changed))
        return changed

    def _fresh_data(self, model: Any) -> Any:
        """This thread's data, reset: to allocate them takes longer than to compute an acceleration.

        They fit every copy of the model, as all have the same dimensions.
        """
        mujoco = load_optional("mujoco", PURPOSE)
        data = getattr(self._of_thread, "data", None)
        if data is None:
            data = self._of_thread.data = mujoco.MjData(self._model)
        mujoco.mj_resetData(model, data)
        return data


def _smooth_model(model: Any, actuation: Actuation) -> Any:
    """Copy a model without contacts, limits, friction, cogging and delay, which the kernels simulate."""
    mujoco = load_optional("mujoco", PURPOSE)
    copy = deepcopy(model)
    disable_bit = mujoco.mjtDisableBit
    copy.opt.disableflags |= (
        int(disable_bit.mjDSBL_CONTACT) | int(disable_bit.mjDSBL_LIMIT) | int(disable_bit.mjDSBL_FRICTIONLOSS)
    )
    for field in FRICTION_FIELDS:
        write_value(copy, field, 0, 0.0)
    if actuation.actuator >= 0:
        copy.actuator_ctrllimited[:] = 0
        copy.actuator_forcelimited[:] = 0
        if hasattr(copy, "actuator_delay"):
            copy.actuator_delay[:] = 0.0
        if is_dc_motor(copy, actuation.actuator):
            copy.actuator_biasprm[actuation.actuator][COGGING_COLUMN] = 0.0
    if hasattr(copy, "jnt_actfrclimited"):
        copy.jnt_actfrclimited[:] = 0
    return copy
