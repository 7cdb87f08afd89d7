"""Identified values and effects as changes of a MuJoCo file; what it cannot hold is left over."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil, degrees

from labhil.errors import UsageError
from labhil.simulators.mechanism import RUBS, Field, Value, read_value
from labhil.simulators.mjcf_file import Described
from labhil.simulators.xml_text import Element, XmlText

LONGER = 1.0 + 1e-9


HOLDING = ("stribeck_friction.level", "static_friction.level")
"""What holds at rest beyond dry friction: the file's dry friction holds with all of it, and what stands
beside the file gives it back as the joint moves (see ``simulators.companion``)."""


@dataclass(frozen=True, slots=True)
class Patched:
    """A file's text with its changes, and the values of effects that no attribute stands for.

    Its time step is the file's, cut into ``parts``. Where dry friction has to be firm and the format cannot
    say so, that is ``unsaid``.
    """

    text: XmlText
    left: Mapping[str, float]
    parts: int = 1
    unsaid: bool = False


def number(value: float) -> str:
    """A number as it is written into a file."""
    return f"{value:.6g}"


def patch_mjcf(described: Described, text: XmlText, values: Mapping[str, float]) -> Patched:
    """Put values into the text of a file.

    Args:
        described: The file as it was read.
        text: Its text.
        values: Values of its own parameters and of effects, by name ("coulomb_friction.level").

    Returns:
        The text with its changes, and what of the values no attribute can hold.

    Raises:
        UsageError: The file does not itself have what is to be changed (it includes another file).
    """
    if text.elements[0].tag != "mujoco":
        raise UsageError(
            f"{text.path}: expected an MJCF file (<mujoco>) or URDF (<robot>), found <{text.elements[0].tag}>"
        )
    in_file = {value.name: value for value in described.mechanism.values}
    remaining = with_holding(described, values)
    for name, value in in_file.items():
        if name in remaining:
            _set_value_of_file(described, text, value, remaining.pop(name))
    for name, put in EFFECTS.items():
        if name in remaining and put(described, text, remaining[name]):
            del remaining[name]
    return Patched(text, without_shapes(remaining))


def with_holding(described: Described, values: Mapping[str, float]) -> dict[str, float]:
    """Values with dry friction that holds with all of it; what the file has beside them is taken out."""
    rubs = {name: 0.0 for field, name in RUBS.items() if read_value(described.model, field, 0) != 0.0}
    merged = rubs | dict(values)
    held = sum(merged.get(name, 0.0) for name in HOLDING)
    if held:
        merged[RUBS[Field.FRICTIONLOSS]] = merged.get(RUBS[Field.FRICTIONLOSS], 0.0) + held
    return merged


def without_shapes(values: Mapping[str, float]) -> dict[str, float]:
    """Values that do something."""
    return {name: value for name, value in values.items() if value and _acts(name, values)}


def _acts(name: str, values: Mapping[str, float]) -> bool:
    """Whether a value is one of an effect that does something, and not the shape of one that does not."""
    term = name.partition(".")[0]
    shapes = {
        "stribeck_friction": ("stribeck_friction.level",),
        "cogging_torque": ("cogging_torque.sine", "cogging_torque.cosine"),
    }
    return any(values.get(level) for level in shapes.get(term, (name,)))


def stiffen_friction(described: Described, text: XmlText, parts: int = 1) -> None:
    """Let MuJoCo's dry friction hold as firmly as its time step, cut into parts, allows."""
    stiffen_element(text, _joint(described, text), described.mechanism.timestep / parts)


def stiffen_element(text: XmlText, joint: Element, step: float) -> None:
    """The same of one joint's element, for steps of so many seconds."""
    why = "dry friction as firm as the time step allows"
    text.set(joint, "solreffriction", f"{number(2.0 * step)} 1", why)
    text.set(joint, "solimpfriction", "0.99 0.999 0.001", why)


def shorten_step(described: Described, text: XmlText, parts: int) -> None:
    """Let MuJoCo make several steps of one."""
    step = described.mechanism.timestep / parts
    why = "its own error of a step was larger than what is left"
    options = [e for e in text.elements if e.tag == "option" and len(e.above) == 1]
    if options:
        text.set(options[-1], "timestep", number(step), why)
    else:
        text.add(text.elements[0], f'<option timestep="{number(step)}"/>', why)
    for actuator in text.inside("", "actuator"):
        count = text.current(actuator, "nsample")
        if count is not None:
            text.set(actuator, "nsample", str(int(count) * parts), why)


def _set_value_of_file(described: Described, text: XmlText, value: Value, new: float) -> None:
    """A value that the file has already."""
    old = read_value(described.model, value.field, value.of)
    if abs(new - old) <= 1e-9 * abs(old):
        return
    why = f"{value.name}: {number(old)} → {number(new)} {value.unit}"
    match value.field:
        case Field.MASS:
            _set_mass(described, text, value.of, new / old, why)
        case Field.GEAR:
            set_part(text, _actuator(described, text), "gear", 0, new, described.gear, why)
        case Field.KP | Field.KV:
            _set_gain(text, _actuator(described, text), value.field.value, new, why)
        case _:
            _set_of_joint(described, text, value.field, new, why)


def _set_of_joint(described: Described, text: XmlText, field: Field, new: float, why: str) -> None:
    joint, model = _joint(described, text), described.model
    if field is Field.SPRINGREF:
        angle = described.in_degrees(text)
        text.set(joint, "springref", number(degrees(new) if angle else new), why)
        return
    poly = {
        Field.DAMPING: ("damping", 0),
        Field.QUADRATIC_DAMPING: ("damping", 1),
        Field.CUBIC_DAMPING: ("damping", 2),
    }
    if field not in poly:
        text.set(joint, field.value, number(new), why)
        return
    attribute, place = poly[field]
    now = text.current(joint, attribute)
    has = [read_value(model, f, 0) for f in poly] if now is None else [float(x) for x in now.split()]
    set_part(text, joint, attribute, place, new, has, why)


def set_part(
    text: XmlText, element: Element, attribute: str, place: int, new: float, has: list[float], why: str
) -> None:
    """One of several numbers of an attribute; zeros at the end are left out."""
    now = text.current(element, attribute)
    parts = [number(x) for x in has] if now is None else now.split()
    parts += ["0"] * (place + 1 - len(parts))
    parts[place] = number(new)
    if now is None:
        while len(parts) > 1 and float(parts[-1]) == 0.0:
            parts.pop()
    text.set(element, attribute, " ".join(parts), why)


def _set_gain(text: XmlText, actuator: Element, attribute: str, new: float, why: str) -> None:
    if actuator.tag not in ("position", "velocity", "intvelocity"):
        raise UsageError(
            f"{text.path}: {actuator.label()}: expected position or velocity, whose {attribute} can be "
            f"changed, found {actuator.tag}; state {attribute} under [known]"
        )
    text.set(actuator, attribute, number(new), why)


def _set_mass(described: Described, text: XmlText, body: int, ratio: float, why: str) -> None:
    """A body's mass with its inertia: of its inertial element, else of its geoms."""
    element = _body(described, text, body)
    inertial = text.children(element, "inertial")
    if inertial:
        for attribute in ("mass", "diaginertia", "fullinertia"):
            _scale(text, inertial[0], attribute, ratio, why)
        return
    masses = described.geom_masses(body)
    for geom, (mass, density) in zip(text.children(element, "geom"), masses, strict=True):
        if "mass" in geom.attributes or "density" in geom.attributes:
            _scale(text, geom, "mass" if "mass" in geom.attributes else "density", ratio, why)
        elif mass is not None:
            text.set(geom, "mass", number(mass * ratio), why)
        else:
            text.set(geom, "density", number(density * ratio), why)


def _scale(text: XmlText, element: Element, attribute: str, ratio: float, why: str) -> None:
    now = text.current(element, attribute)
    if now is not None:
        text.set(element, attribute, " ".join(number(float(x) * ratio) for x in now.split()), why)


def _add_to_joint(field: Field, what: str) -> Callable[[Described, XmlText, float], bool]:
    """An effect that is a value of the joint, or adds to it; none may come out negative."""

    def put(described: Described, text: XmlText, value: float) -> bool:
        old = read_value(described.model, field, 0)
        new = value if field in RUBS else old + value
        if new == old:
            return True
        linear = field in (Field.DAMPING, Field.FRICTIONLOSS, Field.ARMATURE)
        if new < 0.0 and linear:
            return False
        if field in (Field.QUADRATIC_DAMPING, Field.CUBIC_DAMPING) and not described.has_polynomials:
            return False
        _set_of_joint(described, text, field, new, f"{what} = {number(value)}")
        return True

    return put


def _add_spring(described: Described, text: XmlText, value: float) -> bool:
    """F = −k·x beside the file's own spring, which rests at springref: one spring that rests in between."""
    model = described.model
    if value == 0.0:
        return True
    stiffness, rest = read_value(model, Field.STIFFNESS, 0), read_value(model, Field.SPRINGREF, 0)
    if stiffness + value <= 0.0:
        return False
    why = f"spring_force.stiffness = {number(value)}"
    text.set(_joint(described, text), "stiffness", number(stiffness + value), why)
    if rest * stiffness:
        _set_of_joint(described, text, Field.SPRINGREF, rest * stiffness / (stiffness + value), why)
    return True


def _add_delay(described: Described, text: XmlText, value: float) -> bool:
    """A delayed control is read from a buffer of past ones, between two of them along a straight line."""
    if value == 0.0:
        return True
    if described.driven < 0 or not described.has_delays:
        return False
    actuator, delay = _actuator(described, text), described.mechanism.input_delay + value
    why = f"time_delay.delay = {number(value)} s"
    text.set(actuator, "nsample", str(ceil(delay / described.mechanism.timestep * LONGER) + 1), why)
    text.set(actuator, "interp", "linear", why)
    text.set(actuator, "delay", number(delay), why)
    return True


def _add_saturation(described: Described, text: XmlText, value: float) -> bool:
    """The command is cut off at ± 1/s, as by ctrlrange."""
    if value == 0.0:
        return True
    low, high = described.mechanism.held.clip
    limit = 1.0 / value
    if described.driven < 0:
        return False
    actuator, why = _actuator(described, text), f"saturation at {number(limit)}"
    text.set(actuator, "ctrllimited", "true", why)
    text.set(actuator, "ctrlrange", f"{number(max(low, -limit))} {number(min(high, limit))}", why)
    return True


EFFECTS: Mapping[str, Callable[[Described, XmlText, float], bool]] = {
    "viscous_friction.coefficient": _add_to_joint(Field.DAMPING, "viscous friction"),
    "quadratic_viscous_friction.coefficient": _add_to_joint(Field.QUADRATIC_DAMPING, "F = c₂·v·|v|, c₂"),
    "cubic_viscous_friction.coefficient": _add_to_joint(Field.CUBIC_DAMPING, "F = c₃·v³, c₃"),
    "coulomb_friction.level": _add_to_joint(Field.FRICTIONLOSS, "dry friction"),
    "added_inertia.inertia": _add_to_joint(Field.ARMATURE, "more inertia"),
    "spring_force.stiffness": _add_spring,
    "time_delay.delay": _add_delay,
    "saturation.inverse_limit": _add_saturation,
}


def _joint(described: Described, text: XmlText) -> Element:
    joints = text.inside("joint", "worldbody")
    return _one_of(text, joints, described.joint_name, "joint")


def _actuator(described: Described, text: XmlText) -> Element:
    actuators = [e for e in text.inside("", "actuator") if text.elements[e.above[-1]].tag == "actuator"]
    return _one_of(text, actuators, described.actuator_name, "actuator", described.driven)


def _body(described: Described, text: XmlText, body: int) -> Element:
    bodies = text.inside("body", "worldbody")
    return _one_of(text, bodies, described.body_name(body), "body", body - 1)


def _one_of(text: XmlText, candidates: list[Element], name: str | None, what: str, place: int = 0) -> Element:
    """The element of this name, or of this place where it has none."""
    named = [e for e in candidates if name is not None and e.attributes.get("name") == name]
    if len(named) == 1:
        return named[0]
    if name is None and place < len(candidates):
        return candidates[place]
    raise UsageError(
        f"{text.path}: expected the {what} {name or place!r} in this file, found none; where it is included "
        "from another file, give that whole with --into"
    )
