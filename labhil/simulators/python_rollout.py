"""A Python function that simulates a whole input, as a simulator (see ``simulators.stepped.Stepped``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from labhil.errors import UsageError
from labhil.physics.model import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.pointwise import accelerations_at, extrapolate_rates
from labhil.simulators.rollouts import means
from labhil.simulators.stepped import Held, Nodes
from labhil.simulators.tables import Ask

RolloutFunction = Callable[[Any, FloatArray, Any, Any], Any]
"""``simulate(p, t, u, x0)`` to the states (n, 2) at times t (n,), which begin at 0; ``u.NAME`` is an array
(n,) of what is held from each time to the next, ``x0`` the states at the first."""

LENGTHS = (1e-4, 1e-3, 1e-2)
"""Of the short steps (s) from which an acceleration is taken; the first at which the position moves."""

PROBE = (0.1, 0.5)
MOVES = 0.05
"""Share of the velocity by which a short step may miss it."""


class PythonRollout:
    """A user's function with the names of what it takes."""

    held = Held()

    def __init__(self, simulate: RolloutFunction, name: str, records: tuple[Any, Any, Any]) -> None:
        self._simulate, self._name, self._records = simulate, name, records
        self._length = LENGTHS[0]

    def settle(self, starts: Sequence[float]) -> None:
        """Choose the length of short steps: what goes on in steps of its own rests within shorter ones."""
        for length in LENGTHS:
            self._length = length
            moved = self.rates(starts, PROBE, 0.0)[0]
            if abs(moved - PROBE[1]) <= MOVES * PROBE[1]:
                return
        self._length = LENGTHS[0]

    def rates(self, numbers: Sequence[float], state: Sequence[float], drive: float) -> list[float]:
        """Rates of both states, from a short step and one of twice its length (Richardson)."""
        h, begin = self._length, np.asarray(state, dtype=np.float64)
        motion = self._run(numbers, h * np.arange(3.0), np.full(3, drive), begin)
        return [float(x) for x in extrapolate_rates(begin, motion[1], motion[2], h)]

    def ask(self, numbers: Sequence[float]) -> Ask:
        """Its acceleration, from short rollouts."""
        return partial(accelerations_at, partial(self.rates, numbers))

    def inertia(self, numbers: Sequence[float]) -> float | None:
        """Only its input is known to push."""
        return None

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Position and velocity (N, 2): one call for each window, under the mean of the input."""
        motions = []
        for w, (first, last) in enumerate(zip(windows.first, windows.last, strict=True)):
            t = record.t[first:last]
            drives = means(nodes, t) if len(t) > 1 else np.zeros(1)
            held = np.append(drives, drives[-1])[: len(t)]
            motions.append(self._run(numbers, t - t[0], held, np.asarray(states[w], dtype=np.float64)))
        return np.concatenate(motions)

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
