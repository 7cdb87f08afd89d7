"""Simulate a plant with one input from sample to sample, through its input path."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import FunctionType
from typing import Any

import numpy as np

from labhil.compiled import specialised
from labhil.errors import UsageError
from labhil.plants.friction import Friction
from labhil.plants.input_path import (
    HISTORY,
    LIMITED,
    MAX_DELAY_SAMPLES,
    NEWEST,
    TIME_TOLERANCE,
    InputPath,
    add_command,
    delayed_command,
    pass_through,
)
from labhil.plants.integrator import (
    LAG,
    MIN_STATE_SIZE,
    PLANT_STATES,
    SENSOR,
    STAGES,
    Body,
    Workspace,
    X,
    compile_integrator,
    integrate,
)
from labhil.plants.maxwell import N_ELEMENT_STATES
from labhil.plants.trajectory import SampleTimes
from labhil.signals import FloatArray, IntArray

INITIAL_STEP = 0.05
"""Length of the very first step, as a share of a sample period."""
TOLERANCE = 1e-9
"""Error of one step relative to the largest size of a state so far, for plants without hysteresis."""

Kernel = Callable[..., None]


def run(
    inputs: FloatArray, ends: FloatArray, clock: FloatArray, times: FloatArray, values: FloatArray,
    counters: IntArray, memory: FloatArray, is_held: bool, s: FloatArray, mode: FloatArray,
    b: Body, m: Any, f: Friction, p: InputPath, w: Workspace, out: FloatArray,
) -> None:  # fmt: skip
    """Simulate sample periods up to ``ends`` (n,) s with the inputs (n,); write ``out`` (n, states + 1).

    A held input acts from the start of its period; another one is linear between the samples. A row of
    ``out`` has the states at the end of a period and the acting input.
    """
    for n in range(inputs.size):
        start, end = clock[0], ends[n]
        tolerance_s = TIME_TOLERANCE * (end - start)
        add_command(times, values, counters, start if is_held else end, inputs[n])
        t, u = start, 0.0
        while end - t > tolerance_s:
            segment = delayed_command(times, values, counters, t, p.delay, tolerance_s, is_held)
            u, slope, remaining = pass_through(memory, segment, p)
            h = max(min(remaining, end - t), tolerance_s)
            integrate(s, mode, u, slope, h, b, m, f, w)
            memory[LIMITED] += h * slope
            u += h * slope
            t += h
        clock[0] = end
        for j in range(s.size):
            out[n, j] = s[j]
        out[n, s.size] = s[LAG] if b.lag > 0.0 else u


def compile_kernel(applied_force: Callable[..., Any], update_memory: Callable[..., Any], rig: str) -> Kernel:
    """Compile :func:`run` for a rig, to be called by a cached kernel; arguments as for `compile_integrator`.

    ``rig`` is the name of the rig's module: numba would otherwise confuse functions of the same name of two
    rigs that a process loads from the cache.
    """
    scope = {**globals(), "__name__": rig, "integrate": compile_integrator(applied_force, update_memory, rig)}
    bound: Kernel = specialised(FunctionType(run.__code__, scope, "run"))
    return bound


def pack(numbers: Any) -> Any:
    """Pack a named tuple of numbers and arrays into one record, which kernels pass on faster."""
    kinds = [
        (name, value.dtype, value.shape) if isinstance(value, np.ndarray) else (name, type(value))
        for name, value in zip(numbers._fields, numbers, strict=True)
    ]
    return np.array([tuple(numbers)], dtype=kinds)[0]


class PlantSimulation:
    """The states, the clock and the input history of a plant with one input.

    Args:
        values: Parameters of the plant.
        kernel: The rig's :func:`run`.
        numbers: Argument of the rig's applied force.
        body: The moving part.
        stamps: Times of the samples.
        is_held: Whether the input is held from sample to sample; else it is linear between them.
        position: First position; the part starts at rest, after a long time at input 0.
        plant_states: First values of the rig's own states.
    """

    def __init__(
        self,
        values: Mapping[str, float],
        kernel: Kernel,
        numbers: Any,
        body: Body,
        sample_times: SampleTimes,
        is_held: bool = True,
        position: float = 0.0,
        plant_states: Sequence[float] = (),
    ) -> None:
        self.path = InputPath.of(values)
        if self.path.delay > MAX_DELAY_SAMPLES * sample_times.period:
            raise UsageError(f"time_delay.delay is too long for a sample period of {sample_times.period:g} s")
        self._kernel, self._numbers, self._body = kernel, pack(numbers), pack(body)
        friction = Friction.of(values)
        self._friction, self._way = pack(friction), pack(self.path)
        self.sample_times, self._is_held = sample_times, is_held
        n_states = PLANT_STATES + len(plant_states)
        n = n_states + (N_ELEMENT_STATES if friction.attraction > 0.0 else 0)
        self._state = np.zeros(n)
        self._state[X], self._state[PLANT_STATES:n_states] = position, plant_states
        self._state[SENSOR] = self._state[body.measured_state]
        self._mode = np.array([0.0, INITIAL_STEP * sample_times.period])
        self._clock, self._memory = np.zeros(1), np.zeros(2)
        self._times, self._values = np.zeros(HISTORY), np.zeros(HISTORY)
        self._counters = np.zeros(2, dtype=np.int64)
        self._work = Workspace(np.zeros((STAGES, n)), np.zeros(n), np.full(n, MIN_STATE_SIZE))
        self._row = np.append(self._state, 0.0)

    @property
    def tolerance(self) -> float:
        """Tolerated error of a step, relative to the size of the state."""
        return float(self._body["tolerance"])

    @tolerance.setter
    def tolerance(self, value: float) -> None:
        self._body["tolerance"] = value

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return float(self._clock[0])

    @property
    def row(self) -> FloatArray:
        """The present states and acting input, (states + 1,)."""
        return self._row

    def step(self, value: float) -> FloatArray:
        """Simulate one sample period; return the states and the acting input at its end, (1, states + 1)."""
        return self.advance(np.array([value]))[0]

    def advance(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Simulate a sample period for each of the input's values (n,).

        Returns:
            The states and the acting input at the ends (n, states + 1), and the ends (n,), s.
        """
        return self._run(values)

    def simulate(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Simulate with the input's values (n,) at the samples, the first of which is now.

        Returns:
            The states and the acting input at the samples (n, states + 1), and their times (n,), s from now.

        Raises:
            UsageError: A value is not finite, or the states of the plant become infinite.
        """
        if not len(values) or not np.all(np.isfinite(values)):
            raise UsageError("a simulation needs one finite value of its input at least, and no others")
        start, first = self.time, self._row
        if not self._is_held:
            self._restart_input(float(values[0]))
        rows, ends = self._run(values[:-1] if self._is_held else values[1:])
        return np.vstack([first, rows]), np.append(start, ends) - start

    def _run(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        ends = self.sample_times.ends(self.time, len(values))
        rows = np.empty((len(values), len(self._row)))
        self._kernel(
            values, ends, self._clock, self._times, self._values, self._counters, self._memory, self._is_held,
            self._state, self._mode, self._body, self._numbers,
            self._friction, self._way, self._work, rows,
        )  # fmt: skip
        if len(rows):
            self._row = rows[-1].copy()
        if not np.isfinite(self._row.sum()):
            raise UsageError("the plant runs away with these parameters: its states are no finite numbers")
        return rows, ends

    def _restart_input(self, value: float) -> None:
        """Let a linear input jump to its first value."""
        if value != self._values[self._counters[NEWEST] % HISTORY]:
            add_command(self._times, self._values, self._counters, self.time, value)
