"""Compile a user's right-hand side together with the forces of the catalogue (see ``physics.at_port``)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numba
import numpy as np

from labhil.compiled import specialised
from labhil.errors import UsageError
from labhil.physics.at_port import compile_laws_at_port
from labhil.physics.extra_force import with_extra_force
from labhil.physics.moving_part import Motion, Stops
from labhil.physics.stick_slip import compile_integrator
from labhil.signals import FloatArray, IntArray
from labhil.simulators.probing import start_numbers

if TYPE_CHECKING:
    from labhil.simulators.simulator import Simulator


class Kernels(NamedTuple):
    """The compiled functions of one simulator.

    Attributes:
        acceleration: (x, v, u, p) to the acceleration of the simulator alone.
        pull: Positions, velocities, inputs (n,) and part to accelerations with all forces, (n,).
        run: Simulates windows (see ``stick_slip.Run``).
        run_pushed: The same under an additional force.
    """

    acceleration: Callable[[float, float, float, Any], float]
    pull: Callable[..., FloatArray]
    run: Callable[..., None]
    run_pushed: Callable[..., None]


def compile_acceleration(simulator: Simulator) -> Callable[[float, float, float, Any], float]:
    """Compile the acceleration of a simulator.

    Args:
        simulator: The simulator; its ``f`` gives the rates of both states.

    Returns:
        (x, v, u, p) to the acceleration.

    Raises:
        UsageError: numba cannot compile ``f``, with its message.
    """
    njit: Any = numba.njit
    f = njit(simulator.f, error_model="numpy", nogil=True)
    states, inputs, parameters = simulator.records

    @specialised
    def acceleration(x: float, v: float, u: float, p: Any) -> float:
        return float(f(0.0, states(x, v), inputs(u), p)[1])

    values = start_numbers(simulator)
    try:
        _callable_from_python(acceleration)(0.0, 0.0, 0.0, parameters(*values))
    except numba.core.errors.NumbaError as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        raise UsageError(
            f"simulator {simulator.name!r}: expected a function that numba compiles (numbers, math, numpy; "
            f"no files, no objects of your own), found: {'; '.join(lines[:3])[:400]}"
        ) from error
    return acceleration


def _callable_from_python(function: Callable[..., float]) -> Callable[..., float]:
    """Wrap a specialised function so that Python can call it."""
    njit: Any = numba.njit

    @njit(error_model="numpy")  # type: ignore[untyped-decorator]
    def call(x: float, v: float, u: float, p: Any) -> float:
        return function(x, v, u, p)

    compiled: Callable[..., float] = call
    return compiled


def compile_kernels(simulator: Simulator) -> Kernels:
    """Compile the simulation of a simulator with all forces of the catalogue at its coordinate."""
    acceleration = compile_acceleration(simulator)
    laws = compile_laws_at_port(acceleration)
    njit: Any = numba.njit
    run, pushed, pull = (
        compile_integrator(laws),
        compile_integrator(with_extra_force(laws)),
        laws.acceleration,
    )

    @njit(error_model="numpy", nogil=True)  # type: ignore[untyped-decorator]
    def simulate(
        t: FloatArray, node_t: FloatArray, values: FloatArray, first: IntArray, last: IntArray,
        states: FloatArray, stops: Stops, part: Any, course: Any, out: FloatArray,
    ) -> None:  # fmt: skip
        run(t, node_t, values, first, last, states, stops, part, course, out)

    @njit(error_model="numpy", nogil=True)  # type: ignore[untyped-decorator]
    def simulate_pushed(
        t: FloatArray, node_t: FloatArray, values: FloatArray, first: IntArray, last: IntArray,
        states: FloatArray, stops: Stops, part: Any, course: Any, out: FloatArray,
    ) -> None:  # fmt: skip
        pushed(t, node_t, values, first, last, states, stops, part, course, out)

    @njit(error_model="numpy", nogil=True)  # type: ignore[untyped-decorator]
    def pull_all(x: FloatArray, v: FloatArray, bend: FloatArray, u: FloatArray, part: Any) -> FloatArray:
        accelerations = np.zeros(x.size)
        for k in range(x.size):
            if v[k] != 0.0:
                accelerations[k] = pull(Motion(x[k], v[k], 0.0, bend[k]), np.sign(v[k]), u[k], part)
        return accelerations

    return Kernels(_callable_from_python(acceleration), pull_all, simulate, simulate_pushed)
