"""A simulator is probed before it is used: what breaks is named with what was expected."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from labhil.errors import UsageError
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.simulators.simulator import Simulator

POINTS = (0.0, 0.1, -0.2)
"""States at which f is called, of each in turn, in their own units."""

SAME, SAME_OF_STEPS, SAME_OF_SOLVERS = 1e-9, 1e-3, 1e-2
"""Share by which a rate may be missed: as it is given, from a step, and from what a solver inside makes."""

ROUNDED = 1e-6
"""Share of an acceleration by which that of a step function may change through rounding."""

SOLVED = 1e-3
"""The same where a solver inside makes steps of its own, many of them Euler's."""

MOVED = 1e-3
"""Share of itself by which a parameter is moved to see whether anything changes."""

NOTHING = 1e-12
"""Change of the outputs, as a share of their size, that counts as none."""


def probe(simulator: Simulator, same: float = SAME) -> None:
    """Call f at a few states; UsageError with what was expected of it and what was found."""
    values = [quantity.start for quantity in simulator.parameters.values()] or [0.0]
    for x in POINTS:
        for v in POINTS:
            state, u = (x, v), 0.5
            first = _rates(simulator, 0.0, state, u, values)
            again = _rates(simulator, 0.0, state, u, values)
            if first != again:
                _refuse(simulator, f"the same rates for the same state, found {first} and then {again}")
            if _rates(simulator, 7.0, state, u, values) != first:
                _refuse(simulator, "rates that do not depend on t (give such a course as an input)")
            if abs(first[0] - v) > same * max(abs(v), 1.0):
                position, velocity = simulator.states
                _refuse(simulator, f"the rate of {position} to be {velocity} = {v:g}, found {first[0]:g}")


def probe_once(simulator: Simulator) -> None:
    """Call f once; UsageError where it cannot be called, or gives something else than rates."""
    values = [quantity.start for quantity in simulator.parameters.values()] or [0.0]
    _rates(simulator, 0.0, (POINTS[1], POINTS[2]), 0.5, values)


def is_damped(simulator: Simulator, same: float = 0.0) -> bool:
    """Whether its acceleration changes with the velocity anywhere, by more than a share ``same`` of it."""
    values = [quantity.start for quantity in simulator.parameters.values()] or [0.0]
    accelerations = np.array(
        [[_rates(simulator, 0.0, (x, v), 0.5, values)[1] for v in POINTS] for x in POINTS]
    )
    return bool(np.any(np.ptp(accelerations, axis=1) > same * np.max(np.abs(accelerations), initial=0.0)))


def _rates(
    simulator: Simulator, t: float, state: tuple[float, float], u: float, values: list[float]
) -> tuple[float, float]:
    states, inputs, parameters = simulator.records
    where = f"at x = {state}, u = {u:g}"
    try:
        rates = np.asarray(simulator.f(t, states(*state), inputs(u), parameters(*values)), dtype=np.float64)
    except UsageError:
        raise
    except Exception as error:
        raise UsageError(
            f"simulator {simulator.name!r}: expected rates {where}, found {type(error).__name__}: {error}"
        ) from error
    if rates.shape != (2,):
        _refuse(simulator, f"2 rates, one for each state, found an array of shape {rates.shape}")
    if not np.isfinite(rates).all():
        _refuse(simulator, f"finite rates {where}, found {rates.tolist()}")
    return float(rates[0]), float(rates[1])


def _refuse(simulator: Simulator, what: str) -> None:
    raise UsageError(f"simulator {simulator.name!r}: expected {what}")


def dead_parameters(
    simulate: Callable[[FloatArray], FloatArray], theta: FloatArray, names: list[str]
) -> tuple[str, ...]:
    """Names of the parameters (first in ``theta``) that change nothing in what is simulated when moved."""
    base = simulate(theta)
    size = float(np.nanmax(np.abs(base), initial=0.0)) or 1.0
    dead = []
    for i, name in enumerate(names):
        moved = theta.copy()
        moved[i] += MOVED * (abs(theta[i]) or 1.0)
        if float(np.nanmax(np.abs(simulate(moved) - base), initial=0.0)) <= NOTHING * size:
            dead.append(name)
    return tuple(dead)
