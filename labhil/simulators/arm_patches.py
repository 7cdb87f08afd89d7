"""Values and effects of an arm as changes of its file, MJCF or URDF; what that cannot hold is left over."""

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
from labhil.simulators.inertia import at_centre, realise, shift_origin
from labhil.simulators.patches import number, set_part, stiffen_element
from labhil.simulators.urdf_text import inertial_of_link, set_dynamics, set_inertial, tidy
from labhil.simulators.xml_text import Element, XmlText

JOINT_VALUES = {
    "viscous_friction.coefficient": "damping",
    "coulomb_friction.level": "frictionloss",
    "added_inertia.inertia": "armature",
    "quadratic_viscous_friction.coefficient": "damping of the square",
    "cubic_viscous_friction.coefficient": "damping of the cube",
}
"""Effects that a file may hold of a joint, and what they are there."""

ROTOR = "added_inertia.inertia"
ORIENTED = ("quat", "euler", "axisangle", "xyaxes", "zaxis", "diaginertia")


class ArmWriter(Protocol):
    """Puts values into the text of a file."""

    text: XmlText

    def set_joint(self, joint: int, name: str, value: float) -> bool:
        """Put a value of a joint into the file; False where the format has no place for it."""
        ...

    def inertial(self, joint: int) -> FloatArray:
        """Ten inertial parameters of the joint's body alone, about the origin of its frame."""
        ...

    def set_inertial(self, joint: int, pi: FloatArray, why: str) -> None:
        """Put ten inertial parameters, about the origin of the body's frame, into the joint's body."""
        ...

    def stiffen(self, joint: int) -> bool:
        """Let dry friction of a joint hold as firmly as the time step allows; False: no place for that."""
        ...


@dataclass(frozen=True, slots=True)
class PatchedArm:
    """A file's text with its changes, and the values, by key, that it cannot hold.

    Where dry friction has to be firm and the format cannot say so, that is ``unsaid``.
    """

    text: XmlText
    left: Mapping[str, float]
    unsaid: bool
    urdf: bool


def patch_arm(
    arm: ArmFile,
    text: XmlText,
    values: Mapping[str, float],
    inertial: FloatArray,
    payload: FloatArray,
    *,
    firm: bool = False,
) -> PatchedArm:
    """Put values into the text of an arm's file.

    Args:
        arm: The file as it was read.
        text: Its text.
        values: Values of effects by key (``coulomb_friction.level[1]``).
        inertial: What the links are to act like, (10 n,), the payload excepted.
        payload: Ten inertial parameters that join the last link, in its joint's frame.
        firm: Whether dry friction is to hold as firmly as the time step allows.

    Returns:
        The text with its changes, and what it cannot hold.

    Raises:
        UsageError: The file does not itself have what is to be changed.
    """
    urdf = text.elements[0].tag == "robot"
    writer: ArmWriter = UrdfWriter(arm, text) if urdf else MjcfWriter(arm, text)
    in_file = np.concatenate(
        [shift_origin(writer.inertial(j), -np.array(arm.model.jnt_pos[j])) for j in range(arm.tree.joints)]
    )
    rotors = np.array([values.get(keyed(ROTOR, joint), 0.0) for joint in range(arm.tree.joints)])
    bodies = realise(arm.tree, in_file, inertial, arm.tree.begin - in_file, rotors)
    rotors_left = {keyed(ROTOR, joint): float(j) for joint, j in enumerate(bodies.armature) if j}
    remaining = {key: value for key, value in values.items() if not key.startswith(ROTOR)} | rotors_left
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
    """Change the bodies with the joints; what is fixed to them stays."""
    both = zip(in_file.reshape(-1, PER_LINK), wanted.reshape(-1, PER_LINK), strict=True)
    for joint, (before, after) in enumerate(both):
        whys = [] if np.array_equal(before, after) else ["what the joints carry"]
        if joint == arm.tree.joints - 1 and payload[0]:
            whys.append(f"a payload of {number(payload[0])} kg")
        if whys:
            carried = after + payload if joint == arm.tree.joints - 1 else after
            writer.set_inertial(
                joint, shift_origin(carried, np.array(arm.model.jnt_pos[joint])), " and ".join(whys)
            )


class MjcfWriter:
    """An MJCF file."""

    def __init__(self, arm: ArmFile, text: XmlText) -> None:
        if text.elements[0].tag != "mujoco":
            raise UsageError(
                f"{text.path}: expected MJCF (<mujoco>) or URDF (<robot>), found <{text.elements[0].tag}>"
            )
        self.text, self._arm = text, arm

    def set_joint(self, joint: int, name: str, value: float) -> bool:
        """Set an attribute of a joint; MuJoCo's damping may have a square and a cube."""
        model, element = self._arm.model, self._element("joint", self._arm.joints[joint], joint)
        field = JOINT_VALUES[name]
        why = f"{name} = {number(value)}"
        if not field.startswith("damping"):
            if value < 0.0:
                return False
            self.text.set(element, field, number(value), why)
            return True
        place = ("damping", "damping of the square", "damping of the cube").index(field)
        if place and not hasattr(model, "dof_dampingpoly"):
            return False
        dof = int(model.jnt_dofadr[joint])
        has = [float(model.dof_damping[dof])]
        has += [float(x) for x in model.dof_dampingpoly[dof]] if hasattr(model, "dof_dampingpoly") else []
        set_part(self.text, element, "damping", place, value, has, why)
        return True

    def inertial(self, joint: int) -> FloatArray:
        """Of the body, as MuJoCo has it of its <inertial> or its geoms."""
        model, body = self._arm.model, self._arm.groups[joint][0]
        axes = matrix_of(model.body_iquat[body])
        i = axes @ np.diag(model.body_inertia[body]) @ axes.T
        six = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        return inertial_of(float(model.body_mass[body]), tuple(model.body_ipos[body].tolist()), six)

    def set_inertial(self, joint: int, pi: FloatArray, why: str) -> None:
        """Set the body's <inertial>, or give it one, which MuJoCo takes in place of its geoms' masses."""
        m, centre, i = at_centre(pi)
        body = self._element("body", self._arm.bodies[joint], self._arm.groups[joint][0] - 1)
        values = {
            "mass": number(m),
            "pos": " ".join(tidy(centre)),
            "fullinertia": " ".join(
                tidy(np.array([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]), "{:.9g}")
            ),
        }
        inertial = self.text.children(body, "inertial")
        if not inertial:
            stated = " ".join(f'{name}="{value}"' for name, value in values.items())
            self.text.add(body, f"<inertial {stated}/>", why)
            return
        for name in ORIENTED:
            self.text.drop(inertial[0], name, why)
        for name, value in values.items():
            self.text.set(inertial[0], name, value, why)

    def stiffen(self, joint: int) -> bool:
        """As for one joint, see ``simulators.patches.stiffen_friction``."""
        element = self._element("joint", self._arm.joints[joint], joint)
        stiffen_element(self.text, element, float(self._arm.model.opt.timestep))
        return True

    def _element(self, tag: str, name: str, place: int) -> Element:
        candidates = self.text.inside(tag, "worldbody")
        named = [e for e in candidates if e.attributes.get("name") == name]
        if len(named) == 1:
            return named[0]
        if not named and place < len(candidates) and "name" not in candidates[place].attributes:
            return candidates[place]
        raise UsageError(
            f"{self.text.path}: expected the {tag} {name!r} in this file, found none; where it is included "
            "from another file, give that whole with --into"
        )


class UrdfWriter:
    """A URDF file: <dynamics> of a joint holds damping and friction, <inertial> of a link its mass."""

    def __init__(self, arm: ArmFile, text: XmlText) -> None:
        self.text, self._arm = text, arm

    def set_joint(self, joint: int, name: str, value: float) -> bool:
        """Set damping or friction; URDF has no rotor, and no friction by powers of the velocity."""
        attribute = {"damping": "damping", "frictionloss": "friction"}.get(JOINT_VALUES[name])
        if attribute is None or value < 0.0:
            return False
        set_dynamics(self.text, self._arm.joints[joint], attribute, value, f"{name} = {number(value)}")
        return True

    def inertial(self, joint: int) -> FloatArray:
        """Of the link, as the text has it."""
        return inertial_of_link(self.text, self._arm.bodies[joint])

    def set_inertial(self, joint: int, pi: FloatArray, why: str) -> None:
        """Of the link alone: MuJoCo takes links that are fixed to it into it; they stay as they are."""
        set_inertial(self.text, self._arm.bodies[joint], pi, why)

    def stiffen(self, joint: int) -> bool:
        """URDF does not say how friction is solved."""
        return False
