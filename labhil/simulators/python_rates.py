"""A Python right-hand side as a simulator that is stepped (see :mod:`labhil.simulators.stepped`).

A fit compiles it; here Python integrates it with a force of another file, in short steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.pointwise import accelerations_at, runge_kutta, step_windows
from labhil.simulators.python_step import parameter_named
from labhil.simulators.stepped import AddedForce, Nodes, NonSmooth
from labhil.simulators.tables import Acceleration

if TYPE_CHECKING:
    from labhil.simulators.simulator import Simulator


class PythonRates:
    """A user's right-hand side; ``added_force`` acts in :meth:`roll_out`."""

    non_smooth = NonSmooth()

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self.added_force = AddedForce()

    def acceleration_at(self, numbers: Sequence[float]) -> Acceleration:
        """Return the acceleration without the force."""
        p = self._parameters(numbers)

        def rates(state: Sequence[float], drive: float) -> Sequence[float]:
            return self._rates(p, state, drive)

        return partial(accelerations_at, rates)

    def inertia(self, numbers: Sequence[float]) -> float | None:
        """Return the parameter that forces are divided by; None where they act like the input."""
        simulator = self._simulator
        return parameter_named(simulator.coordinate.inertia, simulator.records[2], numbers)

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Integrate all windows by Runge-Kutta steps under the mean of the input, (N, 2)."""
        p, inertia = self._parameters(numbers), self.inertia(numbers)

        def advance(t: float, state: FloatArray, drive: float, length: float) -> FloatArray:
            def rates(at: FloatArray) -> Sequence[float]:
                force = self.added_force.at(t, at, drive)
                if inertia is None:
                    return self._rates(p, at.tolist(), drive + force)
                velocity, acceleration = self._rates(p, at.tolist(), drive)
                return velocity, acceleration + force / inertia

            return runge_kutta(rates, state, length, self.added_force.parts(length))

        return step_windows(record, nodes, windows, states, advance)

    def _parameters(self, numbers: Sequence[float]) -> Any:
        parameters = self._simulator.records[2]
        return parameters(*list(numbers)[: len(parameters._fields)])

    def _rates(self, p: Any, state: Sequence[float], drive: float) -> Sequence[float]:
        states, inputs, _ = self._simulator.records
        return self._simulator.f(0.0, states(*state), inputs(drive), p)
