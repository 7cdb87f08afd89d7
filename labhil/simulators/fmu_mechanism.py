"""An FMU of one coordinate that answers when it is called (satisfies ``simulators.stepped.Stepped``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from math import ceil
from threading import Lock

import numpy as np

from labhil.physics.model import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.fmu_file import Exchanged, FmuFile, Stepping, answers
from labhil.simulators.pointwise import accelerations_at, extrapolate_rates, step_windows
from labhil.simulators.stepped import Held, Nodes
from labhil.simulators.tables import Ask

STEP = 2e-3
"""Longest step (s) by which derivatives of an FMU for model exchange are integrated here."""

ROUGH = 1e-5
"""Share of an acceleration below which that of a co-simulation's own solver is not to be believed."""


class ExchangedMechanism:
    """An FMU for model exchange: its derivatives are the acceleration, in the order of its states.

    ``turned`` says that its first state is the velocity. One instance answers one question at a time.
    """

    held = Held()

    def __init__(self, fmu: Exchanged, file: FmuFile, parameters: Sequence[int], *, turned: bool) -> None:
        self._fmu, self._file, self._parameters = fmu, file, tuple(parameters)
        self._turn = -1 if turned else 1
        self._begun: tuple[float, ...] | None = None
        self._lock = Lock()

    def rates(self, numbers: Sequence[float], t: float, state: Sequence[float], drive: float) -> list[float]:
        """Rates of position and velocity at these values of its parameters."""
        with self._lock:
            self._at(numbers)
            return self._rates(t, state, drive)

    def start_states(self, numbers: Sequence[float]) -> tuple[float, ...]:
        """The states at which it starts by itself."""
        with self._lock:
            self._begun = None
            self._at(numbers)
            return self._fmu.states()

    def ask(self, numbers: Sequence[float]) -> Ask:
        """Its acceleration."""

        def accelerations(x: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
            with self._lock:
                self._at(numbers)
                return accelerations_at(partial(self._rates, 0.0), x, v, u)

        return accelerations

    def inertia(self, numbers: Sequence[float]) -> float | None:
        """Only its input is known to push."""
        return None

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Position and velocity (N, 2) by steps of Runge and Kutta under the mean of the input."""
        with self._lock:
            self._at(numbers)
            return step_windows(record, nodes, windows, states, self._go)

    def _go(self, state: FloatArray, drive: float, length: float) -> FloatArray:
        parts = max(1, ceil(length / STEP))
        h = length / parts
        for _ in range(parts):
            a = np.array(self._rates(0.0, state, drive))
            b = np.array(self._rates(0.0, state + 0.5 * h * a, drive))
            c = np.array(self._rates(0.0, state + 0.5 * h * b, drive))
            d = np.array(self._rates(0.0, state + h * c, drive))
            state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        return state

    def _rates(self, t: float, state: Sequence[float] | FloatArray, drive: float) -> list[float]:
        ordered = [float(x) for x in state][:: self._turn]
        with answers(self._file, f"derivatives at states {ordered}, input {drive:g}"):
            return list(self._fmu.rates(t, ordered, drive))[:: self._turn]

    def _at(self, numbers: Sequence[float]) -> None:
        """Initialise it anew where its parameters have changed."""
        wanted = tuple(float(x) for x in numbers)[: len(self._parameters)]
        if wanted != self._begun:
            self._begun = None
            self._fmu.begin(dict(zip(self._parameters, wanted, strict=True)))
            self._begun = wanted


class SteppingMechanism:
    """An FMU for co-simulation: its acceleration is taken from two short steps behind each start."""

    held = Held(rough=ROUGH)

    def __init__(self, fmu: Stepping, file: FmuFile, parameters: Sequence[int], step: float) -> None:
        self._fmu, self._file, self._parameters, self._step = fmu, file, tuple(parameters), step
        self._lock = Lock()

    def rates(self, numbers: Sequence[float], t: float, state: Sequence[float], drive: float) -> list[float]:
        """Rates of position and velocity at these values of its parameters; it begins at time 0 always."""
        with self._lock:
            return self._rates(self._starts(numbers), state, drive)

    def ask(self, numbers: Sequence[float]) -> Ask:
        """Its acceleration."""
        starts = self._starts(numbers)

        def accelerations(x: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
            with self._lock:
                return accelerations_at(partial(self._rates, starts), x, v, u)

        return accelerations

    def inertia(self, numbers: Sequence[float]) -> float | None:
        """Only its input is known to push."""
        return None

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Position and velocity (N, 2), stepped from sample to sample under the mean of the input."""
        starts = self._starts(numbers)

        def begin(state: FloatArray, drive: float) -> None:
            with answers(self._file, "a start from any state"):
                self._fmu.start(starts, state.tolist(), drive)

        def go(_: FloatArray, drive: float, length: float) -> FloatArray:
            with answers(self._file, f"steps of {length:g} s"):
                return np.array(self._fmu.step(drive, length))

        with self._lock:
            return step_windows(record, nodes, windows, states, go, begin)

    def _rates(self, starts: Mapping[int, float], state: Sequence[float], drive: float) -> list[float]:
        h = self._step
        with answers(self._file, f"two steps of {h:g} s from states {list(state)}, input {drive:g}"):
            self._fmu.start(starts, state, drive)
            begin = np.asarray(state, dtype=np.float64)
            once, twice = (np.array(self._fmu.step(drive, h)) for _ in range(2))
        return [float(x) for x in extrapolate_rates(begin, once, twice, h)]

    def _starts(self, numbers: Sequence[float]) -> dict[int, float]:
        return {k: float(x) for k, x in zip(self._parameters, numbers, strict=False)}
