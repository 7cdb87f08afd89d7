"""A current loop: a PI that brings a coil's current to a command by its voltage, step by step in a device.

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
"""Places of the current (A) and of the PI's integral (V)."""


@compiled
def run_loop(
    state: FloatArray, commands: FloatArray, steps: int, h: float,
    resistance: float, inductance: float, lag: float, supply: float, induced: float, out: FloatArray,
) -> None:  # fmt: skip
    """Currents ``out`` (n,) at the ends of sample periods in which the ``commands`` (n,) are held."""
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
    """Coil (Ω, H) and PI of lag ``lag`` (s) with a supply of ± ``supply`` (V), ``rate`` steps per second.

    ``period`` (s) is that of the samples. UsageError when the PI is too slow for its lag, or makes no
    whole steps per sample: it would not be stable.
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
        """Currents (n,) A at the ends of sample periods in which ``commands`` (n,) are held.

        ``resistance`` (Ω) and the ``induced`` voltage (V) are those of this stretch.
        """
        out = np.empty(len(commands))
        run_loop(
            self._state, np.asarray(commands, dtype=np.float64), self._steps, self._h,
            resistance, self._inductance, self._lag, self._supply, induced, out,
        )  # fmt: skip
        return out
