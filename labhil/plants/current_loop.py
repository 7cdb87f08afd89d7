"""A digital current loop: a PI controller of the current of a coil.

Coil: L·di/dt = u − R·i − e, with e what a motion induces; solved exactly for a voltage that is held over
a step. PI: u = L/τ·(i* − i) + R/τ·∫(i* − i)dt, so that its zero cancels the coil's pole and the current
follows with the lag τ; the integral stands still while the supply limits the voltage.
"""

from __future__ import annotations

import math

import numpy as np

from labhil.compiled import compiled
from labhil.errors import UsageError
from labhil.signals import FloatArray

CURRENT, INTEGRAL = range(2)
"""Indices of the current (A) and of the controller's integral (V)."""


@compiled
def run_loop(
    state: FloatArray, commands: FloatArray, steps: int, h: float,
    resistance: float, inductance: float, lag: float, supply: float, induced: float, out: FloatArray,
) -> None:  # fmt: skip
    """Write the currents ``out`` (n,) at the ends of sample periods with held ``commands`` (n,)."""
    decay = math.exp(-resistance * h / inductance)
    for n in range(commands.size):
        for _ in range(steps):
            error = commands[n] - state[CURRENT]
            demand = inductance / lag * error + state[INTEGRAL]
            voltage = min(max(demand, -supply), supply)
            if voltage == demand:
                state[INTEGRAL] += resistance / lag * error * h
            final_current = (voltage - induced) / resistance
            state[CURRENT] = final_current + (state[CURRENT] - final_current) * decay
        out[n] = state[CURRENT]


class CurrentLoop:
    """A coil and its PI controller.

    Args:
        inductance: Inductance of the coil, H.
        lag: Time constant of the closed loop, s.
        supply: Limit of the voltage, ±V.
        rate: Steps of the controller per second.
        period: Time between samples, s.

    Raises:
        UsageError: The lag is shorter than two steps: the loop would not be stable.
    """

    def __init__(self, inductance: float, lag: float, supply: float, rate: float, period: float) -> None:
        self._steps = max(round(period * rate), 1)
        self._h = period / self._steps
        if not lag >= 2.0 * self._h:
            raise UsageError(
                f"loop_time must be 2 steps of the current loop at least ({2.0 * self._h:g} s), found {lag:g}"
            )
        self._inductance, self._lag, self._supply = inductance, lag, supply
        self._state = np.zeros(2)

    def follow(self, commands: FloatArray, resistance: float, induced: float = 0.0) -> FloatArray:
        """Return the currents (n,), A, at the ends of sample periods in which ``commands`` (n,), A, are held.

        ``resistance`` (Ω) and ``induced`` voltage (V) are constant in these periods.
        """
        out = np.empty(len(commands))
        run_loop(
            self._state, np.asarray(commands, dtype=np.float64), self._steps, self._h,
            resistance, self._inductance, self._lag, self._supply, induced, out,
        )  # fmt: skip
        return out
