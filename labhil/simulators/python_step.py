"""A Python function that makes one step, as a simulator (see :mod:`labhil.simulators.stepped`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.pointwise import accelerations_at, extrapolate_rates, step_under_force, step_windows
from labhil.simulators.stepped import AddedForce, Nodes, NonSmooth
from labhil.simulators.tables import Acceleration

StepFunction = Callable[[Any, Any, Any, float], Sequence[float]]
"""``step(state, u, p, dt)`` to the state dt s later; values by name and by number."""


def rates_of(step: StepFunction, state: Any, u: Any, p: Any, *, length: float = 1e-4) -> tuple[float, float]:
    """Take the rates of both states from a short step and one of twice its length.

    Args:
        step: The step function.
        state: Position and velocity.
        u: The input.
        p: The parameters.
        length: Length of the short step, s.

    Returns:
        Rates of position and velocity.
    """
    first = np.asarray(state, dtype=np.float64)
    once, twice = (np.asarray(step(state, u, p, h), dtype=np.float64) for h in (length, 2.0 * length))
    if once.shape != first.shape or twice.shape != first.shape:
        return tuple(once.tolist())  # a wrong number of states, which the probe of the simulator reports
    rates = extrapolate_rates(first, once, twice, length)
    return float(rates[0]), float(rates[1])


def parameter_named(name: str, parameters: Any, numbers: Sequence[float]) -> float | None:
    """Return the number of a parameter among those of a class of parameters; None where it has none."""
    return dict(zip(parameters._fields, numbers, strict=False)).get(name)


class PythonStep:
    """A user's step function with the classes of its arguments.

    ``added_force`` acts in :meth:`roll_out`.

    Args:
        step: The function.
        records: Classes of states, inputs and parameters.
        inertia: Name of the parameter that forces are divided by; empty where they act like the input.
    """

    non_smooth = NonSmooth()

    def __init__(self, step: StepFunction, records: tuple[Any, Any, Any], inertia: str = "") -> None:
        self._step, self._records, self._inertia = step, records, inertia
        self.added_force = AddedForce()

    def acceleration_at(self, numbers: Sequence[float]) -> Acceleration:
        """Return the acceleration from short steps."""
        states, inputs, parameters = self._records
        p = parameters(*numbers)

        def rates(state: Sequence[float], drive: float) -> tuple[float, float]:
            return rates_of(self._step, states(*state), inputs(drive), p)

        return partial(accelerations_at, rates)

    def inertia(self, numbers: Sequence[float]) -> float | None:
        """Return the parameter that forces are divided by; None where they act like the input."""
        return parameter_named(self._inertia, self._records[2], numbers)

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Step all windows from sample to sample under the mean of the input, (N, 2)."""
        names, inputs, parameters = self._records
        p, inertia = parameters(*numbers), self.inertia(numbers)

        def step(state: FloatArray, drive: float, length: float) -> Sequence[float]:
            return self._step(names(*state.tolist()), inputs(drive), p, length)

        def advance(t: float, state: FloatArray, drive: float, length: float) -> FloatArray:
            return step_under_force(step, self.added_force, t, state, drive, length, inertia=inertia)

        return step_windows(record, nodes, windows, states, advance)
