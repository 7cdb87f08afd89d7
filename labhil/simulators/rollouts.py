"""Let MuJoCo step the windows of a recording, each from a given state."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from labhil.errors import UsageError
from labhil.extras import load_optional
from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.stepped import JointForce, Nodes


class Actuation(NamedTuple):
    """Where a mechanism takes its input.

    Attributes:
        actuator: Number of the actuator; −1 where the input is a force at the joint.
        control: Number of its control.
    """

    actuator: int
    control: int


def roll_out(
    model: Any,
    actuation: Actuation,
    record: Record,
    nodes: Nodes,
    windows: Windows,
    states: FloatArray,
    joint_force: JointForce | None = None,
    *,
    threads: int = 2,
    max_steps: int = 10_000_000,
) -> FloatArray:
    """Step a model with one degree of freedom through all windows at once.

    MuJoCo steps evenly at its own time step. In each step the input is its mean over the step; samples
    between two steps are on the cubic through both.

    Args:
        model: A ``mujoco.MjModel``.
        driven: Where the input goes.
        record: The recording.
        nodes: Times and values of the input.
        windows: w windows of the recording, N samples in total.
        states: Position and velocity at the start of each window, (w, 2).
        joint_force: An additional force; with it the windows are stepped one by one.
        threads: Threads that step windows.
        max_steps: Most steps of all windows together; 10 million take 400 MB.

    Returns:
        Position and velocity, (N, 2).

    Raises:
        UsageError: The time step of the file makes too many steps.
    """
    mujoco, rollout = load_optional("mujoco", "an MJCF file"), load_optional("mujoco.rollout", "an MJCF file")
    step, starts = float(model.opt.timestep), record.t[windows.first]
    steps = int(min(np.ceil(np.max(record.t[windows.last - 1] - starts) / step), max_steps)) + 1
    if steps * len(starts) > max_steps:
        raise UsageError(
            f"expected a MuJoCo file whose time step makes at most {max_steps} steps of a recording, found "
            f'timestep="{step:g}"'
        )
    edges = starts[:, None] + step * np.arange(steps + 1)
    control = interval_means(nodes, edges)[:, :, None]
    if joint_force is not None:
        motion = _step_with_force(model, actuation, nodes, starts, states, control[:, :, 0], joint_force)
        return _at_samples(record, windows, starts, motion, step)
    if actuation.actuator >= 0 and model.nu > 1:
        control = control * np.eye(model.nu)[actuation.control]
    flags = mujoco.mjtState
    data = [mujoco.MjData(model) for _ in range(threads)]
    initial = np.array(
        [_full_state(model, data[0], actuation, nodes, t, s) for t, s in zip(starts, states, strict=True)]
    )
    spec = flags.mjSTATE_CTRL if actuation.actuator >= 0 else flags.mjSTATE_QFRC_APPLIED
    full_states, _ = rollout.rollout(model, data, initial, control, control_spec=int(spec), nstep=steps)
    # of a full state the time is first, then position and velocity of the only degree of freedom
    motion = np.concatenate([initial[:, None, 1:3], full_states[:, :, 1:3]], axis=1)
    return _at_samples(record, windows, starts, motion, step)


def _at_samples(
    record: Record, windows: Windows, starts: FloatArray, motion: FloatArray, step: float
) -> FloatArray:
    return np.concatenate(
        [
            _interpolate(record.t[first:last] - t, motion[w], step)
            for w, (first, last, t) in enumerate(zip(windows.first, windows.last, starts, strict=True))
        ]
    )


def _step_with_force(
    model: Any,
    actuation: Actuation,
    nodes: Nodes,
    starts: FloatArray,
    states: FloatArray,
    control: FloatArray,
    joint_force: JointForce,
) -> FloatArray:
    """Step the windows one by one with a force that is evaluated in every step, (w, steps + 1, 2)."""
    mujoco = load_optional("mujoco", "an MJCF file")
    data = mujoco.MjData(model)
    out = np.empty((len(starts), control.shape[1] + 1, 2))
    spec = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
    for w, start in enumerate(starts):
        mujoco.mj_setState(model, data, _full_state(model, data, actuation, nodes, start, states[w]), spec)
        out[w, 0] = states[w]
        for k, u in enumerate(control[w].tolist()):
            t = float(start) + k * float(model.opt.timestep)
            direct = 0.0 if actuation.actuator >= 0 else u
            if actuation.actuator >= 0:
                data.ctrl[actuation.control] = u
            drive = u if actuation.actuator < 0 else float(data.qfrc_actuator[0])
            data.qfrc_applied[0] = direct + joint_force(t, float(data.qpos[0]), float(data.qvel[0]), drive)
            mujoco.mj_step(model, data)
            out[w, k + 1] = data.qpos[0], data.qvel[0]
    return out


def interval_means(nodes: Nodes, edges: FloatArray) -> FloatArray:
    """Average an input over the intervals (…, n) between edges (…, n + 1); it is constant beyond its ends."""
    t, u = nodes
    first, last = float(np.min(edges)) - 1.0, float(np.max(edges)) + 1.0
    t = np.concatenate([[min(first, t[0])], t, [max(last, t[-1])]])
    u = np.concatenate([u[:1], u, u[-1:]])
    area = np.concatenate([[0.0], np.cumsum(0.5 * (u[1:] + u[:-1]) * np.diff(t))])
    k = np.clip(np.searchsorted(t, edges, side="right") - 1, 0, len(t) - 2)
    width = np.maximum(t[k + 1] - t[k], 1e-300)
    past = edges - t[k]
    integral = area[k] + past * (u[k] + 0.5 * (u[k + 1] - u[k]) * past / width)
    return np.asarray(np.diff(integral, axis=-1) / np.diff(edges, axis=-1))


def _full_state(
    model: Any, data: Any, actuation: Actuation, nodes: Nodes, start: float, state: FloatArray
) -> FloatArray:
    """MuJoCo's full state at the start of a window, with the history of a delayed input."""
    mujoco = load_optional("mujoco", "an MJCF file")
    mujoco.mj_resetData(model, data)
    data.time, data.qpos[0], data.qvel[0] = start, *state
    if actuation.actuator >= 0 and hasattr(model, "nhistory"):
        count = int(model.actuator_history[actuation.actuator][0])
        if count:
            edges = start + model.opt.timestep * np.arange(-count, 1)
            past = np.ascontiguousarray(interval_means(nodes, edges)[:, None])
            mujoco.mj_initCtrlHistory(model, data, actuation.actuator, edges[:-1].copy(), past)
    spec = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
    full_state = np.empty(mujoco.mj_stateSize(model, spec))
    mujoco.mj_getState(model, data, full_state, spec)
    return full_state


def _interpolate(t: FloatArray, motion: FloatArray, step: float) -> FloatArray:
    """Interpolate position and velocity at times since the start by cubics between even steps, (n, 2)."""
    k = np.minimum((t / step + 1e-9).astype(int), len(motion) - 2)
    s = (t / step - k)[:, None]
    before, after = motion[k], motion[k + 1]
    x = (
        (1 + 2 * s) * (1 - s) ** 2 * before[:, :1] + s * (1 - s) ** 2 * step * before[:, 1:]
        + s**2 * (3 - 2 * s) * after[:, :1] + s**2 * (s - 1) * step * after[:, 1:]
    )  # fmt: skip
    return np.hstack([x, (1 - s) * before[:, 1:] + s * after[:, 1:]])
