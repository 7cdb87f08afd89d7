"""Compare a recorded output with a column of simulated values, for simulators that cannot be called.

Inputs and states of the simulator are not known. The effects between the simulated column x and the measured
y are those of an output (delay, lag, backlash, limits, gain, offset, nonlinearity). The residuals are located
over the simulated value, its rate and further recorded columns; the column does not determine forces.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from labhil.errors import UsageError
from labhil.kinds import RigKind, declare_kind
from labhil.physics.driven import SENSOR_LAG, InputPath
from labhil.physics.extra_force import CurveArgument, ExtraForce, MovedPart, along_positive
from labhil.physics.friction_terms import friction_terms
from labhil.physics.model import Metric
from labhil.physics.path_terms import input_terms, offset_term, output_terms
from labhil.physics.record import Record, Windows
from labhil.physics.rigs import RigModel, declare_model
from labhil.physics.terms import CharacteristicScale, Enters, Parameter, Term
from labhil.physics.values import Values
from labhil.rig import RigFile, parse_rig
from labhil.signals import Direction, FloatArray, Hold, Signal
from labhil.simulators.names import NO_PORT
from labhil.toml_text import to_toml

DEFAULT_HORIZON = 1.0
"""Length of the scored windows without one in the rig file, s."""

CLOCK_RANGE = (-1.0, 1.0)
"""Bounds of the offset between the two clocks, s."""

EQUIVALENT_TERMS = {
    "time_delay": "it is the same as clock_offset, which may be negative as well",
    "actuator_lag": "it is the same as sensor_lag",
}
"""Input effects that are equivalent to output effects, with the reason."""


@dataclass(frozen=True)
class SimulatedOutput:
    """A column of simulated outputs; :func:`simulated_output` makes it.

    Attributes:
        output: Name of the measured signal.
        unit: Unit of both.
        beside: Units of further recorded signals by name.
        horizon: Length of the scored windows, s.

    Example:
        >>> import labhil as lh
        >>> rig = lh.simulated_output("ball_position", "m", beside={"servo_angle": "rad"})
        >>> rig.column
        'simulated_ball_position'
    """

    output: str
    unit: str
    beside: Mapping[str, str] = field(default_factory=dict)
    horizon: float | None = None

    @property
    def column(self) -> str:
        """Name of the channel with the simulated values."""
        return f"simulated_{self.output}"

    @property
    def kind(self) -> RigKind:
        """The rig kind: the simulated column is the input, the measured one the output."""
        simulated = Signal(
            self.column, self.unit, Direction.INPUT, hold=Hold.LINEAR, description="of your simulation"
        )
        measured = Signal(self.output, self.unit, Direction.OUTPUT, description="measured")
        beside = tuple(
            Signal(name, unit, Direction.STATUS, description="recorded beside it")
            for name, unit in self.beside.items()
        )
        return RigKind(self.column, (simulated,), ((self.column,),), (measured,), {}, beside)

    @property
    def rig_file(self) -> RigFile:
        """A rig file with this description; recordings contain it."""
        sections = column_sections({self.output: self.unit}, self.beside, self.horizon)
        return parse_rig(to_toml(sections), Path(f"{self.column}.toml"))


def column_sections(
    outputs: Mapping[str, str], beside: Mapping[str, str], horizon: float | None
) -> dict[str, Any]:
    """Return the tables of a rig file that describe columns of simulated outputs."""
    sections: dict[str, Any] = {"model": {"simulated": dict(outputs)}}
    if beside:
        sections["model"]["beside"] = dict(beside)
    if horizon is not None:
        sections["metric"] = {"horizon": horizon}
    return sections


def check_column_names(outputs: Iterable[str], beside: Iterable[str]) -> None:
    """Check the names of outputs, of their simulated columns and of what is recorded beside them.

    Raises:
        UsageError: There is no output, a name is not an identifier, or one occurs twice.
    """
    names = [*outputs, *(f"simulated_{name}" for name in outputs), *beside]
    invalid = [name for name in names if not name.isidentifier()]
    if not names or invalid or len(set(names)) < len(names):
        raise UsageError(
            "simulated output: expected names of letters, digits and _, each once, found "
            f"{', '.join(names) or 'none'}"
        )


def simulated_output(
    output: str, unit: str, *, beside: Mapping[str, str] | None = None, horizon: float | None = None
) -> SimulatedOutput:
    """Describe a column of simulated outputs that is compared with a measured one.

    For a simulation that cannot be called: its results are exported at the times of the measurement. ``fit``
    and ``diagnose`` then estimate delay, gain, nonlinearity and lag between the two, and locate the residuals
    over a recorded quantity.

    Args:
        output: Name of the measured signal; the simulated one is ``simulated_`` and this name.
        unit: The unit of both.
        beside: Units of further recorded signals, by name, over which residuals may be located.
        horizon: Length of the scored windows, s; 1 when absent.

    Returns:
        The rig, to be given to :func:`labhil.recording`, :func:`labhil.fit` and :func:`labhil.diagnose`.

    Raises:
        UsageError: A name is not an identifier, or occurs twice.

    Example:
        >>> import labhil as lh, numpy as np
        >>> t = np.arange(0.0, 20.0, 0.01)
        >>> simulated = np.sin(2.0 * t) + 0.3 * np.sin(7.0 * t)
        >>> measured = np.interp(t - 0.03, t, simulated) + np.random.default_rng(1).normal(0.0, 0.002, len(t))
        >>> rig = lh.simulated_output("angle", "rad")
        >>> rec = lh.recording(t, {"simulated_angle": simulated}, {"angle": measured}, rig=rig)
        >>> fit = lh.fit(rec, terms=["clock_offset"], holdout=0.0)
        >>> round(fit.parameters["clock_offset.offset"].value, 3)
        0.03
    """
    simulated = SimulatedOutput(output, unit, dict(beside or {}), horizon)
    check_column_names([output], simulated.beside)
    declare_kind(simulated.kind)
    declare_model(
        simulated.column, RigModel(lambda rig, record: SimulatedOutputModel(simulated, rig, record), (), ())
    )
    return simulated


class WithoutStates:
    """What models between recorded columns share: no states, and records as they are."""

    metric = Metric.WINDOWED_SIMULATION
    fading_memory = True
    state_names: tuple[str, ...] = ()
    state_scale = np.empty(0)
    horizon: float

    def horizon_at(self, theta: FloatArray) -> float:
        """Return the scored horizon, s."""
        return self.horizon

    def prepare(self, record: Record) -> Record:
        """Return the record as it is."""
        return record

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Return no states, (w, 0)."""
        return np.empty((len(windows), 0))


class SimulatedOutputModel(WithoutStates):
    """The output effects between a simulated column and the measured one (a ``physics.model.Model``)."""

    _extra: ExtraForce | None = None

    def __init__(
        self, simulated: SimulatedOutput, rig: RigFile, record: Record | None = None, column: int = 0
    ) -> None:
        self._column = column
        self.simulated, self.kind = simulated, simulated.column
        self.fixed: dict[str, float] = {}
        self.force_unit = simulated.unit
        friction = [term.name for term in friction_terms("N", "m", 1.0, 1.0)]
        forces = dict.fromkeys((*friction, "constant_force", "spring_force"), NO_PORT)
        self.unobservable_terms: Mapping[str, str] = {**EQUIVALENT_TERMS, **forces}
        self.rate = f"{simulated.column}_rate"
        x = np.array([1.0, -1.0]) if record is None else record.inputs[:, column]
        self.terms: Mapping[str, Term] = _catalogue(simulated, float(np.ptp(x)) or 1.0)
        self.parameters = tuple(p for term in self.terms.values() for p in term.parameters)
        self.horizon = rig.metric.horizon or DEFAULT_HORIZON
        if record is not None:
            self.horizon = min(self.horizon, record.max_horizon)
        self.coordinate_units: Mapping[str, str] = {
            simulated.column: simulated.unit,
            self.rate: f"{simulated.unit}/s",
            **simulated.beside,
        }
        self.moved = (MovedPart(simulated.column, self.rate, enters=Enters.DIFFERENCE),)
        self._values, self._path = Values(self.fixed, self.parameters), InputPath()

    def with_force(self, force: ExtraForce) -> SimulatedOutputModel:
        """Return this model with an additional difference of the output, a curve or a course in time."""
        forced = copy.copy(self)
        forced._extra = force
        return forced

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Return the outputs with all effects, (N, 1)."""
        x = self.after_input_path(theta, record, windows)
        y = self._values.apply_sensor(theta, record, windows, x)
        return (y + self._difference(record)[windows.rows])[:, None]

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Return the simulated value, its rate and the further recorded signals, (N,) each."""
        coordinates = self.along(record, windows)
        return {**coordinates, **self.drive_coordinates(theta, record, windows, coordinates)}

    def along(self, record: Record, windows: Windows) -> dict[str, FloatArray]:
        """Return the coordinates that no effect changes, (N,) each."""
        return {
            self.simulated.column: record.inputs[windows.rows, self._column],
            self.rate: self._rate_of_change(record)[windows.rows],
            **{
                name: record.auxiliary[name][windows.rows]
                for name in self.simulated.beside
                if name in record.auxiliary
            },
        }

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, coordinates: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Return the simulated value after delay, backlash and limits, (N,)."""
        return {"passed_on": self.after_input_path(theta, record, windows)}

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Return the output at these coordinates, with the lag to first order, (N,)."""
        x = coordinates["passed_on"]
        cubic, gain = (self._values.of(theta, n) for n in ("sensor_nonlinearity.cubic", "sensor_gain.gain"))
        lag = self._values.of(theta, SENSOR_LAG) * coordinates[self.rate]
        offset = self._values.of(theta, "sensor_offset.offset")
        return np.asarray((1.0 + gain) * (x + cubic * x**3) + offset - lag)

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Return the sizes of which starts are fractions, from this recording."""
        x, rate = record.inputs[:, self._column], self._rate_of_change(record)
        return {
            CharacteristicScale.UNIT: 1.0,
            CharacteristicScale.INPUT: float(np.abs(x).max()) or 1.0,
            CharacteristicScale.INPUT_RATE: float(np.quantile(np.abs(rate), 0.98)) or 1.0,
            CharacteristicScale.DRIVE: float(np.std(x)) or 1.0,
            CharacteristicScale.SPEED: float(np.sqrt(np.mean(rate**2))) or 1.0,
        }

    def after_input_path(self, theta: FloatArray, record: Record, windows: Windows) -> FloatArray:
        """Return the simulated value after backlash.

        Limits and clock offset at the samples of windows, (N,).
        """
        nodes, values = self._path.nodes(record, self._column, lambda name: self._values.of(theta, name))
        shift = self._values.of(theta, "clock_offset.offset")
        return np.interp(record.t[windows.rows] - shift, nodes, values)

    def _difference(self, record: Record) -> FloatArray:
        """Return the additional difference of the output, (n,)."""
        force = self._extra
        if force is None:
            return np.zeros(len(record))
        if force.course is not None:
            return force.course
        x, rate = record.inputs[:, self._column], self._rate_of_change(record)
        is_of_rate = force.acts in (CurveArgument.VELOCITY, CurveArgument.SPEED_AGAINST)
        argument = rate if is_of_rate else x
        argument = np.abs(argument) if force.acts is CurveArgument.SPEED_AGAINST else argument
        curve = np.interp(argument, force.grid, force.values)
        return along_positive(force.acts, curve, rate, np.sign(rate))

    def _rate_of_change(self, record: Record) -> FloatArray:
        """Rate of change of the simulated value, (n,)."""
        return np.concatenate(
            [np.gradient(part.inputs[:, self._column], part.t) for part in record.recordings()]
        )


def _catalogue(simulated: SimulatedOutput, span: float) -> dict[str, Term]:
    """Build all terms, with scales from the range of the simulated values."""
    unit, channel = simulated.unit, simulated.output
    clock_offset = Term(
        "clock_offset",
        Enters.DIFFERENCE,
        f"that {channel} is measured later than it is simulated (earlier, where negative)",
        "y(t) = x(t − T_d)",
        "two clocks, or a delay that the simulation lacks",
        "fast motion and reversals",
        (Parameter("clock_offset.offset", "s", 0.05, *CLOCK_RANGE, starts=(0.02, -0.02), step=0.04),),
    )
    terms = [term for term in input_terms(unit) if term.name not in EQUIVALENT_TERMS]
    terms += [clock_offset, *output_terms(channel, unit, span), offset_term(channel, unit, 0.1 * span)]
    return {term.key: replace(term, enters=Enters.DIFFERENCE) for term in terms}
