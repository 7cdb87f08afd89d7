"""Call a simulator at a few states before it is used, and report what was expected and found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from labhil.errors import UsageError
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.simulators.simulator import Simulator

PROBED_STATES = (0.0, 0.1, -0.2)
"""Positions and velocities at which f is called, in their own units."""

PROBED_INPUT = 0.5


class Tolerances(NamedTuple):
    """Accuracy of the rates of a simulator.

    Attributes:
        rate: Error of the position's rate, relative to the velocity.
        acceleration: Change of the acceleration by rounding, relative to the acceleration.
    """

    rate: float
    acceleration: float


EXACT = Tolerances(1e-9, 0.0)
"""Rates that f returns."""

FROM_STEPS = Tolerances(1e-3, 1e-6)
"""Rates from short steps."""

FROM_SOLVER = Tolerances(1e-2, 1e-3)
"""Rates from short runs of a solver with steps of its own, often Euler's."""


def probe(simulator: Simulator, tolerances: Tolerances = EXACT) -> None:
    """Check that f gives repeatable rates of a position and its velocity that do not depend on time.

    Args:
        simulator: The simulator.
        tolerances: Accuracy of its rates.

    Raises:
        UsageError: What was expected of f, and what was found.
    """
    values = start_numbers(simulator)
    for x in PROBED_STATES:
        for v in PROBED_STATES:
            rates = _rates(simulator, 0.0, (x, v), values)
            again = _rates(simulator, 0.0, (x, v), values)
            if rates != again:
                _refuse(simulator, f"the same rates for the same state, found {rates} and then {again}")
            if _rates(simulator, 7.0, (x, v), values) != rates:
                _refuse(simulator, "rates that do not depend on t (give such a course as an input)")
            if abs(rates[0] - v) > tolerances.rate * max(abs(v), 1.0):
                position, velocity = simulator.states
                _refuse(simulator, f"the rate of {position} to be {velocity} = {v:g}, found {rates[0]:g}")


def probe_once(simulator: Simulator) -> None:
    """Call f once; UsageError where it cannot be called, or does not return rates."""
    _rates(simulator, 0.0, (PROBED_STATES[1], PROBED_STATES[2]), start_numbers(simulator))


def is_damped(simulator: Simulator, tolerances: Tolerances = EXACT) -> bool:
    """Whether the acceleration of a simulator depends on the velocity at any probed position."""
    values = start_numbers(simulator)
    accelerations = np.array(
        [[_rates(simulator, 0.0, (x, v), values)[1] for v in PROBED_STATES] for x in PROBED_STATES]
    )
    size = np.max(np.abs(accelerations), initial=0.0)
    return bool(np.any(np.ptp(accelerations, axis=1) > tolerances.acceleration * size))


def start_numbers(simulator: Simulator) -> list[float]:
    """Return the starts of all parameters; a single 0 where there are none."""
    return [quantity.start for quantity in simulator.parameters.values()] or [0.0]


def find_dead_parameters(
    simulate: Callable[[FloatArray], FloatArray],
    theta: FloatArray,
    names: Sequence[str],
    *,
    step: float = 1e-3,
    max_change: float = 1e-12,
) -> tuple[str, ...]:
    """Find parameters that change nothing in the simulated outputs.

    Args:
        simulate: Parameter values to outputs.
        theta: Parameter values, those of the named parameters first.
        names: Names of the parameters.
        step: Change of a parameter, relative to its value.
        max_change: Change of the outputs that counts as none, relative to their size.

    Returns:
        Their names.
    """
    outputs = simulate(theta)
    size = float(np.nanmax(np.abs(outputs), initial=0.0)) or 1.0
    dead = []
    for i, name in enumerate(names):
        moved = theta.copy()
        moved[i] += step * (abs(theta[i]) or 1.0)
        if float(np.nanmax(np.abs(simulate(moved) - outputs), initial=0.0)) <= max_change * size:
            dead.append(name)
    return tuple(dead)


def _rates(
    simulator: Simulator, t: float, state: tuple[float, float], values: list[float]
) -> tuple[float, float]:
    states, inputs, parameters = simulator.records
    where = f"at x = {state}, u = {PROBED_INPUT:g}"
    try:
        rates = np.asarray(
            simulator.f(t, states(*state), inputs(PROBED_INPUT), parameters(*values)), dtype=np.float64
        )
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


def _refuse(simulator: Simulator, expected: str) -> None:
    raise UsageError(f"simulator {simulator.name!r}: expected {expected}")
