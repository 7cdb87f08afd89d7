"""Refuse or note the parts of a MuJoCo file that a table of one joint's acceleration cannot represent.

The table is smooth in position, velocity and input. Constraints, states beside those of the joint and
negative friction are refused before anything is fitted. Contacts in a part of the range, and limits of
sensors, are stated in notes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from labhil.errors import UsageError
from labhil.extras import load_optional
from labhil.simulators.mechanism import FRICTION_FIELDS, PURPOSE, Field, read_value
from labhil.simulators.mjcf_file import Names

NEGATIVE = {**dict.fromkeys(FRICTION_FIELDS, "pushes the joint on"), Field.ARMATURE: "takes inertia away"}
"""Quantities that no mechanism has below 0, and the consequence."""


def refuse_unsupported(model: Any, file: Path) -> None:
    """Raise UsageError for what a smooth acceleration cannot represent, with a remedy."""
    for applies, message in _unsupported(model):
        if applies:
            raise UsageError(f"{file}: {message}")
    for field, consequence in NEGATIVE.items():
        value = read_value(model, field, 0)
        if value < 0.0:
            raise UsageError(
                f"{file}: joint {field.value.replace('_', ' ')}: expected 0 or more, found {value:g}, which "
                f"{consequence}; give a joint that moves by itself a force as input, or an effect "
                "(`labhil terms`)"
            )


def _unsupported(model: Any) -> Iterator[tuple[bool, str]]:
    """Yield each refused feature: whether the file has it, and the message."""
    active = int(np.sum(model.eq_active0)) if model.neq else 0
    yield (
        bool(active),
        f"expected no equality constraint, found {active} that hold the only joint; take them out, or give "
        'them active="false"',
    )
    rough_tendons = [
        k for k in range(model.ntendon) if model.tendon_frictionloss[k] or model.tendon_limited[k]
    ]
    yield (
        bool(rough_tendons),
        f"expected tendons without dry friction and limits, found {len(rough_tendons)} with; give the joint "
        "frictionloss and range instead",
    )
    yield (
        bool(getattr(model, "nplastic", 0)),
        "expected springs that are elastic, found one that yields, which remembers its past",
    )
    yield (
        bool(model.npluginstate),
        "expected no plug-in with a state of its own, found one; the joint's motion would depend on more "
        "than its position and velocity",
    )


def sensor_delay(model: Any, file: Path, sensors: Iterable[int]) -> float:
    """Return the delay of the file's sensors of the outputs, s; UsageError where they differ."""
    delays = {float(_sensor_value(model, "sensor_delay", k)) for k in sensors}
    if len(delays) > 1:
        stated = ", ".join(f"{delay:g} s" for delay in sorted(delays))
        raise UsageError(
            f"{file}: expected the sensors of all outputs to be late by the same, found {stated}; measure "
            "one of them, or shift the other's recording: [channels] NAME = { shift = … }"
        )
    return delays.pop() if delays else 0.0


def notes_on(model: Any, names: Names, actuator_index: int, sensors: Iterable[int]) -> tuple[str, ...]:
    """State in sentences what of the file is not part of the fitted model.

    Args:
        model: MuJoCo's model.
        names: Its names.
        actuator_index: Number of the driven actuator.
        sensors: Numbers of the sensors of the outputs.

    Returns:
        The notes.
    """
    notes = [_sensor_note(model, k, names.sensors[k]) for k in sensors]
    notes += [
        f"actuator {name} is not the recorded input: it is held at 0."
        for k, name in enumerate(names.actuators)
        if k != actuator_index
    ]
    notes.append(_contact_note(model))
    return tuple(note for note in notes if note)


def _sensor_note(model: Any, sensor: int, name: str) -> str:
    limits = []
    interval, cutoff = _sensor_value(model, "sensor_interval", sensor), float(model.sensor_cutoff[sensor])
    if np.ndim(interval):
        interval = interval[0]
    if float(interval) > 0.0:
        limits.append(f"it is read every {float(interval):g} s")
    if cutoff > 0.0:
        limits.append(f"it reads no more than ±{cutoff:g}")
    return f"sensor {name}: {' and '.join(limits)} in the file; the fitted model ignores that." * bool(limits)


def _sensor_value(model: Any, array: str, sensor: int) -> Any:
    """Read a value of a sensor; 0 where this version of MuJoCo does not have it."""
    values = getattr(model, array, None)
    return 0.0 if values is None else values[sensor]


def _contact_note(model: Any) -> str:
    """State which bodies touch somewhere in the range of the joint."""
    mujoco = load_optional("mujoco", PURPOSE)
    off = int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    if model.opt.disableflags & off:
        return ""
    data, touching, pairs = mujoco.MjData(model), [], set[str]()
    for position in _scan_positions(model):
        data.qpos[0] = position
        mujoco.mj_fwdPosition(model, data)
        penetrating = [c for c in data.contact[: data.ncon] if c.dist < 0.0]
        touching += [position] * bool(penetrating)
        pairs |= {" and ".join(sorted(_geom_name(model, int(k)) for k in c.geom)) for c in penetrating}
    if not touching:
        return ""
    return (
        f"{', '.join(sorted(pairs))} touch between {min(touching):.4g} and {max(touching):.4g} "
        f"{_length_unit(model)} of the joint: the fitted model has no contacts. Leave that range out of "
        "the recording, or give the joint a range."
    )


def _scan_positions(model: Any, *, count: int = 181) -> list[float]:
    if model.jnt_limited[0]:
        low, high = model.jnt_range[0].tolist()
    else:
        half = np.pi if _length_unit(model) == "rad" else float(model.stat.extent)
        low, high = float(model.qpos0[0]) - half, float(model.qpos0[0]) + half
    return [float(x) for x in np.linspace(low, high, count)]


def _length_unit(model: Any) -> str:
    hinge = int(load_optional("mujoco", PURPOSE).mjtJoint.mjJNT_HINGE)
    return "rad" if int(model.jnt_type[0]) == hinge else "m"


def _geom_name(model: Any, geom: int) -> str:
    mujoco = load_optional("mujoco", PURPOSE)
    return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or f"geom_{geom}"
