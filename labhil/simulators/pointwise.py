"""A simulator that answers point by point: its acceleration at many, and windows from sample to sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from labhil.physics.model import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.rollouts import means
from labhil.simulators.stepped import Nodes


def accelerations_at(
    rates: Callable[[Sequence[float], float], Sequence[float]], x: FloatArray, v: FloatArray, u: FloatArray
) -> FloatArray:
    """Accelerations (m,) by ``rates`` of state and input, at positions, velocities, inputs, each (m,)."""
    points = zip(x.tolist(), v.tolist(), u.tolist(), strict=True)
    return np.array([rates(at, drive)[1] for *at, drive in points])


def extrapolate_rates(begin: FloatArray, once: FloatArray, twice: FloatArray, length: float) -> FloatArray:
    """Rates of states from where they are after a step and after one twice as long (Richardson)."""
    return np.asarray(2.0 * (once - begin) / length - (twice - begin) / (2.0 * length))


def step_windows(
    record: Record,
    nodes: Nodes,
    windows: Windows,
    states: FloatArray,
    go: Callable[[FloatArray, float, float], FloatArray],
    begin: Callable[[FloatArray, float], None] = lambda state, drive: None,
) -> FloatArray:
    """States (N, 2) of all windows, from sample to sample.

    Args:
        record: The recording.
        nodes: Times and values of the input.
        windows: Stretches of the recording.
        states: Position and velocity (w, 2) that each begins with.
        go: State, mean of the input, length (s) to the state after it.
        begin: Called with the first state and input of each window.

    Returns:
        The states at the samples of all windows.
    """
    out, row = np.empty((len(windows.rows), 2)), 0
    for w, (first, last) in enumerate(zip(windows.first, windows.last, strict=True)):
        t, state = record.t[first:last], np.asarray(states[w], dtype=np.float64)
        drives = means(nodes, t) if len(t) > 1 else np.zeros(1)
        begin(state, float(drives[0]))
        out[row] = state
        for k, (drive, length) in enumerate(zip(drives.tolist(), np.diff(t).tolist(), strict=False), 1):
            state = go(state, drive, length)
            out[row + k] = state
        row += len(t)
    return out
