"""The rigid body of the arm: a MuJoCo model written from the table of links, and its inverse dynamics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, sin
from typing import Any

import numpy as np

from labhil.extras import load_optional
from labhil.plants.arm.links import JOINTS, Link, Links, Vector
from labhil.signals import FloatArray

GRAVITY = 9.81
"""m/s²."""
CABLE_ON_FOREARM: Vector = (0.12, 0.0, 0.10)
CABLE_ON_FLANGE: Vector = (0.05, 0.0, -0.01)
"""Ends of the hidden cable, m, in the frames of link 3 (from 1) and of the flange."""


@dataclass(frozen=True, slots=True)
class Load:
    """Payload, tilt of the base, and cable.

    Attributes:
        mass: Mass of the payload, a point, kg.
        centre: Its position in the flange's frame, m.
        roll: Roll of the base about its x axis, rad, before
        pitch: its pitch about the y axis of the floor, rad.
        cable_stiffness: Stiffness of a cable between forearm and flange, N/m.
        cable_length: Length above which the cable is taut, m.
    """

    mass: float = 0.0
    centre: Vector = (0.0, 0.0, 0.0)
    roll: float = 0.0
    pitch: float = 0.0
    cable_stiffness: float = 0.0
    cable_length: float = 0.0

    @classmethod
    def of(cls, values: Mapping[str, float]) -> Load:
        """Take it from the parameters of a plant."""
        return cls(
            mass=values.get("payload.mass", 0.0),
            centre=(
                values.get("payload.centre_x", 0.0),
                values.get("payload.centre_y", 0.0),
                values.get("payload.centre_z", 0.0),
            ),
            roll=values.get("base_tilt.roll", 0.0),
            pitch=values.get("base_tilt.pitch", 0.0),
            cable_stiffness=values.get("hidden_cable.stiffness", 0.0),
            cable_length=values.get("hidden_cable.length", 0.0),
        )

    def gravity(self) -> Vector:
        """Gravity (m/s²) in the frame of the base: Rᵀ·(0, 0, −g) with R = Rot_y(pitch)·Rot_x(roll)."""
        upright = GRAVITY * cos(self.pitch)
        return (GRAVITY * sin(self.pitch), -upright * sin(self.roll), -upright * cos(self.roll))


class RigidBody:
    """Rigid links with one hinge each; MissingExtraError without the package ``mujoco``."""

    def __init__(self, links: Links, load: Load | None = None) -> None:
        engine = physics_engine()
        self.model = engine.MjModel.from_xml_string(to_mjcf(links, load or Load()))
        self.data = engine.MjData(self.model)
        self._inverse = engine.mj_inverse
        self._forward = engine.mj_forward

    def torques(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Return the joint torques (n, 6) N·m of a motion (n, 6): M(q)·q̈ + C(q, q̇)·q̇ + G(q), eq. 4.52."""
        out = np.empty((len(q), JOINTS))
        model, data, inverse = self.model, self.data, self._inverse
        angles, rates, accelerations, torques = data.qpos, data.qvel, data.qacc, data.qfrc_inverse
        for i in range(len(q)):
            angles[:] = q[i]
            rates[:] = qd[i]
            accelerations[:] = qdd[i]
            inverse(model, data)
            out[i] = torques
        return out

    def accelerations(self, q: FloatArray, qd: FloatArray, torque: FloatArray) -> FloatArray:
        """Return the joint accelerations (6,) rad/s² under joint torques (6,) N·m, armature included.

        The array belongs to the engine and is valid until the next call.
        """
        self.data.qpos[:] = q
        self.data.qvel[:] = qd
        self.data.qfrc_applied[:] = torque
        self._forward(self.model, self.data)
        return np.asarray(self.data.qacc)

    def set_armature(self, armature: FloatArray) -> None:
        """Add to the diagonal of M in :meth:`accelerations` and :meth:`torques`, (6,) kg·m²."""
        self.model.dof_armature[:] = armature


def physics_engine() -> Any:
    """Return the module ``mujoco``; MissingExtraError names the extra that brings it."""
    return load_optional("mujoco", "the simulated arm")


def to_mjcf(links: Links, load: Load) -> str:
    """Return the arm as an MJCF document, one body per link."""
    children = _payload(load) + _site("flange", CABLE_ON_FLANGE)
    for number in reversed(range(JOINTS)):
        site = _site("forearm", CABLE_ON_FOREARM) if number == 2 else ""
        children = _body(number, links.links[number], site + children)
    return (
        f'<mujoco model="{links.name}"><compiler angle="radian" autolimits="false"/>'
        f'<option gravity="{_numbers(load.gravity())}">'
        '<flag contact="disable" constraint="disable"/></option>'
        f"<worldbody>{children}</worldbody>{_cable(load)}</mujoco>"
    )


def _body(number: int, link: Link, children: str) -> str:
    """Return a link with its children: frame at angle zero, hinge and inertia."""
    c, s = cos(link.alpha), sin(link.alpha)
    hinge = (-link.a, -link.d * s, -link.d * c)
    turned = (cos(link.alpha / 2), sin(link.alpha / 2), 0.0, 0.0)
    return (
        f'<body name="link_{number}" pos="{_numbers((link.a, 0.0, link.d))}" quat="{_numbers(turned)}">'
        f'<joint name="joint_{number}" type="hinge" axis="{_numbers((0.0, s, c))}" pos="{_numbers(hinge)}"/>'
        f'<inertial pos="{_numbers(link.centre)}" mass="{link.mass!r}"'
        f' fullinertia="{_numbers(link.inertia)}"/>'
        f"{children}</body>"
    )


def _payload(load: Load) -> str:
    if load.mass == 0.0:
        return ""
    place = _numbers(load.centre)
    return f'<body name="payload"><inertial pos="{place}" mass="{load.mass!r}" diaginertia="0 0 0"/></body>'


def _site(name: str, place: Vector) -> str:
    return f'<site name="{name}" pos="{_numbers(place)}"/>'


def _cable(load: Load) -> str:
    if load.cable_stiffness == 0.0:
        return ""
    return (
        f'<tendon><spatial name="cable" stiffness="{load.cable_stiffness!r}"'
        f' springlength="0 {load.cable_length!r}">'
        '<site site="forearm"/><site site="flange"/></spatial></tendon>'
    )


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)
