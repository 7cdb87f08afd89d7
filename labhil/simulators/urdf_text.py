"""Read and change inertias of links and friction of joints in the text of a URDF file."""

from __future__ import annotations

import numpy as np

from labhil.errors import UsageError
from labhil.physics.arm.links import inertial_of
from labhil.physics.arm.rigid_body import PER_LINK
from labhil.signals import FloatArray
from labhil.simulators.arm_file import rotation_about
from labhil.simulators.inertia import centroidal
from labhil.simulators.xml_text import Element, XmlText

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def format_numbers(values: FloatArray, form: str = "{:.6g}") -> list[str]:
    """Format numbers; those below 1e-9 of the largest become 0."""
    least = 1e-9 * float(np.max(np.abs(values)))
    return [form.format(float(x) if abs(x) > least else 0.0) for x in values]


def find_named(text: XmlText, tag: str, name: str) -> Element:
    """Return the <link> or <joint> of a name; UsageError unless there is exactly one."""
    matches = [e for e in text.elements if e.tag == tag and len(e.ancestors) == 1]
    matches = [e for e in matches if e.attributes.get("name") == name]
    if len(matches) != 1:
        raise UsageError(f"{text.path}: expected one <{tag} name={name!r}>, found {len(matches)}")
    return matches[0]


def set_dynamics(text: XmlText, joint: str, attribute: str, value: float, reason: str) -> None:
    """Set ``damping`` or ``friction`` of a joint."""
    element = find_named(text, "joint", joint)
    dynamics = text.children(element, "dynamics")
    if dynamics:
        text.set(dynamics[0], attribute, f"{value:.6g}", reason)
    else:
        text.add_attribute_of_new(element, "dynamics", attribute, f"{value:.6g}", reason)


def inertial_of_link(text: XmlText, link: str) -> FloatArray:
    """Return the ten inertial parameters of a link about its origin; zeros where it has none."""
    element = find_named(text, "link", link)
    parts = {e.tag: e for inertial in text.children(element, "inertial") for e in text.children(inertial)}

    def stated(tag: str, attribute: str, absent: str) -> list[float]:
        value = text.current(parts[tag], attribute) if tag in parts else None
        return [float(x) for x in (value or absent).split()]

    if "mass" not in parts:
        return np.zeros(PER_LINK)
    roll, pitch, yaw = stated("origin", "rpy", "0 0 0")
    x, y, z = np.eye(3)
    axes = rotation_about(z, yaw) @ rotation_about(y, pitch) @ rotation_about(x, roll)
    i = np.zeros((3, 3))
    for name, row, column in zip(MOMENTS, *np.triu_indices(3), strict=True):
        i[row, column] = i[column, row] = stated("inertia", name, "0")[0]
    i = axes @ i @ axes.T
    centre = tuple(stated("origin", "xyz", "0 0 0"))
    six = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
    return inertial_of(stated("mass", "value", "0")[0], centre, six)


def set_inertial(text: XmlText, link: str, pi: FloatArray, reason: str) -> None:
    """Set mass, <origin> and <inertia> of a link, along the axes of the link."""
    element = find_named(text, "link", link)
    m, centre, i = centroidal(pi)
    index = " ".join(format_numbers(centre))
    moments = dict(zip(MOMENTS, format_numbers(i[np.triu_indices(3)], "{:.9g}"), strict=True))
    inertial = text.children(element, "inertial")
    if not inertial:
        stated = " ".join(f'{name}="{value}"' for name, value in moments.items())
        mass = f'<origin xyz="{index}"/><mass value="{m:.6g}"/>'
        text.add(element, f"<inertial>{mass}<inertia {stated}/></inertial>", reason)
        return
    parts = {e.tag: e for e in text.children(inertial[0])}
    if "origin" in parts:
        text.set(parts["origin"], "xyz", index, reason)
        text.drop(parts["origin"], "rpy", reason)
    else:
        text.add(inertial[0], f'<origin xyz="{index}"/>', reason)
    text.set(parts["mass"], "value", f"{m:.6g}", reason)
    for name, value in moments.items():
        text.set(parts["inertia"], name, value, reason)


def scale_mass(text: XmlText, link: str, ratio: float, reason: str) -> None:
    """Scale mass and inertia of a link and of those that are fixed to it."""
    for name in (link, *_links_fixed_to(text, link)):
        for inertial in text.children(find_named(text, "link", name), "inertial"):
            for part in text.children(inertial):
                for attribute in {"mass": ("value",), "inertia": MOMENTS}.get(part.tag, ()):
                    current = text.current(part, attribute)
                    if current is not None and float(current):
                        text.set(part, attribute, f"{float(current) * ratio:.6g}", reason)


def _links_fixed_to(text: XmlText, link: str) -> list[str]:
    links = []
    for joint in (e for e in text.elements if e.tag == "joint" and len(e.ancestors) == 1):
        links_of_joint = {e.tag: e.attributes.get("link", "") for e in text.children(joint)}
        if joint.attributes.get("type") == "fixed" and links_of_joint.get("parent") == link:
            links += [links_of_joint["child"], *_links_fixed_to(text, links_of_joint["child"])]
    return links
