"""Write identified values and effects into a URDF file with one joint; the format has no place for some."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from labhil.simulators.mechanism import FRICTION_FIELDS, Field, read_value
from labhil.simulators.mjcf_file import MechanismFile
from labhil.simulators.patches import PatchedFile, drop_inactive, format_number, merge_holding_friction
from labhil.simulators.urdf_text import inertial_of_link, scale_mass, set_dynamics, set_inertial
from labhil.simulators.xml_text import XmlText

ROTOR = "added_inertia.inertia"
JOINT_ATTRIBUTES = {
    FRICTION_FIELDS[Field.DAMPING]: "damping",
    FRICTION_FIELDS[Field.FRICTIONLOSS]: "friction",
}


def patch_urdf(file: MechanismFile, text: XmlText, values: Mapping[str, float]) -> PatchedFile:
    """Write values into the text of a URDF file with one joint that moves.

    URDF has no rotor inertia. It becomes inertia of the link, equal about all axes: that acts on the joint in
    the same way.

    Args:
        file: The file as it was read.
        text: Its text.
        values: Values of its own parameters and of effects, by name.

    Returns:
        The text with its changes, and the remaining values.

    Raises:
        UsageError: An element is not in the file.
    """
    remaining, model = merge_holding_friction(file, values), file.model
    joint, link = file.joint_name or "", file.body_name(int(model.jnt_bodyid[0])) or ""
    for value in file.mechanism.values:
        if value.name in remaining and value.field is Field.MASS:
            old, new = read_value(model, value.field, value.index), remaining.pop(value.name)
            if abs(new - old) > 1e-9 * old:
                reason = f"{value.name}: {format_number(old)} → {format_number(new)} {value.unit}"
                scale_mass(text, file.body_name(value.index) or "", new / old, reason)
    for name, attribute in JOINT_ATTRIBUTES.items():
        if remaining.get(name, -1.0) >= 0.0:
            new = remaining.pop(name)
            if new != read_value(model, next(f for f, n in FRICTION_FIELDS.items() if n == name), 0):
                set_dynamics(text, joint, attribute, new, f"{name} = {format_number(new)}")
    inertia = remaining.pop(ROTOR, 0.0)
    if inertia:
        pi = inertial_of_link(text, link)
        pi[4:7] += inertia
        set_inertial(text, link, pi, f"{ROTOR} = {format_number(inertia)}")
    return PatchedFile(text, drop_inactive(remaining))


def shorten_urdf_step(file: MechanismFile, text: XmlText, substeps: int) -> None:
    """Divide MuJoCo's time step by ``substeps``, in the element <mujoco> that other readers ignore."""
    step = format_number(file.mechanism.timestep / substeps)
    reason = "the error of a step was larger than the remaining error"
    root, options = text.elements[0], text.inside("option", "mujoco")
    extensions = text.children(root, "mujoco")
    if options:
        text.set(options[-1], "timestep", step, reason)
    elif extensions:
        text.add(extensions[0], f'<option timestep="{step}"/>', reason)
    else:
        text.add(root, f'<mujoco><option timestep="{step}"/></mujoco>', reason)


def stiffen_model_friction(model: object, timestep: float) -> None:
    """Make the dry friction of a loaded model as firm as its time step (s) allows; URDF has no attribute."""
    solver = np.array([2.0 * timestep, 1.0])
    model.dof_solref[:] = solver  # type: ignore[attr-defined]
    model.dof_solimp[:, :3] = 0.99, 0.999, 0.001  # type: ignore[attr-defined]
