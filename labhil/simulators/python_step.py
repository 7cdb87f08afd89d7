"""A Python function that makes one step, as a simulator (satisfies ``simulators.stepped.Stepped``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from labhil.physics.model import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.pointwise import accelerations_at, extrapolate_rates, step_windows
from labhil.simulators.stepped import Held, Nodes
from labhil.simulators.tables import Ask

StepFunction = Callable[[Any, Any, Any, float], Sequence[float]]
"""``step(state, u, p, dt)`` to the state dt s later; values by name and by number."""

SHORT = 1e-4
"""Length of the steps (s) from which an acceleration is taken."""


def rates_of(step: StepFunction, state: Any, u: Any, p: Any) -> tuple[float, float]:
    """Rates of position and velocity, from a short step and one of twice its length (Richardson)."""
    begin = np.asarray(state, dtype=np.float64)
    once, twice = (np.asarray(step(state, u, p, h), dtype=np.float64) for h in (SHORT, 2.0 * SHORT))
    if once.shape != begin.shape or twice.shape != begin.shape:
        return tuple(once.tolist())  # of a wrong number of states, which the probe of the simulator reports
    rates = extrapolate_rates(begin, once, twice, SHORT)
    return float(rates[0]), float(rates[1])


class PythonStep:
    """A user's step function with the names of what it takes."""

    held = Held()

    def __init__(self, step: StepFunction, records: tuple[Any, Any, Any]) -> None:
        self._step, self._records = step, records

    def ask(self, numbers: Sequence[float]) -> Ask:
        """Its acceleration, from short steps."""
        states, inputs, parameters = self._records
        p = parameters(*numbers)

        def rates(at: Sequence[float], drive: float) -> tuple[float, float]:
            return rates_of(self._step, states(*at), inputs(drive), p)

        return partial(accelerations_at, rates)

    def inertia(self, numbers: Sequence[float]) -> float | None:
        """Only its input is known to push."""
        return None

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Position and velocity (N, 2), stepped from sample to sample under the mean of the input."""
        names, inputs, parameters = self._records
        p = parameters(*numbers)

        def go(state: FloatArray, drive: float, length: float) -> FloatArray:
            return np.asarray(self._step(names(*state.tolist()), inputs(drive), p, length), dtype=np.float64)

        return step_windows(record, nodes, windows, states, go)
