"""An FMU with one coordinate, called point by point (a ``simulators.stepped.SteppedSimulator``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from threading import Lock

import numpy as np

from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.fmu_file import CoSimulationFmu, FmuFile, ModelExchangeFmu, convert_fmi_errors
from labhil.simulators.fmu_solver import PROBED_INPUT, PROBED_STATES, SolverStep
from labhil.simulators.pointwise import (
    accelerations_at,
    runge_kutta,
    step_under_force,
    step_windows,
)
from labhil.simulators.stepped import AddedForce, Nodes, NonSmooth
from labhil.simulators.tables import Acceleration

SOLVER_ROUNDING = 1e-5
"""Share of an acceleration below which that of a co-simulation's own solver is not accurate."""


class ModelExchangeMechanism:
    """An FMU for model exchange, whose derivatives give the acceleration.

    ``added_force`` acts in :meth:`roll_out`.

    Args:
        fmu: The instance; one thread uses it at a time.
        file: The file, for messages.
        parameters: Value references of the parameters.
        velocity_first: Whether the first state is the velocity.
    """

    non_smooth = NonSmooth()

    def __init__(
        self, fmu: ModelExchangeFmu, file: FmuFile, parameters: Sequence[int], *, velocity_first: bool
    ) -> None:
        self._fmu, self._file, self._parameters = fmu, file, tuple(parameters)
        self._order = -1 if velocity_first else 1
        self._current_values: tuple[float, ...] | None = None
        self._lock = Lock()
        self.added_force = AddedForce()

    def rates(self, numbers: Sequence[float], t: float, state: Sequence[float], drive: float) -> list[float]:
        """Return the rates of position and velocity."""
        with self._lock:
            self._set_parameters(numbers)
            return self._rates(t, state, drive)

    def start_states(self, numbers: Sequence[float]) -> tuple[float, ...]:
        """Return the states after initialisation, in the order of the FMU."""
        with self._lock:
            self._current_values = None
            self._set_parameters(numbers)
            return self._fmu.states()

    def acceleration_at(self, numbers: Sequence[float]) -> Acceleration:
        """Return the acceleration."""

        def accelerations(x: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
            with self._lock:
                self._set_parameters(numbers)
                return accelerations_at(partial(self._rates, 0.0), x, v, u)

        return accelerations

    def inertia(self, numbers: Sequence[float]) -> float | None:
        """Return None: forces act like the input."""
        return None

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Integrate all windows by Runge-Kutta steps under the mean of the input, (N, 2)."""
        with self._lock:
            self._set_parameters(numbers)
            return step_windows(record, nodes, windows, states, self._advance)

    def _advance(self, t: float, state: FloatArray, drive: float, length: float) -> FloatArray:
        def rates(at: FloatArray) -> list[float]:
            return self._rates(0.0, at, drive + self.added_force.at(t, at, drive))

        return runge_kutta(rates, state, length, self.added_force.parts(length))

    def _rates(self, t: float, state: Sequence[float] | FloatArray, drive: float) -> list[float]:
        ordered = [float(x) for x in state][:: self._order]
        with convert_fmi_errors(self._file, f"derivatives at states {ordered}, input {drive:g}"):
            return list(self._fmu.rates(t, ordered, drive))[:: self._order]

    def _set_parameters(self, numbers: Sequence[float]) -> None:
        """Initialise the FMU again where its parameters have changed."""
        values = tuple(float(x) for x in numbers)[: len(self._parameters)]
        if values != self._current_values:
            self._current_values = None
            self._fmu.initialise(dict(zip(self._parameters, values, strict=True)))
            self._current_values = values


class _RefusedStepError(Exception):
    """A co-simulation does not make steps of this length."""


class CoSimulationMechanism:
    """An FMU for co-simulation, whose acceleration is taken from two short steps from each state.

    ``added_force`` acts in :meth:`roll_out`.

    Args:
        fmu: The instance; one thread uses it at a time.
        file: The file, for messages.
        parameters: Value references of the parameters.
        step: How its solver steps.

    Attributes:
        own_solver: Whether a roll-out is the FMU's own; otherwise its rates are integrated.
    """

    non_smooth = NonSmooth(rounding=SOLVER_ROUNDING)

    def __init__(
        self, fmu: CoSimulationFmu, file: FmuFile, parameters: Sequence[int], step: SolverStep
    ) -> None:
        self._fmu, self._file, self._parameters, self._step = fmu, file, tuple(parameters), step
        self._lock = Lock()
        self.added_force, self.own_solver = AddedForce(), True

    def rates(self, numbers: Sequence[float], t: float, state: Sequence[float], drive: float) -> list[float]:
        """Return the rates of position and velocity; the time is always 0."""
        with self._lock:
            return self._rates(self._start_values(numbers), state, drive)

    def acceleration_at(self, numbers: Sequence[float]) -> Acceleration:
        """Return the acceleration."""
        starts = self._start_values(numbers)

        def accelerations(x: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
            with self._lock:
                return accelerations_at(partial(self._rates, starts), x, v, u)

        return accelerations

    def inertia(self, numbers: Sequence[float]) -> float | None:
        """Return None: forces act like the input."""
        return None

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Step all windows from sample to sample under the mean of the input, (N, 2).

        The FMU's accelerations are integrated instead where it refuses steps of that length, or
        ``own_solver`` is False.
        """
        starts = self._start_values(numbers)

        def start(state: FloatArray, drive: float) -> None:
            with convert_fmi_errors(self._file, "a start from any state"):
                self._fmu.start(starts, state.tolist(), drive)

        def step(_: FloatArray, drive: float, length: float) -> Sequence[float]:
            after = self._fmu.try_step(drive, length)
            if after is None:
                raise _RefusedStepError
            return after

        def advance(t: float, state: FloatArray, drive: float, length: float) -> FloatArray:
            return step_under_force(step, self.added_force, t, state, drive, length)

        def integrate(t: float, state: FloatArray, drive: float, length: float) -> FloatArray:
            def rates(at: FloatArray) -> list[float]:
                return self._rates(starts, at.tolist(), drive + self.added_force.at(t, at, drive))

            return runge_kutta(rates, state, length, self.added_force.parts(length))

        with self._lock:
            if self.own_solver:
                with suppress(_RefusedStepError):
                    return step_windows(record, nodes, windows, states, advance, start)
            return step_windows(record, nodes, windows, states, integrate)

    def makes_steps_of(self, numbers: Sequence[float], length: float) -> bool:
        """Whether the FMU makes a step of ``length`` s."""
        with self._lock:
            self._fmu.start(self._start_values(numbers), PROBED_STATES[0], PROBED_INPUT)
            return self._fmu.try_step(PROBED_INPUT, length) is not None

    def _rates(self, starts: Mapping[int, float], state: Sequence[float], drive: float) -> list[float]:
        h = self._step.length
        with convert_fmi_errors(
            self._file, f"two steps of {h:g} s from states {list(state)}, input {drive:g}"
        ):
            self._fmu.start(starts, state, drive)
            first = np.asarray(state, dtype=np.float64)
            once, twice = (np.array(self._fmu.step(drive, h)) for _ in range(2))
        return list(self._step.rates(first, once, twice))

    def _start_values(self, numbers: Sequence[float]) -> dict[int, float]:
        return {k: float(x) for k, x in zip(self._parameters, numbers, strict=False)}
