"""Compare several recorded outputs with a column of simulated values each, in one model.

Each output has effects of its own (:mod:`labhil.simulators.columns`), named after it: ``angle_sensor_gain``.
A difference that no effect explains is not estimated as a curve.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labhil.kinds import RigKind, declare_kind
from labhil.physics.record import Record, Windows
from labhil.physics.rigs import RigModel, declare_model
from labhil.physics.terms import CharacteristicScale, Parameter, Term
from labhil.rig import RigFile, parse_rig
from labhil.signals import FloatArray
from labhil.simulators.columns import (
    SimulatedOutput,
    SimulatedOutputModel,
    WithoutStates,
    check_column_names,
    column_sections,
    simulated_output,
)
from labhil.toml_text import to_toml


@dataclass(frozen=True)
class SimulatedOutputs:
    """Columns of several simulated outputs; :func:`simulated_outputs` makes it.

    Attributes:
        outputs: Units of the measured signals, and of the simulated ones, by name.
        beside: Units of further recorded signals by name.
        horizon: Length of the scored windows, s.

    Example:
        >>> import labhil as lh
        >>> rig = lh.simulated_outputs({"angle": "rad", "rate": "rad/s"})
        >>> [column.column for column in rig.columns]
        ['simulated_angle', 'simulated_rate']
    """

    outputs: Mapping[str, str]
    beside: Mapping[str, str] = field(default_factory=dict)
    horizon: float | None = None

    @property
    def columns(self) -> tuple[SimulatedOutput, ...]:
        """Each output with its column."""
        return tuple(
            SimulatedOutput(name, unit, self.beside, self.horizon) for name, unit in self.outputs.items()
        )

    @property
    def name(self) -> str:
        """Name of the rig kind."""
        return f"simulated_{'_and_'.join(self.outputs)}"

    @property
    def kind(self) -> RigKind:
        """The rig kind: the simulated columns are the inputs, the measured ones the outputs."""
        kinds = [column.kind for column in self.columns]
        inputs = tuple(signal for kind in kinds for signal in kind.inputs)
        outputs = tuple(signal for kind in kinds for signal in kind.outputs)
        return RigKind(self.name, inputs, (tuple(i.name for i in inputs),), outputs, {}, kinds[0].auxiliary)

    @property
    def rig_file(self) -> RigFile:
        """A rig file with this description; recordings contain it."""
        return parse_rig(
            to_toml(column_sections(self.outputs, self.beside, self.horizon)), Path(f"{self.name}.toml")
        )


def simulated_outputs(
    outputs: Mapping[str, str], *, beside: Mapping[str, str] | None = None, horizon: float | None = None
) -> SimulatedOutputs | SimulatedOutput:
    """Describe columns of several simulated outputs that are compared with measured ones.

    Like :func:`labhil.simulated_output`, for several outputs in one fit or diagnosis. The effects of each
    output are named after it: ``angle_sensor_gain``, ``rate_clock_offset``.

    Args:
        outputs: Units of the measured signals by name; the simulated ones are ``simulated_`` and these names.
        beside: Units of further recorded signals, by name, over which residuals may be located.
        horizon: Length of the scored windows, s; 1 when absent.

    Returns:
        The rig, to be given to :func:`labhil.recording`, :func:`labhil.fit` and :func:`labhil.diagnose`; of
        one output that of :func:`labhil.simulated_output`.

    Raises:
        UsageError: There is no output, a name is not an identifier, or one occurs twice.

    Example:
        >>> import labhil as lh
        >>> rig = lh.simulated_outputs({"angle": "rad", "rate": "rad/s"}, beside={"torque": "N·m"})
        >>> "rate_sensor_gain" in lh.model(rig).terms
        True
    """
    if len(outputs) == 1:
        ((name, unit),) = outputs.items()
        return simulated_output(name, unit, beside=beside, horizon=horizon)
    simulated = SimulatedOutputs(dict(outputs), dict(beside or {}), horizon)
    check_column_names(outputs, simulated.beside)
    declare_kind(simulated.kind)
    declare_model(
        simulated.name, RigModel(lambda rig, record: SimulatedOutputsModel(simulated, rig, record), (), ())
    )
    return simulated


class _Column(NamedTuple):
    """An output with its effects, and the place of their values in a vector theta."""

    output: str
    model: SimulatedOutputModel
    terms: tuple[Term, ...]
    place: slice


class SimulatedOutputsModel(WithoutStates):
    """The output effects between simulated and measured columns (a ``physics.model.Model``)."""

    def __init__(self, simulated: SimulatedOutputs, rig: RigFile, record: Record | None = None) -> None:
        self.simulated, self.kind = simulated, simulated.name
        self.fixed: dict[str, float] = {}
        self._columns: list[_Column] = []
        first = 0
        for k, column in enumerate(simulated.columns):
            model = SimulatedOutputModel(column, rig, record, k)
            scales = None if record is None else model.characteristic_scales(record)
            terms = tuple(_named_after(column.output, term, scales) for term in model.terms.values())
            place = slice(first, first + len(model.parameters))
            self._columns.append(_Column(column.output, model, terms, place))
            first = place.stop
        self.terms: Mapping[str, Term] = {term.key: term for c in self._columns for term in c.terms}
        self.parameters = tuple(p for term in self.terms.values() for p in term.parameters)
        models = [column.model for column in self._columns]
        self.horizon = models[0].horizon
        self.unobservable_terms: Mapping[str, str] = models[0].unobservable_terms
        self.coordinate_units: Mapping[str, str] = {
            k: v for m in models for k, v in m.coordinate_units.items()
        }

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Return the outputs with all effects, (N, outputs)."""
        return np.hstack([c.model.simulate(theta[c.place], record, windows, states) for c in self._columns])

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Return the simulated values, their rates and the further recorded signals, (N,) each."""
        along: dict[str, FloatArray] = {}
        for c in self._columns:
            along |= c.model.along(record, windows)
        return {**along, **self.drive_coordinates(theta, record, windows, along)}

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, coordinates: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Return the simulated values after delay, backlash and limits, (N,) each."""
        return {
            f"passed_on_{c.output}": c.model.after_input_path(theta[c.place], record, windows)
            for c in self._columns
        }

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Return zeros, (N,): outputs of several units have no force in common."""
        return np.zeros(len(next(iter(coordinates.values()))))

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Return ones: each term's starts are in its own unit."""
        return dict.fromkeys(CharacteristicScale, 1.0)


def _named_after(output: str, term: Term, scales: Mapping[CharacteristicScale, float] | None) -> Term:
    """Return a term with the name of its output, and with starts in the units of its parameters."""
    parameters = tuple(_in_units(f"{output}_{p.name}", p, scales) for p in term.parameters)
    return replace(
        term,
        name=f"{output}_{term.name}",
        statement=_statement(output, term.statement),
        parameters=parameters,
    )


def _in_units(
    name: str, parameter: Parameter, scales: Mapping[CharacteristicScale, float] | None
) -> Parameter:
    scale = 1.0 if scales is None else scales[parameter.of] ** parameter.power
    starts = tuple(scale * start for start in parameter.starts)
    return replace(parameter, name=name, starts=starts, of=CharacteristicScale.UNIT, power=1)


def _statement(output: str, statement: str) -> str:
    """Return the words of an effect, with its output where they do not have it."""
    return statement if output in statement.split() else f"{statement}, between the two columns of {output}"
