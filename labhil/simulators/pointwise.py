"""Evaluate a simulator point by point: its acceleration at many points, and windows sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from threading import RLock
from typing import ParamSpec, TypeVar

import numpy as np

from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.rollouts import interval_means
from labhil.simulators.stepped import AddedForce, Nodes

_USER_CODE = RLock()
"""Held while a user's function runs."""

P = ParamSpec("P")
R = TypeVar("R")


def one_at_a_time(function: Callable[P, R]) -> Callable[P, R]:
    """Let one thread at a time call a user's function, which may keep a state: an engine that it steps."""

    @wraps(function)
    def call(*arguments: P.args, **named: P.kwargs) -> R:
        with _USER_CODE:
            return function(*arguments, **named)

    return call


def accelerations_at(
    rates: Callable[[Sequence[float], float], Sequence[float]], x: FloatArray, v: FloatArray, u: FloatArray
) -> FloatArray:
    """Evaluate the accelerations (m,) at positions, velocities and inputs (m,).

    Args:
        rates: State and input to the rates of both states.
        x: Positions, (m,).
        v: Velocities, (m,).
        u: Inputs, (m,).

    Returns:
        Accelerations, (m,).
    """
    points = zip(x.tolist(), v.tolist(), u.tolist(), strict=True)
    return np.array([rates(state, drive)[1] for *state, drive in points])


def extrapolate_rates(state: FloatArray, once: FloatArray, twice: FloatArray, step: float) -> FloatArray:
    """Extrapolate the rates of a state from the states after one and two steps of ``step`` s (Richardson)."""
    return np.asarray(2.0 * (once - state) / step - (twice - state) / (2.0 * step))


def runge_kutta(
    rates: Callable[[FloatArray], Sequence[float]], state: FloatArray, length: float, parts: int
) -> FloatArray:
    """Integrate a state over ``length`` s in equal steps of the classical Runge-Kutta method (Kutta 1901).

    Args:
        rates: State (2,) to its rates.
        state: Position and velocity, (2,).
        length: Time, s.
        parts: Number of steps.

    Returns:
        The state after that time, (2,).
    """
    h = length / parts
    for _ in range(parts):
        a = np.array(rates(state))
        b = np.array(rates(state + 0.5 * h * a))
        c = np.array(rates(state + 0.5 * h * b))
        d = np.array(rates(state + h * c))
        state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return state


def step_under_force(
    step: Callable[[FloatArray, float, float], Sequence[float] | FloatArray],
    added: AddedForce,
    t: float,
    state: FloatArray,
    drive: float,
    length: float,
    *,
    inertia: float | None = None,
) -> FloatArray:
    """Make steps of a simulator under an added force, which is held from each step to the next.

    Args:
        step: State, input and time (s) to the state after that time.
        added: The force; without one a single step is made.
        t: Time of the recording, s.
        state: Position and velocity, (2,).
        drive: The input.
        length: Time, s.
        inertia: The force per acceleration; None where the force acts like the input.

    Returns:
        The state after that time, (2,).
    """
    if added.force is None:
        return np.asarray(step(state, drive, length), dtype=np.float64)
    parts = added.parts(length)
    h = length / parts
    for part in range(parts):
        force = added.at(t + part * h, state, drive)
        if inertia is None:
            state = np.asarray(step(state, drive + force, h), dtype=np.float64)
        else:
            state = np.asarray(step(state, drive, h), dtype=np.float64) + np.array([0.0, h * force / inertia])
    return state


def step_windows(
    record: Record,
    nodes: Nodes,
    windows: Windows,
    states: FloatArray,
    advance: Callable[[float, FloatArray, float, float], FloatArray],
    start: Callable[[FloatArray, float], None] = lambda state, drive: None,
) -> FloatArray:
    """Step all windows from sample to sample.

    Args:
        record: The recording.
        nodes: Times and values of the input.
        windows: w windows of the recording, N samples in total.
        states: Position and velocity at the start of each window, (w, 2).
        advance: Time of the recording, state, mean of the input and a time (s) to the state after that time.
        start: Called with the first state and input of each window.

    Returns:
        Position and velocity, (N, 2).
    """
    out, row = np.empty((len(windows.rows), 2)), 0
    for w, (first, last) in enumerate(zip(windows.first, windows.last, strict=True)):
        t, state = record.t[first:last], np.asarray(states[w], dtype=np.float64)
        drives = interval_means(nodes, t) if len(t) > 1 else np.zeros(1)
        start(state, float(drives[0]))
        out[row] = state
        for k, (drive, length) in enumerate(zip(drives.tolist(), np.diff(t).tolist(), strict=False), 1):
            state = advance(float(t[k - 1]), state, drive, length)
            out[row + k] = state
        row += len(t)
    return out
