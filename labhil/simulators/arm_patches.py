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
from labhil.simulators.arm_file import ArmFile, matrix_of, rotation_about
from labhil.simulators.inertia import at_centre, realised
from labhil.simulators.patches import number, set_part, stiffen_element
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
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
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


def patched_arm(
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
    writer: ArmWriter = UrdfWriter(arm, text) if text.elements[0].tag == "robot" else MjcfWriter(arm, text)
    own = np.concatenate(
        [moved(writer.inertial(j), -np.array(arm.model.jnt_pos[j])) for j in range(arm.tree.joints)]
    )
    rotors = np.array([values.get(keyed(ROTOR, joint), 0.0) for joint in range(arm.tree.joints)])
    bodies = realised(arm.tree, own, inertial, arm.tree.begin - own, rotors)
    rotors_left = {keyed(ROTOR, joint): float(j) for joint, j in enumerate(bodies.armature) if j}
    left = {key: value for key, value in values.items() if not key.startswith(ROTOR)} | rotors_left
    for joint in range(arm.tree.joints):
        for name in JOINT_VALUES:
            key = keyed(name, joint)
            now, new = arm.nominal[key], left.get(key, 0.0)
            if key in left and (new == now or writer.set_joint(joint, name, new)):
                del left[key]
            elif key not in left and now:
                writer.set_joint(joint, name, 0.0)
    said = not firm or all(writer.stiffen(joint) for joint in range(arm.tree.joints))
    _set_bodies(arm, writer, own, bodies.inertial, payload)
    return PatchedArm(text, {key: value for key, value in left.items() if value}, unsaid=not said)


def _set_bodies(
    arm: ArmFile, writer: ArmWriter, own: FloatArray, found: FloatArray, payload: FloatArray
) -> None:
    """Change the bodies with the joints; what is fixed to them stays."""
    both = zip(own.reshape(-1, PER_LINK), found.reshape(-1, PER_LINK), strict=True)
    for joint, (before, after) in enumerate(both):
        whys = [] if np.array_equal(before, after) else ["what the joints carry"]
        if joint == arm.tree.joints - 1 and payload[0]:
            whys.append(f"a payload of {number(payload[0])} kg")
        if whys:
            carried = after + payload if joint == arm.tree.joints - 1 else after
            writer.set_inertial(joint, moved(carried, np.array(arm.model.jnt_pos[joint])), " and ".join(whys))


def moved(pi: FloatArray, by: FloatArray) -> FloatArray:
    """The same body's parameters about an origin from which it lies ``by`` (3,) m farther."""
    if not np.any(by):
        return pi
    m, h = pi[0], np.asarray(pi[1:4])
    new = h + m * by

    def steiner(first: FloatArray) -> FloatArray:
        """m·(c² − c·cᵀ) of a first moment m·c, (3, 3)."""
        return np.asarray((first @ first * np.eye(3) - np.outer(first, first)) / m) if m else np.zeros((3, 3))

    change = steiner(new) - steiner(h)
    moments = pi[4:] + np.array([*np.diag(change), change[0, 1], change[0, 2], change[1, 2]])
    return np.array([m, *new, *moments])


def tidy(values: FloatArray, form: str = "{:.6g}") -> list[str]:
    """Numbers as they are written; what is nothing beside the largest is 0."""
    least = 1e-9 * float(np.max(np.abs(values)))
    return [form.format(float(x) if abs(x) > least else 0.0) for x in values]


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
        found = self.text.inside(tag, "worldbody")
        named = [e for e in found if e.attributes.get("name") == name]
        if len(named) == 1:
            return named[0]
        if not named and place < len(found) and "name" not in found[place].attributes:
            return found[place]
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
        element = self._named("joint", self._arm.joints[joint])
        dynamics = self.text.children(element, "dynamics")
        why = f"{name} = {number(value)}"
        if dynamics:
            self.text.set(dynamics[0], attribute, number(value), why)
        else:
            self.text.add_attribute_of_new(element, "dynamics", attribute, number(value), why)
        return True

    def set_inertial(self, joint: int, pi: FloatArray, why: str) -> None:
        """Set mass, <origin> and <inertia>, whose axes are then those of the link.

        MuJoCo takes links that are fixed to another one into that; they stay as they are.
        """
        link = self._named("link", self._arm.bodies[joint])
        m, centre, i = at_centre(pi)
        place = " ".join(tidy(centre))
        moments = dict(zip(MOMENTS, tidy(i[np.triu_indices(3)], "{:.9g}"), strict=True))
        inertial = self.text.children(link, "inertial")
        if not inertial:
            stated = " ".join(f'{name}="{value}"' for name, value in moments.items())
            self.text.add(
                link,
                f'<inertial><origin xyz="{place}"/><mass value="{number(m)}"/><inertia {stated}/></inertial>',
                why,
            )
            return
        parts = {e.tag: e for e in self.text.children(inertial[0])}
        if "origin" in parts:
            self.text.set(parts["origin"], "xyz", place, why)
            self.text.drop(parts["origin"], "rpy", why)
        else:
            self.text.add(inertial[0], f'<origin xyz="{place}"/>', why)
        self.text.set(parts["mass"], "value", number(m), why)
        for name, value in moments.items():
            self.text.set(parts["inertia"], name, value, why)

    def inertial(self, joint: int) -> FloatArray:
        """Of the link, as the text has it."""
        link = self._named("link", self._arm.bodies[joint])
        parts = {e.tag: e.attributes for e in self.text.elements if link.number in e.above}
        if "mass" not in parts:
            return np.zeros(PER_LINK)
        origin, moments = parts.get("origin", {}), parts.get("inertia", {})
        roll, pitch, yaw = (float(x) for x in origin.get("rpy", "0 0 0").split())
        axes = rotation_about(np.array([0.0, 0.0, 1.0]), yaw)
        axes = axes @ rotation_about(np.array([0.0, 1.0, 0.0]), pitch)
        axes = axes @ rotation_about(np.array([1.0, 0.0, 0.0]), roll)
        i = np.zeros((3, 3))
        for name, at in zip(MOMENTS, zip(*np.triu_indices(3), strict=True), strict=True):
            i[at] = i[at[::-1]] = float(moments.get(name, 0.0))
        i = axes @ i @ axes.T
        centre = tuple(float(x) for x in origin.get("xyz", "0 0 0").split())
        six = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        return inertial_of(float(parts["mass"]["value"]), centre, six)

    def stiffen(self, joint: int) -> bool:
        """URDF does not say how friction is solved."""
        return False

    def _named(self, tag: str, name: str) -> Element:
        found = [e for e in self.text.elements if e.tag == tag and len(e.above) == 1]
        named = [e for e in found if e.attributes.get("name") == name]
        if len(named) != 1:
            raise UsageError(f"{self.text.path}: expected one <{tag} name={name!r}>, found {len(named)}")
        return named[0]
