"""A Python function that simulates a whole input, as a simulator (see :mod:`labhil.simulators.stepped`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from labhil.errors import UsageError
from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.pointwise import accelerations_at, extrapolate_rates, step_under_force, step_windows
from labhil.simulators.python_step import parameter_named
from labhil.simulators.rollouts import interval_means
from labhil.simulators.stepped import AddedForce, Nodes, NonSmooth
from labhil.simulators.tables import Acceleration

RolloutFunction = Callable[[Any, FloatArray, Any, Any], Any]
"""``simulate(p, t, u, x0)`` to the states (n, 2) at times t (n,), which begin at 0; ``u.NAME`` is an array
(n,) of what is held from each time to the next, ``x0`` the states at the first."""


class PythonRollout:
    """A user's function with the classes of its arguments.

    ``added_force`` acts in :meth:`roll_out`.

    Args:
        simulate: The function.
        name: Name of the simulator.
        records: Classes of states, inputs and parameters.
        inertia: Name of the parameter that forces are divided by; empty where they act like the input.
    """

    non_smooth = NonSmooth()

    def __init__(
        self, simulate: RolloutFunction, name: str, records: tuple[Any, Any, Any], inertia: str = ""
    ) -> None:
        self._simulate, self._name, self._records, self._inertia = simulate, name, records, inertia
        self.added_force = AddedForce()
        self._step = 1e-4

    def choose_step(
        self,
        starts: Sequence[float],
        *,
        steps: Sequence[float] = (1e-4, 1e-3, 1e-2),
        state: tuple[float, float] = (0.1, 0.5),
        tolerance: float = 0.05,
    ) -> None:
        """Choose the first step in which the position moves: one with its own steps needs longer ones.

        Args:
            starts: Values of the parameters.
            steps: Steps to try, s.
            state: Position and velocity from which they are tried.
            tolerance: Error of the position's rate, relative to the velocity.
        """
        for step in steps:
            self._step = step
            rate = self.rates(starts, state, 0.0)[0]
            if abs(rate - state[1]) <= tolerance * state[1]:
                return
        self._step = steps[0]

    def rates(self, numbers: Sequence[float], state: Sequence[float], drive: float) -> list[float]:
        """Take the rates of both states from a short step and one of twice its length."""
        h, begin = self._step, np.asarray(state, dtype=np.float64)
        motion = self._run(numbers, h * np.arange(3.0), np.full(3, drive), begin)
        return [float(x) for x in extrapolate_rates(begin, motion[1], motion[2], h)]

    def acceleration_at(self, numbers: Sequence[float]) -> Acceleration:
        """Return the acceleration from short runs."""
        return partial(accelerations_at, partial(self.rates, numbers))

    def inertia(self, numbers: Sequence[float]) -> float | None:
        """Return the parameter that forces are divided by; None where they act like the input."""
        return parameter_named(self._inertia, self._records[2], numbers)

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Simulate each window in one call, under the mean of the input, (N, 2); under a force in steps."""
        if self.added_force.force is not None:
            return self._roll_out_under_force(numbers, record, nodes, windows, states)
        motions = []
        for w, (first, last) in enumerate(zip(windows.first, windows.last, strict=True)):
            t = record.t[first:last]
            drives = interval_means(nodes, t) if len(t) > 1 else np.zeros(1)
            drives_held = np.append(drives, drives[-1])[: len(t)]
            motions.append(self._run(numbers, t - t[0], drives_held, np.asarray(states[w], dtype=np.float64)))
        return np.concatenate(motions)

    def _roll_out_under_force(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        inertia = self.inertia(numbers)

        def step(state: FloatArray, drive: float, length: float) -> FloatArray:
            return self._run(numbers, np.array([0.0, length]), np.full(2, drive), state)[-1]

        def advance(t: float, state: FloatArray, drive: float, length: float) -> FloatArray:
            return step_under_force(step, self.added_force, t, state, drive, length, inertia=inertia)

        return step_windows(record, nodes, windows, states, advance)

    def _run(
        self, numbers: Sequence[float], t: FloatArray, drive: FloatArray, begin: FloatArray
    ) -> FloatArray:
        states, inputs, parameters = self._records
        count = len(parameters._fields)
        simulated = self._simulate(
            parameters(*list(numbers)[:count]), t, inputs(drive), states(*begin.tolist())
        )
        motion = np.asarray(simulated, dtype=np.float64)
        expected = (len(t), len(begin))
        if motion.shape != expected:
            raise UsageError(
                f"simulator {self._name!r}: expected the states at all times, an array {expected} of "
                f"{', '.join(states._fields)}, found one of shape {motion.shape}"
            )
        if not np.array_equal(motion[0], begin):
            raise UsageError(
                f"simulator {self._name!r}: expected the first of the states to be x0 = {begin.tolist()}, "
                f"found {motion[0].tolist()}"
            )
        return motion
