"""Export of recordings for ``mujoco.sysid``, in the format of ``SystemTrajectory.load_from_disk``.

All controls of the model are columns, in MuJoCo's order. Measured signals have the names of their sensors, or
of their joint with ``_qpos``. The initial state is that of the first sample.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labhil.atomic_file import atomic_file
from labhil.documents import DocumentError, parse_toml
from labhil.errors import UsageError
from labhil.extras import load_optional
from labhil.recording.recording import StreamData
from labhil.rig import RigFile
from labhil.rig_sections import ModelSection, OwnModel
from labhil.signals import FloatArray
from labhil.simulators.mechanism import PURPOSE
from labhil.simulators.mjcf import read_mechanism
from labhil.simulators.mjcf_file import MechanismFile, load_model, names_of
from labhil.simulators.names import identifier

EXTENSION = ".npz"

SENSOR, QPOS, CTRL = 0, 2, 5
"""Values of ``mujoco.sysid.SignalType``: sensor, joint position, control."""


@dataclass(frozen=True)
class SysidFile:
    """A written file.

    Attributes:
        path: the file.
        notes: lines about the initial state, missing sensors and dropped samples.
    """

    path: Path
    notes: tuple[str, ...]


def write_sysid(data: StreamData, rig: RigFile | None, out: Path, *, start_samples: int = 5) -> SysidFile:
    """Write a stream as a trajectory of ``mujoco.sysid``.

    Args:
        data: the samples.
        rig: rig file whose ``[model]`` names the MuJoCo file.
        out: the file to write (.npz).
        start_samples: number of position samples of the line whose slope is the initial velocity, if no
            velocity is measured. Five samples at the usual 100 Hz are short compared to the motion of a rig,
            and average its noise.

    Returns:
        The file, with notes.

    Raises:
        UsageError: The rig file names no MuJoCo file, this has several joints or no actuator, or the
            recording has not its signals.
        MissingExtraError: The package ``mujoco`` is not installed.
    """
    section = _section(rig)
    assert rig is not None and section.mujoco is not None
    file = rig.path.parent / section.mujoco
    _refuse_arms(file)
    mechanism = read_mechanism(file, section.inputs, section.outputs)
    measured = _measured(mechanism, section.outputs)
    (driving,) = mechanism.simulator.inputs
    if mechanism.actuator < 0:
        raise UsageError(
            f"{file}: expected an input that an actuator of the file applies, as mujoco.sysid has no others, "
            f"found {driving!r}, which acts on the joint; add <motor joint=…/> to the file, and name it in "
            "inputs"
        )
    kept, t = _kept(data, [driving, *measured])
    control = np.zeros((len(t), int(mechanism.model.nu)))
    control[:, _place_of_control(mechanism)] = _column(data, driving)[kept]
    sensordata = np.column_stack([_column(data, signal)[kept] for signal in measured])
    start, notes = _start(mechanism, measured, sensordata, t, start_samples)
    arrays = {
        "control_times": t,
        "control_data": control,
        "control_signal_mapping": _mapping(_controls(mechanism), CTRL),
        "sensordata_times": t,
        "sensordata_data": sensordata,
        "sensordata_signal_mapping": _as_json(
            {name: (kind, [place]) for place, (name, kind) in enumerate(measured.values())}
        ),
        "initial_state": start,
    }
    with atomic_file(out) as draft, draft.open("wb") as stream:
        np.savez(stream, **arrays)
    if sensordata.shape[1] != mechanism.model.nsensordata or any(
        kind != SENSOR for _, kind in measured.values()
    ):
        notes.append(
            f"the file has {mechanism.model.nsensordata} columns of sensors, the recording {len(measured)} "
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


def _measured(mechanism: MechanismFile, stated: Mapping[str, str] | None) -> dict[str, tuple[str, int]]:
    """Name and kind in mujoco.sysid of each recorded output."""
    joint = mechanism.joint_name or "joint_0"
    sensors = names_of(mechanism.model).sensors
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
    """Samples with all values at increasing times, as a mask, and their times (s) from the first."""
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


def _place_of_control(mechanism: MechanismFile) -> int:
    addresses = getattr(mechanism.model, "actuator_ctrladr", np.arange(mechanism.model.nu))
    return int(addresses[mechanism.actuator])


def _controls(mechanism: MechanismFile) -> list[str]:
    names = names_of(mechanism.model).actuators
    return [f"{name}_ctrl" for name in names]


def _mapping(names: Sequence[str], kind: int) -> Any:
    return _as_json({name: (kind, [place]) for place, name in enumerate(names)})


def _as_json(mapping: Mapping[str, tuple[int, list[int]]]) -> Any:
    return np.asarray(json.dumps({name: [kind, places] for name, (kind, places) in mapping.items()}))


def _start(
    mechanism: MechanismFile,
    measured: Mapping[str, tuple[str, int]],
    sensordata: FloatArray,
    t: FloatArray,
    samples: int,
) -> tuple[FloatArray, list[str]]:
    """MuJoCo's full state at the first sample, and notes about values that are not measured."""
    mujoco = load_optional("mujoco", PURPOSE)
    model, state = mechanism.model, mujoco.MjData(mechanism.model)
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
