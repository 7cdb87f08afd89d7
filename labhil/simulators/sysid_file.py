"""Recordings for ``mujoco.sysid``: the file that its ``SystemTrajectory.load_from_disk`` reads.

Controls are a column for each of the model's, in MuJoCo's order. Measured signals bear the names of their
sensors, or of their joint with ``_qpos``. The state at the start is the first sample.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labhil.documents import DocumentError, parse_toml
from labhil.errors import UsageError
from labhil.extras import load_optional
from labhil.recording.recording import StreamData
from labhil.rig import RigFile
from labhil.rig_sections import ModelSection, OwnModel
from labhil.signals import FloatArray
from labhil.simulators.mechanism import PURPOSE
from labhil.simulators.mjcf import describe
from labhil.simulators.mjcf_file import Described, load_model, names_of
from labhil.simulators.names import identifier
from labhil.whole import whole

EXTENSION = ".npz"

SENSOR, QPOS, CTRL = 0, 2, 5
"""``mujoco.sysid.SignalType``: a sensor's value, a joint's position, a control."""


@dataclass(frozen=True)
class SysidFile:
    """What was written: ``path``, and ``notes`` on what the recording leaves open."""

    path: Path
    notes: tuple[str, ...]


def write_sysid(data: StreamData, rig: RigFile | None, out: Path, *, start_samples: int = 5) -> SysidFile:
    """Write a stream as a trajectory of ``mujoco.sysid``.

    Args:
        data: The samples.
        rig: A rig file whose ``[model]`` names the MuJoCo file.
        out: The file to write (.npz).
        start_samples: Samples of the position through which a line gives the velocity at the start, where
            none is measured. Five of a rig's usual 100 Hz are short beside its motion and average its noise.

    Returns:
        The file, and what to know of it.

    Raises:
        UsageError: What was expected of the rig file, of the MuJoCo file or of the recording.
        MissingExtraError: The package ``mujoco`` is not installed.
    """
    section = _section(rig)
    assert rig is not None and section.mujoco is not None
    file = rig.path.parent / section.mujoco
    _refuse_arms(file)
    described = describe(file, section.inputs, section.outputs)
    measured = _measured(described, section.outputs)
    (driving,) = described.simulator.inputs
    if described.driven < 0:
        raise UsageError(
            f"{file}: expected an input that an actuator of the file applies, as mujoco.sysid has no others, "
            f"found {driving!r}, which acts on the joint; add <motor joint=…/> to the file, and name it in "
            "inputs"
        )
    kept, t = _kept(data, [driving, *measured])
    control = np.zeros((len(t), int(described.model.nu)))
    control[:, _place_of_control(described)] = _column(data, driving)[kept]
    sensordata = np.column_stack([_column(data, signal)[kept] for signal in measured])
    start, notes = _start(described, measured, sensordata, t, start_samples)
    arrays = {
        "control_times": t,
        "control_data": control,
        "control_signal_mapping": _mapping(_controls(described), CTRL),
        "sensordata_times": t,
        "sensordata_data": sensordata,
        "sensordata_signal_mapping": _as_json(
            {name: (kind, [place]) for place, (name, kind) in enumerate(measured.values())}
        ),
        "initial_state": start,
    }
    with whole(out) as draft, draft.open("wb") as stream:
        np.savez(stream, **arrays)
    if sensordata.shape[1] != described.model.nsensordata or any(
        kind != SENSOR for _, kind in measured.values()
    ):
        notes.append(
            f"the file has {described.model.nsensordata} columns of sensors, the recording {len(measured)} "
            "signals: load it with allow_missing_sensors=True"
        )
    dropped = len(data) - int(np.count_nonzero(kept))
    if dropped:
        notes.append(f"{dropped} samples without a value, or not after the one before, are left out")
    return SysidFile(out, tuple(f"{out}: {note}" for note in notes))


def _section(rig: RigFile | None) -> ModelSection:
    expected = 'expected --rig RIG.toml with [model] mujoco = "FILE.xml", which mujoco.sysid needs'
    if rig is None:
        raise UsageError(f"{expected}, found no --rig")
    try:
        section = OwnModel.model_validate({"model": parse_toml(rig.text)["model"]}).model
    except (DocumentError, KeyError, ValueError):
        section = None
    if section is None or section.mujoco is None:
        raise UsageError(f"{rig.path}: {expected}, found a rig of the kind {rig.kind.name!r}")
    return section


def _refuse_arms(file: Path) -> None:
    joints = names_of(load_model(file)).joints
    if len(joints) != 1:
        raise UsageError(
            f"{file}: expected a file with one joint, found {', '.join(joints) or 'none'}: what drives an "
            "arm's actuators is not in its recording"
        )


def _measured(described: Described, stated: Mapping[str, str] | None) -> dict[str, tuple[str, int]]:
    """What each recorded output is in mujoco.sysid: name and kind."""
    joint = described.joint_name or "joint_0"
    sensors = names_of(described.model).sensors
    given = stated or {name: name for name in sensors if name} or {joint: joint}
    # sensors in the order of the file, which is the one that sensordata has without names
    ordered = sorted(
        given.items(), key=lambda item: sensors.index(item[1]) if item[1] in sensors else len(sensors)
    )
    return {
        identifier(signal): (of, SENSOR) if of in sensors else (f"{of}_qpos", QPOS) for signal, of in ordered
    }


def _column(data: StreamData, signal: str) -> FloatArray:
    if signal not in data.stream.names():
        raise UsageError(
            f"expected the signal {signal!r} in the stream /{data.device}/{data.stream.name}, found "
            f"{', '.join(data.stream.names())}"
        )
    values: FloatArray = np.asarray(data.values[:, data.stream.columns_of(signal)][:, 0], dtype=np.float64)
    return values


def _kept(data: StreamData, signals: Sequence[str]) -> tuple[Any, FloatArray]:
    """Which samples have all values and come after the one before, and their times (s) from the first."""
    whole_rows = np.isfinite(np.column_stack([_column(data, signal) for signal in signals])).all(axis=1)
    t = np.where(whole_rows & np.isfinite(data.t), data.t, -np.inf)
    before = np.concatenate([[-np.inf], np.maximum.accumulate(t)[:-1]])
    kept = t > before
    if np.count_nonzero(kept) < 2:
        raise UsageError(
            f"expected two samples or more of {', '.join(signals)} at increasing times, found "
            f"{np.count_nonzero(kept)}"
        )
    return kept, t[kept] - t[kept][0]


def _place_of_control(described: Described) -> int:
    places = getattr(described.model, "actuator_ctrladr", np.arange(described.model.nu))
    return int(places[described.driven])


def _controls(described: Described) -> list[str]:
    names = names_of(described.model).actuators
    return [f"{name}_ctrl" for name in names]


def _mapping(names: Sequence[str], kind: int) -> Any:
    return _as_json({name: (kind, [place]) for place, name in enumerate(names)})


def _as_json(mapping: Mapping[str, tuple[int, list[int]]]) -> Any:
    return np.asarray(json.dumps({name: [kind, places] for name, (kind, places) in mapping.items()}))


def _start(
    described: Described,
    measured: Mapping[str, tuple[str, int]],
    sensordata: FloatArray,
    t: FloatArray,
    samples: int,
) -> tuple[FloatArray, list[str]]:
    """MuJoCo's whole state at the first sample, and where its numbers come from."""
    mujoco = load_optional("mujoco", PURPOSE)
    model, state = described.model, mujoco.MjData(described.model)
    velocities = int(mujoco.mjtSensor.mjSENS_JOINTVEL)
    sensors = names_of(model).sensors
    positions: list[FloatArray] = []
    rates: list[FloatArray] = []
    for column, (name, kind) in zip(sensordata.T, measured.values(), strict=True):
        is_rate = kind == SENSOR and int(model.sensor_type[sensors.index(name)]) == velocities
        (rates if is_rate else positions).append(column)
    notes = []
    if positions:
        state.qpos[0] = positions[0][0]
    else:
        notes.append("no position is recorded: the state at the start has the file's")
    if rates:
        state.qvel[0] = rates[0][0]
    elif positions:
        count = min(samples, len(t))
        state.qvel[0] = np.polyfit(t[:count], positions[0][:count], 1)[0]
        notes.append(
            f"the velocity at the start, {state.qvel[0]:.4g}, is that of a line through the first {count} "
            "samples"
        )
    kind = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
    whole_state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, state, whole_state, kind)
    return whole_state, notes
