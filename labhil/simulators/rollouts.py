"""Windows of a recording as MuJoCo itself steps them, from a state that is set at the begin of each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from labhil.errors import UsageError
from labhil.extras import load_optional
from labhil.physics.model import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.stepped import Nodes

THREADS = 2

MOST_STEPS = 10_000_000
"""Steps of all windows together: they take 400 MB."""


class Driven(NamedTuple):
    """Where a mechanism takes its input: a control, or a force at its joint; ``actuator`` is −1 for that."""

    actuator: int
    control: int


Push = Callable[[float, float, float], float]
"""(position, velocity, force of the actuator) to one more force at the joint."""


def roll_out(
    model: Any,
    driven: Driven,
    record: Record,
    nodes: Nodes,
    windows: Windows,
    states: FloatArray,
    push: Push | None = None,
) -> FloatArray:
    """Step a model with one degree of freedom through all windows at once.

    MuJoCo steps evenly at its own time step. In each step the input is its mean over the step, and what lies
    between two steps is read off the cubic through both.

    Args:
        model: A ``mujoco.MjModel``.
        driven: Where the input goes.
        record: The recording.
        nodes: Times and values of the input.
        windows: Stretches of the recording.
        states: Position and velocity (w, 2) that each begins with.
        push: One more force; with it the windows are stepped one by one.

    Returns:
        Position and velocity (N, 2) at the samples of all windows.
    """
    mujoco, rollout = load_optional("mujoco", "an MJCF file"), load_optional("mujoco.rollout", "an MJCF file")
    step, begins = float(model.opt.timestep), record.t[windows.first]
    steps = int(min(np.ceil(np.max(record.t[windows.last - 1] - begins) / step), MOST_STEPS)) + 1
    if steps * len(begins) > MOST_STEPS:
        raise UsageError(
            f"expected a MuJoCo file whose time step makes at most {MOST_STEPS} steps of a recording, found "
            f'timestep="{step:g}"'
        )
    edges = begins[:, None] + step * np.arange(steps + 1)
    control = means(nodes, edges)[:, :, None]
    if push is not None:
        motion = _step_with_push(model, driven, nodes, begins, states, control[:, :, 0], push)
        return _at_samples(record, windows, begins, motion, step)
    if driven.actuator >= 0 and model.nu > 1:
        control = control * np.eye(model.nu)[driven.control]
    kinds = mujoco.mjtState
    data = [mujoco.MjData(model) for _ in range(THREADS)]
    begun = np.array(
        [_state(model, data[0], driven, nodes, t, s) for t, s in zip(begins, states, strict=True)]
    )
    spec = kinds.mjSTATE_CTRL if driven.actuator >= 0 else kinds.mjSTATE_QFRC_APPLIED
    full_states, _ = rollout.rollout(model, data, begun, control, control_spec=int(spec), nstep=steps)
    # of a full state the time is first, then position and velocity of the only degree of freedom
    motion = np.concatenate([begun[:, None, 1:3], full_states[:, :, 1:3]], axis=1)
    return _at_samples(record, windows, begins, motion, step)


def _at_samples(
    record: Record, windows: Windows, begins: FloatArray, motion: FloatArray, step: float
) -> FloatArray:
    return np.concatenate(
        [
            _between(record.t[first:last] - t, motion[w], step)
            for w, (first, last, t) in enumerate(zip(windows.first, windows.last, begins, strict=True))
        ]
    )


def _step_with_push(
    model: Any,
    driven: Driven,
    nodes: Nodes,
    begins: FloatArray,
    states: FloatArray,
    control: FloatArray,
    push: Push,
) -> FloatArray:
    """Position and velocity (w, steps + 1, 2), with a force that is evaluated in every step."""
    mujoco = load_optional("mujoco", "an MJCF file")
    data = mujoco.MjData(model)
    out = np.empty((len(begins), control.shape[1] + 1, 2))
    spec = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
    for w, now in enumerate(begins):
        mujoco.mj_setState(model, data, _state(model, data, driven, nodes, now, states[w]), spec)
        out[w, 0] = states[w]
        for k, u in enumerate(control[w].tolist()):
            direct = 0.0 if driven.actuator >= 0 else u
            if driven.actuator >= 0:
                data.ctrl[driven.control] = u
            drive = u if driven.actuator < 0 else float(data.qfrc_actuator[0])
            data.qfrc_applied[0] = direct + push(float(data.qpos[0]), float(data.qvel[0]), drive)
            mujoco.mj_step(model, data)
            out[w, k + 1] = data.qpos[0], data.qvel[0]
    return out


def means(nodes: Nodes, edges: FloatArray) -> FloatArray:
    """Mean of an input over the stretches (…, n) between edges (…, n + 1); it keeps its first and last."""
    t, u = nodes
    first, last = float(np.min(edges)) - 1.0, float(np.max(edges)) + 1.0
    t = np.concatenate([[min(first, t[0])], t, [max(last, t[-1])]])
    u = np.concatenate([u[:1], u, u[-1:]])
    area = np.concatenate([[0.0], np.cumsum(0.5 * (u[1:] + u[:-1]) * np.diff(t))])
    k = np.clip(np.searchsorted(t, edges, side="right") - 1, 0, len(t) - 2)
    width = np.maximum(t[k + 1] - t[k], 1e-300)
    past = edges - t[k]
    upto = area[k] + past * (u[k] + 0.5 * (u[k + 1] - u[k]) * past / width)
    return np.asarray(np.diff(upto, axis=-1) / np.diff(edges, axis=-1))


def _state(model: Any, data: Any, driven: Driven, nodes: Nodes, now: float, state: FloatArray) -> FloatArray:
    """The full state of MuJoCo at the begin of a window, with the past of a delayed input."""
    mujoco = load_optional("mujoco", "an MJCF file")
    mujoco.mj_resetData(model, data)
    data.time, data.qpos[0], data.qvel[0] = now, *state
    if driven.actuator >= 0 and hasattr(model, "nhistory"):
        count = int(model.actuator_history[driven.actuator][0])
        if count:
            edges = now + model.opt.timestep * np.arange(-count, 1)
            past = np.ascontiguousarray(means(nodes, edges)[:, None])
            mujoco.mj_initCtrlHistory(model, data, driven.actuator, edges[:-1].copy(), past)
    spec = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
    full_state = np.empty(mujoco.mj_stateSize(model, spec))
    mujoco.mj_getState(model, data, full_state, spec)
    return full_state


def _between(t: FloatArray, motion: FloatArray, step: float) -> FloatArray:
    """Position and velocity (n, 2) at times since the begin, from those at even steps."""
    k = np.minimum((t / step + 1e-9).astype(int), len(motion) - 2)
    s = (t / step - k)[:, None]
    before, after = motion[k], motion[k + 1]
    x = (
        (1 + 2 * s) * (1 - s) ** 2 * before[:, :1] + s * (1 - s) ** 2 * step * before[:, 1:]
        + s**2 * (3 - 2 * s) * after[:, :1] + s**2 * (s - 1) * step * after[:, 1:]
    )  # fmt: skip
    return np.hstack([x, (1 - s) * before[:, 1:] + s * after[:, 1:]])
