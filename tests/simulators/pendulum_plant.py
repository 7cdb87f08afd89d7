"""A pendulum with dry friction, solved by scipy with its rests and starts as events: no code of a model."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from labhil.signals import FloatArray

INERTIA, GRAVITY, DRAG = 0.025, 0.45, 0.012


def torques(t: FloatArray, random: np.random.Generator) -> FloatArray:
    """A sum of sines that is held between the samples."""
    waves = [
        random.uniform(0.03, 0.1) * np.sin(2 * np.pi * random.uniform(0.1, 1.6) * t + random.uniform(0, 6.28))
        for _ in range(6)
    ]
    return np.asarray(np.sum(waves, axis=0))


def swung(t: FloatArray, u: FloatArray, *, dry: float = 0.0, late: int = 0) -> FloatArray:
    """Angles (n,) at times ``t``, under dry friction ``dry`` (N·m) and a torque that is ``late`` samples."""
    acting = np.r_[np.full(late, u[0]), u[: len(u) - late]]
    angles, state = [0.2], np.array([0.2, 0.0])
    for begin, end, torque in zip(t[:-1], t[1:], acting[:-1], strict=True):
        state = _between(float(begin), float(end), state, float(torque), dry)
        angles.append(float(state[0]))
    return np.array(angles)


def _between(begin: float, end: float, state: FloatArray, torque: float, dry: float) -> FloatArray:
    while begin < end:
        pull = torque - GRAVITY * np.sin(state[0])
        if state[1] == 0.0 and abs(pull) <= dry:
            return state
        side = np.sign(state[1]) if state[1] else np.sign(pull)

        def rates(_: float, x: FloatArray, side: float = side) -> list[float]:
            push = torque - GRAVITY * np.sin(x[0]) - DRAG * x[1] - side * dry
            return [x[1], push / INERTIA]

        def stands(_: float, x: FloatArray, side: float = side) -> float:
            return float(x[1] * side)

        stands.terminal, stands.direction = True, -1  # type: ignore[attr-defined]
        found = solve_ivp(rates, (begin, end), state, events=stands, rtol=1e-8, atol=1e-10)
        state, begin = found.y[:, -1].copy(), float(found.t[-1])
        if found.status == 1:
            state[1] = 0.0
    return state
