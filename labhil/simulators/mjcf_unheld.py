"""What a MuJoCo file has that one compiled joint cannot hold: refused, or stated in a note.

A table of the joint's acceleration holds what is smooth in position, velocity and input. What holds the
joint, what remembers, and what drives it without an end is refused before anything is fitted. What matters
only in places is named, for the reader to judge.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from labhil.errors import UsageError
from labhil.extras import load_optional
from labhil.simulators.mechanism import PURPOSE, RUBS, Field, read_value
from labhil.simulators.mjcf_file import Names

PLACES = 181
"""Places along the way at which contacts are looked for."""

NEGATIVE = {**dict.fromkeys(RUBS, "pushes the joint on"), Field.ARMATURE: "takes inertia away"}
"""Values that no mechanism has below 0, and what they would do."""


def refuse_unheld(model: Any, file: Path) -> None:
    """UsageError for what cannot be one smooth acceleration, with what it is and what to do."""
    for present, what in _unheld(model):
        if present:
            raise UsageError(f"{file}: {what}")
    for field, does in NEGATIVE.items():
        value = read_value(model, field, 0)
        if value < 0.0:
            raise UsageError(
                f"{file}: joint {field.value.replace('_', ' ')}: expected 0 or more, found {value:g}, which "
                f"{does}; give a joint that moves by itself a force as input, or an effect (`labhil terms`)"
            )


def _unheld(model: Any) -> Iterator[tuple[bool, str]]:
    """Whether a file has each thing that is refused, and the message for it."""
    active = int(np.sum(model.eq_active0)) if model.neq else 0
    yield (
        bool(active),
        f"expected no equality constraint, found {active} that hold the only joint; take them out, or give "
        'them active="false"',
    )
    rubbing = [k for k in range(model.ntendon) if model.tendon_frictionloss[k] or model.tendon_limited[k]]
    yield (
        bool(rubbing),
        f"expected tendons without dry friction and limits, found {len(rubbing)} with; give the joint "
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
    """By how much the file's sensors of the outputs are late, s; UsageError where they differ."""
    delays = {float(_of_sensor(model, "sensor_delay", k)) for k in sensors}
    if len(delays) > 1:
        stated = ", ".join(f"{delay:g} s" for delay in sorted(delays))
        raise UsageError(
            f"{file}: expected the sensors of all outputs to be late by the same, found {stated}; measure "
            "one of them, or shift the other's recording: [channels] NAME = { shift = … }"
        )
    return delays.pop() if delays else 0.0


def notes_on(model: Any, names: Names, driven: int, sensors: Iterable[int]) -> tuple[str, ...]:
    """What of the file is not part of what is fitted, in sentences."""
    notes = [_on_sensor(model, k, names.sensors[k]) for k in sensors]
    notes += [
        f"actuator {name} is not the recorded input: it is held at 0."
        for k, name in enumerate(names.actuators)
        if k != driven
    ]
    notes.append(_on_contacts(model))
    return tuple(note for note in notes if note)


def _on_sensor(model: Any, sensor: int, name: str) -> str:
    limits = []
    every, cut = _of_sensor(model, "sensor_interval", sensor), float(model.sensor_cutoff[sensor])
    if np.ndim(every):
        every = every[0]
    if float(every) > 0.0:
        limits.append(f"it is read every {float(every):g} s")
    if cut > 0.0:
        limits.append(f"it reads no more than ±{cut:g}")
    return f"sensor {name}: {' and '.join(limits)} in the file; what is fitted reads it as it is." * bool(
        limits
    )


def _of_sensor(model: Any, what: str, sensor: int) -> Any:
    """A value of a sensor; 0 where this MuJoCo has no such thing."""
    values = getattr(model, what, None)
    return 0.0 if values is None else values[sensor]


def _on_contacts(model: Any) -> str:
    """Which bodies touch somewhere along the joint's way."""
    mujoco = load_optional("mujoco", PURPOSE)
    off = int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    if model.opt.disableflags & off:
        return ""
    data, touching, pairs = mujoco.MjData(model), [], set[str]()
    for place in _way(model):
        data.qpos[0] = place
        mujoco.mj_fwdPosition(model, data)
        deep = [c for c in data.contact[: data.ncon] if c.dist < 0.0]
        touching += [place] * bool(deep)
        pairs |= {" and ".join(sorted(_geom(model, int(k)) for k in c.geom)) for c in deep}
    if not touching:
        return ""
    return (
        f"{', '.join(sorted(pairs))} touch between {min(touching):.4g} and {max(touching):.4g} "
        f"{_length(model)} of the joint: what is fitted knows no contacts. Leave that part of the way out of "
        "the recording, or give the joint a range."
    )


def _way(model: Any) -> list[float]:
    if model.jnt_limited[0]:
        low, high = model.jnt_range[0].tolist()
    else:
        half = np.pi if _length(model) == "rad" else float(model.stat.extent)
        low, high = float(model.qpos0[0]) - half, float(model.qpos0[0]) + half
    return [float(x) for x in np.linspace(low, high, PLACES)]


def _length(model: Any) -> str:
    hinge = int(load_optional("mujoco", PURPOSE).mjtJoint.mjJNT_HINGE)
    return "rad" if int(model.jnt_type[0]) == hinge else "m"


def _geom(model: Any, geom: int) -> str:
    mujoco = load_optional("mujoco", PURPOSE)
    return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or f"geom_{geom}"
