"""A loaded MuJoCo file: the names of its elements, and what is needed to change it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from math import isnan
from pathlib import Path
from typing import Any

from labhil.errors import UsageError
from labhil.extras import load_optional
from labhil.simulators.mechanism import PURPOSE, Mechanism
from labhil.simulators.simulator import Simulator
from labhil.simulators.trial_load import load_in_subprocess
from labhil.simulators.xml_text import XmlText


@dataclass(frozen=True, slots=True)
class Names:
    """Names of the joints, actuators and joint sensors of a file; "" for other sensors."""

    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    sensors: tuple[str, ...]

    def listing(self) -> str:
        """Format all names for a message."""
        return "; ".join(
            f"{what}: {', '.join(names) or 'none'}"
            for what, names in (
                ("joints", self.joints),
                ("actuators", self.actuators),
                ("sensors of position or velocity", self.sensors),
            )
        )


@dataclass(frozen=True)
class MechanismFile:
    """A file with one joint, as it was read.

    Attributes:
        path: The file.
        model: The ``mujoco.MjModel``.
        simulator: The rig that was made of it.
        mechanism: Its acceleration and simulation.
        actuator: Number of the driven actuator; −1 where the input is a force at the joint.
    """

    path: Path
    model: Any
    simulator: Simulator
    mechanism: Mechanism
    actuator: int

    @property
    def joint_name(self) -> str | None:
        """Name of the joint; None where it has none."""
        return self._name("mjOBJ_JOINT", 0)

    @property
    def actuator_name(self) -> str | None:
        """Name of the actuator; None where it has none."""
        return self._name("mjOBJ_ACTUATOR", self.actuator)

    def body_name(self, body: int) -> str | None:
        """Name of a body; None where it has none."""
        return self._name("mjOBJ_BODY", body)

    @property
    def gear(self) -> list[float]:
        """The six numbers of the actuator's gear."""
        return [float(x) for x in self.model.actuator_gear[self.actuator]]

    @property
    def has_polynomials(self) -> bool:
        """Whether this version of MuJoCo has quadratic and cubic damping."""
        return hasattr(self.model, "dof_dampingpoly")

    @property
    def has_delays(self) -> bool:
        """Whether this version of MuJoCo has delays of actuators."""
        return hasattr(self.model, "actuator_delay")

    def in_degrees(self, text: XmlText) -> bool:
        """Whether angles of the file are in degrees."""
        hinge = int(load_optional("mujoco", PURPOSE).mjtJoint.mjJNT_HINGE)
        stated = [
            e.attributes["angle"] for e in text.elements if e.tag == "compiler" and "angle" in e.attributes
        ]
        return int(self.model.jnt_type[0]) == hinge and (stated[-1] if stated else "degree") == "degree"

    def geom_masses(self, body: int) -> list[tuple[float | None, float]]:
        """Return mass (None where the file has none) and density of each geom of a body in file order."""
        geoms = self._spec.bodies[body].geoms
        return [(None if isnan(float(g.mass)) else float(g.mass), float(g.density)) for g in geoms]

    @cached_property
    def _spec(self) -> Any:
        return load_optional("mujoco", PURPOSE).MjSpec.from_file(str(self.path))

    def _name(self, kind: str, index: int) -> str | None:
        mujoco = load_optional("mujoco", PURPOSE)
        return mujoco.mj_id2name(self.model, getattr(mujoco.mjtObj, kind), index) or None


def load_model(file: Path) -> Any:
    """Load a file with MuJoCo; UsageError with MuJoCo's message where that fails."""
    if not file.is_file():
        raise UsageError(f"expected the MuJoCo file {file}, found none")
    return load_in_subprocess(file, PURPOSE)


def names_of(model: Any) -> Names:
    """Return the names in a model; an element without one is named by its number."""
    mujoco = load_optional("mujoco", PURPOSE)
    kinds, sensors = mujoco.mjtObj, mujoco.mjtSensor
    wanted = (int(sensors.mjSENS_JOINTPOS), int(sensors.mjSENS_JOINTVEL))

    def all_of(kind: Any, numbers: Iterable[int], what: str) -> tuple[str, ...]:
        return tuple(mujoco.mj_id2name(model, kind, k) or f"{what}_{k}" for k in numbers)

    return Names(
        all_of(kinds.mjOBJ_JOINT, range(model.njnt), "joint"),
        all_of(kinds.mjOBJ_ACTUATOR, range(model.nu), "actuator"),
        tuple(
            mujoco.mj_id2name(model, kinds.mjOBJ_SENSOR, k) or f"sensor_{k}" if kind in wanted else ""
            for k, kind in enumerate(model.sensor_type)
        ),
    )
