"""A user's right-hand side compiled together with the catalogue's forces (see ``physics.at_port``)."""

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

if TYPE_CHECKING:
    from labhil.simulators.simulator import Simulator


class Kernels(NamedTuple):
    """The compiled functions of one simulator.

    ``acceleration(x, v, u, p)`` gives f's own; ``run`` and ``run_pushed`` simulate (see ``stick_slip.Run``).
    """

    acceleration: Callable[[float, float, float, Any], float]
    pull: Callable[..., FloatArray]
    run: Callable[..., None]
    run_pushed: Callable[..., None]


def acceleration_of(simulator: Simulator) -> Callable[[float, float, float, Any], float]:
    """Compile f; UsageError with what numba says where it cannot."""
    njit: Any = numba.njit
    f = njit(simulator.f, error_model="numpy", nogil=True)
    states, inputs, parameters = simulator.records

    @specialised
    def acceleration(x: float, v: float, u: float, p: Any) -> float:
        return float(f(0.0, states(x, v), inputs(u), p)[1])

    values = [quantity.start for quantity in simulator.parameters.values()] or [0.0]
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
    """A specialised function as Python can call it."""
    njit: Any = numba.njit

    @njit(error_model="numpy")  # type: ignore[untyped-decorator]
    def call(x: float, v: float, u: float, p: Any) -> float:
        return function(x, v, u, p)

    compiled: Callable[..., float] = call
    return compiled


def kernels_of(simulator: Simulator) -> Kernels:
    """Compile the simulation of a simulator with all laws at its ports."""
    acceleration = acceleration_of(simulator)
    laws = compile_laws_at_port(acceleration)
    njit: Any = numba.njit
    run, pushed, pull = (
        compile_integrator(laws),
        compile_integrator(with_extra_force(laws)),
        laws.acceleration,
    )

    @njit(error_model="numpy", nogil=True)  # type: ignore[untyped-decorator]
    def outer(
        t: FloatArray, node_t: FloatArray, values: FloatArray, first: IntArray, last: IntArray,
        states: FloatArray, stops: Stops, part: Any, course: Any, out: FloatArray,
    ) -> None:  # fmt: skip
        run(t, node_t, values, first, last, states, stops, part, course, out)

    @njit(error_model="numpy", nogil=True)  # type: ignore[untyped-decorator]
    def outer_pushed(
        t: FloatArray, node_t: FloatArray, values: FloatArray, first: IntArray, last: IntArray,
        states: FloatArray, stops: Stops, part: Any, course: Any, out: FloatArray,
    ) -> None:  # fmt: skip
        pushed(t, node_t, values, first, last, states, stops, part, course, out)

    @njit(error_model="numpy", nogil=True)  # type: ignore[untyped-decorator]
    def pulls(x: FloatArray, v: FloatArray, u: FloatArray, part: Any) -> FloatArray:
        forces = np.zeros(x.size)
        for k in range(x.size):
            if v[k] != 0.0:
                forces[k] = pull(Motion(x[k], v[k], 0.0), np.sign(v[k]), u[k], part)
        return forces

    return Kernels(_callable_from_python(acceleration), pulls, outer, outer_pushed)
