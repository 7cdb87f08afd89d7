"""Values and effects of one joint as changes of a URDF file; what it cannot hold is left over."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from labhil.simulators.mechanism import RUBS, Field, read_value
from labhil.simulators.mjcf_file import Described
from labhil.simulators.patches import Patched, number, with_holding, without_shapes
from labhil.simulators.urdf_text import inertial_of_link, scale_mass, set_dynamics, set_inertial
from labhil.simulators.xml_text import XmlText

ROTOR = "added_inertia.inertia"
HELD = {RUBS[Field.DAMPING]: "damping", RUBS[Field.FRICTIONLOSS]: "friction"}


def patch_urdf(described: Described, text: XmlText, values: Mapping[str, float]) -> Patched:
    """Put values into the text of a URDF file with one joint that moves.

    Inertia about the joint is written as that of its link, equal about all axes, which the joint cannot tell
    from a rotor's.

    Args:
        described: The file as it was read.
        text: Its text.
        values: Values of its own parameters and of effects, by name.

    Returns:
        The text with its changes, and what of the values it cannot hold.

    Raises:
        UsageError: The file does not itself have what is to be changed.
    """
    remaining, model = with_holding(described, values), described.model
    joint, link = described.joint_name or "", described.body_name(int(model.jnt_bodyid[0])) or ""
    for value in described.mechanism.values:
        if value.name in remaining and value.field is Field.MASS:
            old, new = read_value(model, value.field, value.of), remaining.pop(value.name)
            if abs(new - old) > 1e-9 * old:
                why = f"{value.name}: {number(old)} → {number(new)} {value.unit}"
                scale_mass(text, described.body_name(value.of) or "", new / old, why)
    for name, attribute in HELD.items():
        if remaining.get(name, -1.0) >= 0.0:
            new = remaining.pop(name)
            if new != read_value(model, next(f for f, n in RUBS.items() if n == name), 0):
                set_dynamics(text, joint, attribute, new, f"{name} = {number(new)}")
    inertia = remaining.pop(ROTOR, 0.0)
    if inertia:
        pi = inertial_of_link(text, link)
        pi[4:7] += inertia
        set_inertial(text, link, pi, f"{ROTOR} = {number(inertia)}")
    return Patched(text, without_shapes(remaining))


def shorten_urdf_step(described: Described, text: XmlText, parts: int) -> None:
    """Say MuJoCo's time step in the element that URDF readers pass over."""
    step = number(described.mechanism.timestep / parts)
    why = "its own error of a step was larger than what is left"
    root, options = text.elements[0], text.inside("option", "mujoco")
    extensions = text.children(root, "mujoco")
    if options:
        text.set(options[-1], "timestep", step, why)
    elif extensions:
        text.add(extensions[0], f'<option timestep="{step}"/>', why)
    else:
        text.add(root, f'<mujoco><option timestep="{step}"/></mujoco>', why)


def firm_friction(model: object, timestep: float) -> None:
    """Let a loaded model's dry friction hold firmly: URDF cannot say so."""
    solver = np.array([2.0 * timestep, 1.0])
    model.dof_solref[:] = solver  # type: ignore[attr-defined]
    model.dof_solimp[:, :3] = 0.99, 0.999, 0.001  # type: ignore[attr-defined]
