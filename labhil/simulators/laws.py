"""A user's right-hand side compiled together with the catalogue's forces, at the port of its coordinate.

v̇ = share·f(x, v, u) + (F₀ − k·x − k₃·x³ − cogging − friction)/M: rest is an event (``physics.stick_slip``),
so dry friction at the coordinate is solved and not smoothed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numba
import numpy as np

from labhil.compiled import specialised
from labhil.errors import UsageError
from labhil.physics import friction, sliding
from labhil.physics.extra_force import with_extra
from labhil.physics.friction import Law
from labhil.physics.moving_part import TINY, Follows, Laws, Motion, Stops
from labhil.physics.stick_slip import integrator
from labhil.signals import FloatArray, IntArray

if TYPE_CHECKING:
    from labhil.simulators.simulator import Simulator


class Pushes(NamedTuple):
    """Everything over the inertia M: added forces, friction, and the share that f keeps of its own.

    ``load`` turns the size of the input into the load on what rubs. ``stiff`` and ``quick`` are bounds of
    what f changes with position (1/s²) and velocity (1/s).
    """

    extra: sliding.Part
    law: Law
    share: float
    load: float
    stiff: float
    quick: float


class Course(NamedTuple):
    """Nothing changes along a recording."""

    nothing: float


class Kernels(NamedTuple):
    """The compiled functions of one simulator.

    ``acceleration(x, v, u, p)`` gives f's own; ``run`` and ``run_pushed`` simulate (see ``stick_slip.Run``).
    """

    acceleration: Callable[[float, float, float, Any], float]
    pull: Callable[..., float]
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
        _called(acceleration)(0.0, 0.0, 0.0, parameters(*values))
    except numba.core.errors.NumbaError as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        raise UsageError(
            f"simulator {simulator.name!r}: expected a function that numba compiles (numbers, math, numpy; "
            f"no files, no objects of your own), found: {'; '.join(lines[:3])[:400]}"
        ) from error
    return acceleration


def _called(function: Callable[..., float]) -> Callable[..., float]:
    """A specialised function as Python can call it."""
    njit: Any = numba.njit

    @njit(error_model="numpy")  # type: ignore[untyped-decorator]
    def call(x: float, v: float, u: float, p: Any) -> float:
        return function(x, v, u, p)

    found: Callable[..., float] = call
    return found


def kernels_of(simulator: Simulator) -> Kernels:
    """Compile the simulation of a simulator with all laws at its ports."""
    acceleration = acceleration_of(simulator)
    laws = _laws(acceleration)
    njit: Any = numba.njit
    run, pushed, pull = integrator(laws), integrator(with_extra(laws)), laws.pull

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
        found = np.zeros(x.size)
        for k in range(x.size):
            if v[k] != 0.0:
                found[k] = pull(Motion(x[k], v[k], 0.0), np.sign(v[k]), u[k], part)
        return found

    return Kernels(_called(acceleration), pulls, outer, outer_pushed)


def _laws(acceleration: Callable[[float, float, float, Any], float]) -> Laws[Any, Any]:
    """The physics of the coordinate; a part is (values of p, pushes)."""

    @specialised
    def free(s: Motion, u: float, part: Any) -> float:
        p, pushes = part
        return pushes.share * acceleration(s.x, s.v, u, p) + sliding.pushed(0.0, s.x, pushes.extra)

    @specialised
    def pull(s: Motion, side: float, u: float, part: Any) -> float:
        pushes = part[1]
        return free(s, u, part) - friction.friction(s.x, s.v, side, pushes.load * abs(u), pushes.law)

    @specialised
    def grip(s: Motion, u: float, part: Any) -> tuple[float, float]:
        pushes = part[1]
        return free(s, u, part), friction.hold(s.x, pushes.load * abs(u), pushes.law)

    @specialised
    def none(s: Motion, u: float, part: Any) -> float:
        return 0.0

    @specialised
    def target(s: Motion, u: float, how: Follows, part: Any) -> float:
        return 0.0

    @specialised
    def follow(s: Motion, part: Any) -> Follows:
        return Follows(0.0, 0.0, 0.0, 0.0)

    @specialised
    def longest(
        s: Motion, side: float, u: float, rise: float, since: float, how: Follows, finest: float, part: Any
    ) -> float:
        if side == 0.0:
            return np.inf
        pushes = part[1]
        extra = pushes.extra
        bend = extra.cogging_order * (abs(extra.cogging_sine) + abs(extra.cogging_cosine))
        stiff = pushes.stiff + abs(extra.spring + 3.0 * extra.hardening * s.x * s.x) + abs(bend)
        size = min(sliding.SHARE_OF_SWING / np.sqrt(stiff + TINY), friction.RESOLVED / (pushes.quick + TINY))
        size = min(size, friction.pace(s.v, pull(s, side, u, part), pushes.law))
        if bend != 0.0:
            size = min(size, friction.RESOLVED / (abs(extra.cogging_order * s.v) + TINY))
        return max(size, finest)

    @specialised
    def damped(s: Motion, side: float, part: Any) -> tuple[float, float]:
        # f's own damping is not known: it is followed by small steps and never said to creep
        return 0.0, 0.0

    @specialised
    def at(part: Any, course: Any, k: int) -> Any:
        return part

    return Laws(pull, target, follow, none, grip, longest, damped, at)
