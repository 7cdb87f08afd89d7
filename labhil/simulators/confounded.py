"""Which effects a recording cannot tell from a simulator's own parameters, by the rank of sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labhil.physics.model import Record, Windows, index_of, start_values
from labhil.physics.terms import Parameter
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.simulators.model import SimulatorModel

STEP = 1e-6
APART = 1e-3
"""Share of an effect's own change of the outputs that must be no change of the parameters' and states'."""

DISTINCT = 1e-2
"""The same of a simulator's own parameter, beside those before it: a fit has to tell them apart."""


def find_confounded(
    model: SimulatorModel,
    parameters: Sequence[Parameter],
    record: Record,
    windows: Windows,
    states: FloatArray,
) -> dict[str, str]:
    """Effects of one parameter that change the outputs just as the simulator's own do, with the reason.

    An effect that changes nothing at the start is left to those who fit it.
    """
    theta, index = start_values(model.parameters), index_of(model.parameters)
    base = model.simulate(theta, record, windows, states)

    def change(key: str) -> FloatArray:
        return _change(model, theta, index[key], record, windows, states, base)

    known = _normed(
        [change(p.key) for p in parameters] + _by_states(model, theta, record, windows, states, base)
    )
    reasons = {}
    for key, term in model.terms.items():
        if len(term.parameters) != 1:
            continue
        column = change(term.parameters[0].key)
        size = float(np.linalg.norm(column))
        if not np.isfinite(size) or size == 0.0:
            continue
        residual = column - known @ np.linalg.lstsq(known, column, rcond=1e-10)[0]
        if float(np.linalg.norm(residual)) < APART * size:
            names = ", ".join(p.name for p in parameters)
            reasons[key] = f"it changes the outputs just as {names} of the simulator, or the first state, do"
    return reasons


def find_dependent(
    model: SimulatorModel,
    parameters: Sequence[Parameter],
    record: Record,
    windows: Windows,
    states: FloatArray,
) -> tuple[str, ...]:
    """Names of parameters that change the outputs just as those before them do together."""
    theta, index = start_values(model.parameters), index_of(model.parameters)
    base = model.simulate(theta, record, windows, states)
    columns = _by_states(model, theta, record, windows, states, base)
    names = []
    for parameter in parameters:
        column = _change(model, theta, index[parameter.key], record, windows, states, base)
        known, size = _normed(columns), float(np.linalg.norm(column))
        residual = column - known @ np.linalg.lstsq(known, column, rcond=1e-10)[0]
        if float(np.linalg.norm(residual)) < DISTINCT * size:
            names.append(parameter.name)
        else:
            columns.append(column)
    return tuple(names)


def _change(
    model: SimulatorModel,
    theta: FloatArray,
    place: int,
    record: Record,
    windows: Windows,
    states: FloatArray,
    base: FloatArray,
) -> FloatArray:
    """How the outputs change with a parameter, per unit of it."""
    moved = theta.copy()
    step = STEP * (model.parameters[place].scale if theta[place] == 0.0 else abs(theta[place]))
    moved[place] += step
    return np.asarray((model.simulate(moved, record, windows, states) - base) / step).ravel()


def _by_states(
    model: SimulatorModel,
    theta: FloatArray,
    record: Record,
    windows: Windows,
    states: FloatArray,
    base: FloatArray,
) -> list[FloatArray]:
    """How the first states of each window change the outputs, a column each."""
    columns = []
    for k, scale in enumerate(model.state_scale):
        moved = states.copy()
        moved[:, k] += STEP * scale
        change = (model.simulate(theta, record, windows, moved) - base) / STEP
        columns += [np.where((windows.owner == w)[:, None], change, 0.0).ravel() for w in range(len(windows))]
    return columns


def _normed(columns: Sequence[FloatArray]) -> FloatArray:
    sizes = [float(np.linalg.norm(column)) or 1.0 for column in columns]
    return np.column_stack([column / size for column, size in zip(columns, sizes, strict=True)])
