"""Parts of a URDF's text: what a link carries, and how a joint rubs."""

from __future__ import annotations

import numpy as np

from labhil.errors import UsageError
from labhil.physics.arm.links import inertial_of
from labhil.physics.arm.rigid_body import PER_LINK
from labhil.signals import FloatArray
from labhil.simulators.arm_file import rotation_about
from labhil.simulators.inertia import at_centre
from labhil.simulators.xml_text import Element, XmlText

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def tidy(values: FloatArray, form: str = "{:.6g}") -> list[str]:
    """Numbers as they are written; what is nothing beside the largest is 0."""
    least = 1e-9 * float(np.max(np.abs(values)))
    return [form.format(float(x) if abs(x) > least else 0.0) for x in values]


def find_named(text: XmlText, tag: str, name: str) -> Element:
    """The only <link> or <joint> of a name; UsageError where there is not one."""
    matches = [e for e in text.elements if e.tag == tag and len(e.above) == 1]
    matches = [e for e in matches if e.attributes.get("name") == name]
    if len(matches) != 1:
        raise UsageError(f"{text.path}: expected one <{tag} name={name!r}>, found {len(matches)}")
    return matches[0]


def set_dynamics(text: XmlText, joint: str, attribute: str, value: float, why: str) -> None:
    """Set ``damping`` or ``friction`` of a joint."""
    element = find_named(text, "joint", joint)
    dynamics = text.children(element, "dynamics")
    if dynamics:
        text.set(dynamics[0], attribute, f"{value:.6g}", why)
    else:
        text.add_attribute_of_new(element, "dynamics", attribute, f"{value:.6g}", why)


def inertial_of_link(text: XmlText, link: str) -> FloatArray:
    """Ten inertial parameters of a link, about its origin; zeros where it has none."""
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


def set_inertial(text: XmlText, link: str, pi: FloatArray, why: str) -> None:
    """Set mass, <origin> and <inertia> of a link, whose axes are then those of the link."""
    element = find_named(text, "link", link)
    m, centre, i = at_centre(pi)
    place = " ".join(tidy(centre))
    moments = dict(zip(MOMENTS, tidy(i[np.triu_indices(3)], "{:.9g}"), strict=True))
    inertial = text.children(element, "inertial")
    if not inertial:
        stated = " ".join(f'{name}="{value}"' for name, value in moments.items())
        mass = f'<origin xyz="{place}"/><mass value="{m:.6g}"/>'
        text.add(element, f"<inertial>{mass}<inertia {stated}/></inertial>", why)
        return
    parts = {e.tag: e for e in text.children(inertial[0])}
    if "origin" in parts:
        text.set(parts["origin"], "xyz", place, why)
        text.drop(parts["origin"], "rpy", why)
    else:
        text.add(inertial[0], f'<origin xyz="{place}"/>', why)
    text.set(parts["mass"], "value", f"{m:.6g}", why)
    for name, value in moments.items():
        text.set(parts["inertia"], name, value, why)


def scale_mass(text: XmlText, link: str, ratio: float, why: str) -> None:
    """Scale the mass of a link and of those that are fixed to it, their inertia with it."""
    for name in (link, *_links_fixed_to(text, link)):
        for inertial in text.children(find_named(text, "link", name), "inertial"):
            for part in text.children(inertial):
                for attribute in {"mass": ("value",), "inertia": MOMENTS}.get(part.tag, ()):
                    now = text.current(part, attribute)
                    if now is not None and float(now):
                        text.set(part, attribute, f"{float(now) * ratio:.6g}", why)


def _links_fixed_to(text: XmlText, link: str) -> list[str]:
    links = []
    for joint in (e for e in text.elements if e.tag == "joint" and len(e.above) == 1):
        ends = {e.tag: e.attributes.get("link", "") for e in text.children(joint)}
        if joint.attributes.get("type") == "fixed" and ends.get("parent") == link:
            links += [ends["child"], *_links_fixed_to(text, ends["child"])]
    return links
