"""Write identified values and effects into a MuJoCo file with one joint; the format has no place for some.

:mod:`labhil.simulators.companion` writes those as Python functions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil, degrees

from labhil.errors import UsageError
from labhil.physics.warming import RATE, WARMS
from labhil.simulators.companion import BRISTLES
from labhil.simulators.dc_motor_file import COSINE, ORDER, SINE, cogging_numbers, read_cogging
from labhil.simulators.mechanism import FRICTION_FIELDS, Field, Value, is_dc_motor, read_value
from labhil.simulators.mjcf_file import MechanismFile
from labhil.simulators.xml_text import Element, XmlText

BRISTLE_LENGTH = f"{BRISTLES}.length"
HOLDING_LEVELS = ("stribeck_friction.level", "static_friction.level")
"""Extra friction at rest: the file's dry friction includes it, and the companion subtracts it in motion."""


@dataclass(frozen=True, slots=True)
class PatchedFile:
    """A file's text with its changes.

    Attributes:
        text: The text.
        remaining: Values of effects for which the format has no attribute.
        substeps: Number by which the time step of the file is divided.
        needs_firm_friction: Whether dry friction has to be firm although the format has no attribute for it.
    """

    text: XmlText
    remaining: Mapping[str, float]
    substeps: int = 1
    needs_firm_friction: bool = False


def format_number(value: float) -> str:
    """Format a number with six digits."""
    return f"{value:.6g}"


def patch_mjcf(file: MechanismFile, text: XmlText, values: Mapping[str, float]) -> PatchedFile:
    """Write values into the text of an MJCF file.

    Args:
        file: The file as it was read.
        text: Its text.
        values: Values of its own parameters and of effects, by name ("coulomb_friction.level").

    Returns:
        The text with its changes, and the remaining values.

    Raises:
        UsageError: An element is not in the file itself (it includes another file).
    """
    if text.elements[0].tag != "mujoco":
        raise UsageError(
            f"{text.path}: expected an MJCF file (<mujoco>) or URDF (<robot>), found <{text.elements[0].tag}>"
        )
    in_file = {value.name: value for value in file.mechanism.values}
    remaining = merge_holding_friction(file, values)
    for name, value in in_file.items():
        if name in remaining:
            _set_file_value(file, text, value, remaining.pop(name))
    for name, write in EFFECTS.items():
        if name in remaining and write(file, text, remaining[name]):
            del remaining[name]
    _write_cogging(file, text, remaining)
    return PatchedFile(text, drop_inactive(remaining))


def _write_cogging(file: MechanismFile, text: XmlText, remaining: dict[str, float]) -> None:
    """Write the effect cogging_torque into a ``dcmotor``, and take its values from the remaining ones.

    Cogging of the file without a value becomes 0.
    """
    before = read_cogging(file.model, file.actuator)
    if not is_dc_motor(file.model, file.actuator) or (ORDER not in remaining and not before):
        return
    values = {name: remaining.pop(name, 0.0) for name in (SINE, COSINE, ORDER)}
    if not values[ORDER]:
        values[ORDER] = before[ORDER]
    numbers = " ".join(format_number(x) for x in cogging_numbers(values, file.gear[0]))
    reason = f"cogging_torque.order = {format_number(values[ORDER])} rad/rad: amplitude, poles, phase"
    text.set(_actuator_element(file, text), "cogging", numbers, reason)


def merge_holding_friction(file: MechanismFile, values: Mapping[str, float]) -> dict[str, float]:
    """Add extra static friction to the dry friction; friction of the file without a value becomes 0."""
    own_friction = {
        name: 0.0 for field, name in FRICTION_FIELDS.items() if read_value(file.model, field, 0) != 0.0
    }
    return with_shared_values(own_friction | dict(values))


def with_shared_values(values: Mapping[str, float]) -> dict[str, float]:
    """State friction of which a file holds one part and its companion another: at rest, and with warmth.

    Dry friction on bristles is the companion's alone.
    """
    bristles = values.get(BRISTLE_LENGTH, 0.0) > 0.0
    return _with_warming(_with_bristles(values) if bristles else _with_holding_friction(values))


def _with_bristles(values: Mapping[str, float]) -> dict[str, float]:
    """Hand the dry friction of creeping motion to the bristles, which do not hold: there is no static one."""
    dry = FRICTION_FIELDS[Field.FRICTIONLOSS]
    level = values.get(dry, 0.0) + values.get("stribeck_friction.level", 0.0)
    moving = {name: value for name, value in values.items() if name != "static_friction.level"}
    return {**moving, dry: 0.0, f"{BRISTLES}.level": level}


def _with_holding_friction(values: Mapping[str, float]) -> dict[str, float]:
    """Add extra friction at rest to the dry friction; a companion subtracts it in motion."""
    holding, dry = sum(values.get(name, 0.0) for name in HOLDING_LEVELS), FRICTION_FIELDS[Field.FRICTIONLOSS]
    return {**values, dry: values.get(dry, 0.0) + holding} if holding else dict(values)


def _with_warming(values: Mapping[str, float]) -> dict[str, float]:
    """State the friction that falls with warmth beside the rate at which it does, as a companion needs it."""
    drag = values.get("viscous_friction.coefficient", 0.0)
    return {**values, f"{WARMS}.coefficient": drag} if values.get(RATE) else dict(values)


def drop_inactive(values: Mapping[str, float]) -> dict[str, float]:
    """Drop values of effects whose strength is 0."""
    return {name: value for name, value in values.items() if value and _has_effect(name, values)}


def _has_effect(name: str, values: Mapping[str, float]) -> bool:
    """Whether the effect of a value has a strength that is not 0."""
    term = name.partition(".")[0]
    strengths = {
        "stribeck_friction": ("stribeck_friction.level",),
        "cogging_torque": ("cogging_torque.sine", "cogging_torque.cosine"),
    }
    return any(values.get(level) for level in strengths.get(term, (name,)))


def stiffen_friction(file: MechanismFile, text: XmlText, substeps: int = 1) -> None:
    """Make MuJoCo's dry friction as firm as its time step, divided by ``substeps``, allows."""
    stiffen_element(text, _joint_element(file, text), file.mechanism.timestep / substeps)


def stiffen_element(text: XmlText, joint: Element, step: float) -> None:
    """Make the dry friction of a joint's element as firm as a time step (s) allows."""
    reason = "dry friction as firm as the time step allows"
    text.set(joint, "solreffriction", f"{format_number(2.0 * step)} 1", reason)
    text.set(joint, "solimpfriction", "0.99 0.999 0.001", reason)


def shorten_step(file: MechanismFile, text: XmlText, substeps: int) -> None:
    """Divide MuJoCo's time step by ``substeps``."""
    step = file.mechanism.timestep / substeps
    reason = "the error of a step was larger than the remaining error"
    options = [e for e in text.elements if e.tag == "option" and len(e.ancestors) == 1]
    if options:
        text.set(options[-1], "timestep", format_number(step), reason)
    else:
        text.add(text.elements[0], f'<option timestep="{format_number(step)}"/>', reason)
    for actuator in text.inside("", "actuator"):
        count = text.current(actuator, "nsample")
        if count is not None:
            text.set(actuator, "nsample", str(int(count) * substeps), reason)


def _set_file_value(file: MechanismFile, text: XmlText, value: Value, new: float) -> None:
    """Change a value that the file has already."""
    old = read_value(file.model, value.field, value.index)
    if abs(new - old) <= 1e-9 * abs(old):
        return
    reason = f"{value.name}: {format_number(old)} → {format_number(new)} {value.unit}"
    match value.field:
        case Field.MASS:
            _set_mass(file, text, value.index, new / old, reason)
        case Field.GEAR:
            set_part(text, _actuator_element(file, text), "gear", 0, new, file.gear, reason)
        case Field.MOTORCONST | Field.RESISTANCE:
            text.set(_actuator_element(file, text), value.field.value, format_number(new), reason)
        case Field.KP | Field.KV:
            _set_gain(text, _actuator_element(file, text), value.field.value, new, reason)
        case _:
            _set_joint_value(file, text, value.field, new, reason)


def _set_joint_value(file: MechanismFile, text: XmlText, field: Field, new: float, reason: str) -> None:
    joint, model = _joint_element(file, text), file.model
    if field is Field.SPRINGREF:
        angle = file.in_degrees(text)
        text.set(joint, "springref", format_number(degrees(new) if angle else new), reason)
        return
    poly = {
        Field.DAMPING: ("damping", 0),
        Field.QUADRATIC_DAMPING: ("damping", 1),
        Field.CUBIC_DAMPING: ("damping", 2),
    }
    if field not in poly:
        text.set(joint, field.value, format_number(new), reason)
        return
    attribute, position = poly[field]
    current = text.current(joint, attribute)
    parts_of_file = (
        [read_value(model, f, 0) for f in poly] if current is None else [float(x) for x in current.split()]
    )
    set_part(text, joint, attribute, position, new, parts_of_file, reason)


def set_part(
    text: XmlText, element: Element, attribute: str, index: int, new: float, default: list[float], reason: str
) -> None:
    """Set one of several numbers of an attribute.

    Args:
        text: The text.
        element: The element.
        attribute: Name of the attribute.
        index: Which of its numbers.
        new: The new number.
        default: The numbers where the file does not have the attribute; zeros at its end are dropped.
        reason: Reason of the change.
    """
    current = text.current(element, attribute)
    parts = [format_number(x) for x in default] if current is None else current.split()
    parts += ["0"] * (index + 1 - len(parts))
    parts[index] = format_number(new)
    if current is None:
        while len(parts) > 1 and float(parts[-1]) == 0.0:
            parts.pop()
    text.set(element, attribute, " ".join(parts), reason)


def _set_gain(text: XmlText, actuator: Element, attribute: str, new: float, reason: str) -> None:
    if actuator.tag not in ("position", "velocity", "intvelocity"):
        raise UsageError(
            f"{text.path}: {actuator.label()}: expected position or velocity, whose {attribute} can be "
            f"changed, found {actuator.tag}; state {attribute} under [known]"
        )
    text.set(actuator, attribute, format_number(new), reason)


def _set_mass(file: MechanismFile, text: XmlText, body: int, ratio: float, reason: str) -> None:
    """Scale mass and inertia of a body: of its inertial element, else of its geoms."""
    element = _body_element(file, text, body)
    inertial = text.children(element, "inertial")
    if inertial:
        for attribute in ("mass", "diaginertia", "fullinertia"):
            _scale(text, inertial[0], attribute, ratio, reason)
        return
    masses = file.geom_masses(body)
    for geom, (mass, density) in zip(text.children(element, "geom"), masses, strict=True):
        if "mass" in geom.attributes or "density" in geom.attributes:
            _scale(text, geom, "mass" if "mass" in geom.attributes else "density", ratio, reason)
        elif mass is not None:
            text.set(geom, "mass", format_number(mass * ratio), reason)
        else:
            text.set(geom, "density", format_number(density * ratio), reason)


def _scale(text: XmlText, element: Element, attribute: str, ratio: float, reason: str) -> None:
    current = text.current(element, attribute)
    if current is not None:
        text.set(
            element, attribute, " ".join(format_number(float(x) * ratio) for x in current.split()), reason
        )


def _add_to_joint(field: Field, label: str) -> Callable[[MechanismFile, XmlText, float], bool]:
    """Make the writer of an effect that is a value of the joint, or adds to one; none may become negative."""

    def write(file: MechanismFile, text: XmlText, value: float) -> bool:
        old = read_value(file.model, field, 0)
        new = value if field in FRICTION_FIELDS else old + value
        if new == old:
            return True
        linear = field in (Field.DAMPING, Field.FRICTIONLOSS, Field.ARMATURE)
        if new < 0.0 and linear:
            return False
        if field in (Field.QUADRATIC_DAMPING, Field.CUBIC_DAMPING) and not file.has_polynomials:
            return False
        _set_joint_value(file, text, field, new, f"{label} = {format_number(value)}")
        return True

    return write


def _add_spring(file: MechanismFile, text: XmlText, value: float) -> bool:
    """Merge F = −k·x with the file's own spring about springref: one spring with a reference in between."""
    model = file.model
    if value == 0.0:
        return True
    stiffness, rest = read_value(model, Field.STIFFNESS, 0), read_value(model, Field.SPRINGREF, 0)
    if stiffness + value <= 0.0:
        return False
    reason = f"spring_force.stiffness = {format_number(value)}"
    text.set(_joint_element(file, text), "stiffness", format_number(stiffness + value), reason)
    if rest * stiffness:
        _set_joint_value(file, text, Field.SPRINGREF, rest * stiffness / (stiffness + value), reason)
    return True


def _add_delay(file: MechanismFile, text: XmlText, value: float) -> bool:
    """Delay the control: MuJoCo interpolates linearly in a buffer of past ones."""
    if value == 0.0:
        return True
    if file.actuator < 0 or not file.has_delays:
        return False
    actuator, delay = _actuator_element(file, text), file.mechanism.input_delay + value
    reason = f"time_delay.delay = {format_number(value)} s"
    text.set(actuator, "nsample", str(ceil(delay / file.mechanism.timestep * (1.0 + 1e-9)) + 1), reason)
    text.set(actuator, "interp", "linear", reason)
    text.set(actuator, "delay", format_number(delay), reason)
    return True


def _add_saturation(file: MechanismFile, text: XmlText, value: float) -> bool:
    """Limit the command to ± 1/s by ctrlrange."""
    if value == 0.0:
        return True
    low, high = file.mechanism.non_smooth.clip
    limit = 1.0 / value
    if file.actuator < 0:
        return False
    actuator, reason = _actuator_element(file, text), f"saturation at {format_number(limit)}"
    text.set(actuator, "ctrllimited", "true", reason)
    text.set(
        actuator, "ctrlrange", f"{format_number(max(low, -limit))} {format_number(min(high, limit))}", reason
    )
    return True


EFFECTS: Mapping[str, Callable[[MechanismFile, XmlText, float], bool]] = {
    "viscous_friction.coefficient": _add_to_joint(Field.DAMPING, "viscous friction"),
    "quadratic_viscous_friction.coefficient": _add_to_joint(Field.QUADRATIC_DAMPING, "F = c₂·v·|v|, c₂"),
    "cubic_viscous_friction.coefficient": _add_to_joint(Field.CUBIC_DAMPING, "F = c₃·v³, c₃"),
    "coulomb_friction.level": _add_to_joint(Field.FRICTIONLOSS, "dry friction"),
    "added_inertia.inertia": _add_to_joint(Field.ARMATURE, "more inertia"),
    "spring_force.stiffness": _add_spring,
    "time_delay.delay": _add_delay,
    "saturation.inverse_limit": _add_saturation,
}


def _joint_element(file: MechanismFile, text: XmlText) -> Element:
    joints = text.inside("joint", "worldbody")
    return _find_element(text, joints, file.joint_name, "joint")


def _actuator_element(file: MechanismFile, text: XmlText) -> Element:
    actuators = [e for e in text.inside("", "actuator") if text.elements[e.ancestors[-1]].tag == "actuator"]
    return _find_element(text, actuators, file.actuator_name, "actuator", file.actuator)


def _body_element(file: MechanismFile, text: XmlText, body: int) -> Element:
    bodies = text.inside("body", "worldbody")
    return _find_element(text, bodies, file.body_name(body), "body", body - 1)


def _find_element(
    text: XmlText, candidates: list[Element], name: str | None, kind: str, index: int = 0
) -> Element:
    """Find the element of this name, or with this index where it has no name."""
    matches = [e for e in candidates if name is not None and e.attributes.get("name") == name]
    if len(matches) == 1:
        return matches[0]
    if name is None and index < len(candidates):
        return candidates[index]
    raise UsageError(
        f"{text.path}: expected the {kind} {name or index!r} in this file, found none; where it is included "
        "from another file, give that whole with --into"
    )
