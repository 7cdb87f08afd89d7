"""Write values and effects of an arm into its file, MJCF or URDF; the formats have no place for some.

:mod:`labhil.simulators.arm_companion` writes those as Python functions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from labhil.errors import UsageError
from labhil.physics.arm.links import inertial_of
from labhil.physics.arm.rigid_body import PER_LINK
from labhil.physics.terms import keyed
from labhil.signals import FloatArray
from labhil.simulators.arm_file import ArmFile, matrix_of
from labhil.simulators.inertia import centroidal, nearest_bodies, shift_origin
from labhil.simulators.patches import format_number, set_part, stiffen_element
from labhil.simulators.urdf_text import format_numbers, inertial_of_link, set_dynamics, set_inertial
from labhil.simulators.xml_text import Element, XmlText

JOINT_VALUES = {
    "viscous_friction.coefficient": "damping",
    "coulomb_friction.level": "frictionloss",
    "added_inertia.inertia": "armature",
    "quadratic_viscous_friction.coefficient": "damping of the square",
    "cubic_viscous_friction.coefficient": "damping of the cube",
}
"""Effects for which files have an attribute of the joint, and the attribute."""

ROTOR = "added_inertia.inertia"
ORIENTATION_ATTRIBUTES = ("quat", "euler", "axisangle", "xyaxes", "zaxis", "diaginertia")


class ArmWriter(Protocol):
    """Writes values into the text of a file."""

    text: XmlText

    def set_joint(self, joint: int, name: str, value: float) -> bool:
        """Write a value of a joint; False where the format has no attribute for it."""
        ...

    def inertial(self, joint: int) -> FloatArray:
        """Return the ten inertial parameters of the joint's body alone, about the origin of its frame."""
        ...

    def set_inertial(self, joint: int, pi: FloatArray, reason: str) -> None:
        """Write ten inertial parameters of the joint's body, about the origin of its frame."""
        ...

    def stiffen(self, joint: int) -> bool:
        """Make dry friction as firm as the time step allows; False where the format has no attribute."""
        ...


@dataclass(frozen=True, slots=True)
class PatchedArm:
    """An arm's file with its changes.

    Attributes:
        text: The text.
        remaining: Values, by key, for which the format has no attribute.
        needs_firm_friction: Whether dry friction has to be firm although the format has no attribute for it.
        is_urdf: Whether the file is URDF.
    """

    text: XmlText
    remaining: Mapping[str, float]
    needs_firm_friction: bool
    is_urdf: bool


def patch_arm(
    arm: ArmFile,
    text: XmlText,
    values: Mapping[str, float],
    inertial: FloatArray,
    payload: FloatArray,
    *,
    firm: bool = False,
) -> PatchedArm:
    """Write values into the text of an arm's file.

    Args:
        arm: The file as it was read.
        text: Its text.
        values: Values of effects by key (``coulomb_friction.level[1]``).
        inertial: Inertial parameters of the links without payload, (10 n,).
        payload: Inertial parameters of the payload in the frame of the last joint, (10,).
        firm: Whether dry friction is made as firm as the time step allows.

    Returns:
        The text with its changes, and the remaining values.

    Raises:
        UsageError: An element is not in the file itself.
    """
    urdf = text.elements[0].tag == "robot"
    writer: ArmWriter = UrdfWriter(arm, text) if urdf else MjcfWriter(arm, text)
    in_file = np.concatenate(
        [shift_origin(writer.inertial(j), -np.array(arm.model.jnt_pos[j])) for j in range(arm.tree.joints)]
    )
    rotors = np.array([values.get(keyed(ROTOR, joint), 0.0) for joint in range(arm.tree.joints)])
    bodies = nearest_bodies(arm.tree, in_file, inertial, arm.tree.begin - in_file, rotors)
    remaining_rotors = {keyed(ROTOR, joint): float(j) for joint, j in enumerate(bodies.armature) if j}
    remaining = {key: value for key, value in values.items() if not key.startswith(ROTOR)} | remaining_rotors
    for joint in range(arm.tree.joints):
        for name in JOINT_VALUES:
            key = keyed(name, joint)
            now, new = arm.nominal[key], remaining.get(key, 0.0)
            if key in remaining and (new == now or writer.set_joint(joint, name, new)):
                del remaining[key]
            elif key not in remaining and now:
                writer.set_joint(joint, name, 0.0)
    holds_firmly = not firm or all(writer.stiffen(joint) for joint in range(arm.tree.joints))
    _set_bodies(arm, writer, in_file, bodies.inertial, payload)
    return PatchedArm(text, {key: value for key, value in remaining.items() if value}, not holds_firmly, urdf)


def _set_bodies(
    arm: ArmFile, writer: ArmWriter, in_file: FloatArray, wanted: FloatArray, payload: FloatArray
) -> None:
    """Change the bodies with joints; bodies that are fixed to them stay."""
    both = zip(in_file.reshape(-1, PER_LINK), wanted.reshape(-1, PER_LINK), strict=True)
    for joint, (before, after) in enumerate(both):
        reasons = [] if np.array_equal(before, after) else ["what the joints carry"]
        if joint == arm.tree.joints - 1 and payload[0]:
            reasons.append(f"a payload of {format_number(payload[0])} kg")
        if reasons:
            carried = after + payload if joint == arm.tree.joints - 1 else after
            writer.set_inertial(
                joint, shift_origin(carried, np.array(arm.model.jnt_pos[joint])), " and ".join(reasons)
            )


class MjcfWriter:
    """Writes an MJCF file."""

    def __init__(self, arm: ArmFile, text: XmlText) -> None:
        if text.elements[0].tag != "mujoco":
            raise UsageError(
                f"{text.path}: expected MJCF (<mujoco>) or URDF (<robot>), found <{text.elements[0].tag}>"
            )
        self.text, self._arm = text, arm

    def set_joint(self, joint: int, name: str, value: float) -> bool:
        """Set an attribute of a joint; damping may have a quadratic and a cubic part."""
        model, element = self._arm.model, self._element("joint", self._arm.joints[joint], joint)
        field = JOINT_VALUES[name]
        reason = f"{name} = {format_number(value)}"
        if not field.startswith("damping"):
            if value < 0.0:
                return False
            self.text.set(element, field, format_number(value), reason)
            return True
        index = ("damping", "damping of the square", "damping of the cube").index(field)
        if index and not hasattr(model, "dof_dampingpoly"):
            return False
        dof = int(model.jnt_dofadr[joint])
        parts_of_file = [float(model.dof_damping[dof])]
        parts_of_file += (
            [float(x) for x in model.dof_dampingpoly[dof]] if hasattr(model, "dof_dampingpoly") else []
        )
        set_part(self.text, element, "damping", index, value, parts_of_file, reason)
        return True

    def inertial(self, joint: int) -> FloatArray:
        """Return the parameters of the loaded body, from its <inertial> or its geoms."""
        model, body = self._arm.model, self._arm.groups[joint][0]
        axes = matrix_of(model.body_iquat[body])
        i = axes @ np.diag(model.body_inertia[body]) @ axes.T
        six = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        return inertial_of(float(model.body_mass[body]), tuple(model.body_ipos[body].tolist()), six)

    def set_inertial(self, joint: int, pi: FloatArray, reason: str) -> None:
        """Set or add the body's <inertial>, which takes precedence over masses of its geoms."""
        m, centre, i = centroidal(pi)
        body = self._element("body", self._arm.bodies[joint], self._arm.groups[joint][0] - 1)
        values = {
            "mass": format_number(m),
            "pos": " ".join(format_numbers(centre)),
            "fullinertia": " ".join(
                format_numbers(np.array([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]), "{:.9g}")
            ),
        }
        inertial = self.text.children(body, "inertial")
        if not inertial:
            stated = " ".join(f'{name}="{value}"' for name, value in values.items())
            self.text.add(body, f"<inertial {stated}/>", reason)
            return
        for name in ORIENTATION_ATTRIBUTES:
            self.text.drop(inertial[0], name, reason)
        for name, value in values.items():
            self.text.set(inertial[0], name, value, reason)

    def stiffen(self, joint: int) -> bool:
        """Set the solver parameters of the joint's friction."""
        element = self._element("joint", self._arm.joints[joint], joint)
        stiffen_element(self.text, element, float(self._arm.model.opt.timestep))
        return True

    def _element(self, tag: str, name: str, index: int) -> Element:
        candidates = self.text.inside(tag, "worldbody")
        named = [e for e in candidates if e.attributes.get("name") == name]
        if len(named) == 1:
            return named[0]
        if not named and index < len(candidates) and "name" not in candidates[index].attributes:
            return candidates[index]
        raise UsageError(
            f"{self.text.path}: expected the {tag} {name!r} in this file, found none; where it is included "
            "from another file, give that whole with --into"
        )


class UrdfWriter:
    """Writes a URDF file: <dynamics> of joints, <inertial> of links."""

    def __init__(self, arm: ArmFile, text: XmlText) -> None:
        self.text, self._arm = text, arm

    def set_joint(self, joint: int, name: str, value: float) -> bool:
        """Set damping or friction; URDF has no rotor inertia, and no quadratic or cubic damping."""
        attribute = {"damping": "damping", "frictionloss": "friction"}.get(JOINT_VALUES[name])
        if attribute is None or value < 0.0:
            return False
        set_dynamics(self.text, self._arm.joints[joint], attribute, value, f"{name} = {format_number(value)}")
        return True

    def inertial(self, joint: int) -> FloatArray:
        """Return the parameters of the link in the text."""
        return inertial_of_link(self.text, self._arm.bodies[joint])

    def set_inertial(self, joint: int, pi: FloatArray, reason: str) -> None:
        """Set the parameters of the link alone; links that are fixed to it stay as they are."""
        set_inertial(self.text, self._arm.bodies[joint], pi, reason)

    def stiffen(self, joint: int) -> bool:
        """Return False: URDF has no parameters of the friction solver."""
        return False
