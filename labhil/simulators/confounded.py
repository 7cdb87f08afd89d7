"""Find effects and parameters that a recording cannot distinguish, by the rank of the sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labhil.physics.model import index_of, start_values
from labhil.physics.record import Record, Windows
from labhil.physics.terms import Parameter
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.simulators.model import SimulatorModel


class Sensitivities:
    """Difference quotients of the simulated outputs at the starts of all parameters.

    Args:
        model: The simulator's model.
        record: The recording.
        windows: w windows of it.
        states: Position and velocity at the start of each window, (w, 2).
        step: Step of the difference quotients, relative to the value or the scale of a parameter.
    """

    def __init__(
        self,
        model: SimulatorModel,
        record: Record,
        windows: Windows,
        states: FloatArray,
        *,
        step: float = 1e-6,
    ) -> None:
        self._model, self._record, self._windows, self._states = model, record, windows, states
        self._theta, self._index, self._step = (
            start_values(model.parameters),
            index_of(model.parameters),
            step,
        )
        self._outputs = model.simulate(self._theta, record, windows, states)

    def to_parameter(self, key: str) -> FloatArray:
        """Return the change of all outputs per unit of a parameter, (N·channels,)."""
        index, theta = self._index[key], self._theta.copy()
        scale = self._model.parameters[index].scale if theta[index] == 0.0 else abs(theta[index])
        step = self._step * scale
        theta[index] += step
        outputs = self._model.simulate(theta, self._record, self._windows, self._states)
        return np.asarray((outputs - self._outputs) / step).ravel()

    def to_states(self) -> list[FloatArray]:
        """Return the change of all outputs with the first states of each window, a column each."""
        columns, owner = [], self._windows.owner
        for k, scale in enumerate(self._model.state_scale):
            states = self._states.copy()
            states[:, k] += self._step * scale
            outputs = self._model.simulate(self._theta, self._record, self._windows, states)
            change = (outputs - self._outputs) / self._step
            columns += [
                np.where((owner == w)[:, None], change, 0.0).ravel() for w in range(len(self._windows))
            ]
        return columns


def find_confounded(
    model: SimulatorModel,
    parameters: Sequence[Parameter],
    record: Record,
    windows: Windows,
    states: FloatArray,
    *,
    min_share: float = 1e-3,
) -> dict[str, str]:
    """Find effects of one parameter that change the outputs just as the simulator's own parameters do.

    Args:
        model: The simulator's model.
        parameters: Those of the simulator itself.
        record: The recording.
        windows: w windows of it.
        states: Position and velocity at the start of each window, (w, 2).
        min_share: Share of an effect's sensitivity that the parameters and first states cannot explain, at
            least, of an effect that can be estimated.

    Returns:
        Reasons by the keys of the effects. An effect without a change at its start is not among them.
    """
    sensitivities = Sensitivities(model, record, windows, states)
    known = _normalise([sensitivities.to_parameter(p.key) for p in parameters] + sensitivities.to_states())
    reasons = {}
    for key, term in model.terms.items():
        if len(term.parameters) != 1:
            continue
        column = sensitivities.to_parameter(term.parameters[0].key)
        size = float(np.linalg.norm(column))
        if not np.isfinite(size) or size == 0.0:
            continue
        if _distance(column, known) < min_share * size:
            names = ", ".join(p.name for p in parameters)
            reasons[key] = f"it changes the outputs just as {names} of the simulator, or the first state, do"
    return reasons


def find_dependent(
    model: SimulatorModel,
    parameters: Sequence[Parameter],
    record: Record,
    windows: Windows,
    states: FloatArray,
    *,
    min_share: float = 1e-2,
) -> tuple[str, ...]:
    """Find parameters that change the outputs just as those before them do together.

    Args:
        model: The simulator's model.
        parameters: Those of the simulator itself, the preferred ones first.
        record: The recording.
        windows: w windows of it.
        states: Position and velocity at the start of each window, (w, 2).
        min_share: Share of a parameter's sensitivity that those before it cannot explain, at least, of one
            that can be estimated.

    Returns:
        Their names.
    """
    sensitivities = Sensitivities(model, record, windows, states)
    columns = sensitivities.to_states()
    names = []
    for parameter in parameters:
        column = sensitivities.to_parameter(parameter.key)
        if _distance(column, _normalise(columns)) < min_share * float(np.linalg.norm(column)):
            names.append(parameter.name)
        else:
            columns.append(column)
    return tuple(names)


def _distance(column: FloatArray, known: FloatArray) -> float:
    """Distance of a column from the space of others."""
    return float(np.linalg.norm(column - known @ np.linalg.lstsq(known, column, rcond=1e-10)[0]))


def _normalise(columns: Sequence[FloatArray]) -> FloatArray:
    sizes = [float(np.linalg.norm(column)) or 1.0 for column in columns]
    return np.column_stack([column / size for column, size in zip(columns, sizes, strict=True)])
