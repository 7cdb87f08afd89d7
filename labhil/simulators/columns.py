"""Outputs of a simulation that nobody can call: a column beside what was measured.

Neither the simulator's inputs nor its states are known, so what is compared is the output alone. Between the
simulated column x and the measured y stand the effects of a way out (delay, lag, play, limits, gain, offset,
a bent characteristic); what is left is located over the simulated value, its rate and the columns that were
recorded beside it, and a curve over one of these is its first-order account. Which force of which law made
it, the column alone cannot say.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from labhil.errors import UsageError
from labhil.kinds import RigKind, declare_kind
from labhil.physics.driven import InputPath
from labhil.physics.extra_force import CurveArgument, ExtraForce, MovedPart, along_positive
from labhil.physics.friction_terms import friction_terms
from labhil.physics.model import Metric, Record, Windows
from labhil.physics.path_terms import input_terms, offset_term, output_terms
from labhil.physics.rigs import RigModel, declare_model
from labhil.physics.terms import CharacteristicScale, Enters, Parameter, Term
from labhil.physics.values import Values
from labhil.rig import RigFile, parse_rig
from labhil.signals import Direction, FloatArray, Hold, Signal
from labhil.simulators.names import NO_PORT
from labhil.toml_text import to_toml

HORIZON = 1.0
"""Length of the windows that are scored where the rig file states none, s: there is no state to forget."""

SHIFTS = (-1.0, 1.0)
"""Of the two clocks, s."""

WITH_ANOTHER = {
    "time_delay": "it is the same as clock_offset, which may be negative as well",
    "actuator_lag": "it is the same as sensor_lag",
}
"""Ways in that a way out already says."""


@dataclass(frozen=True)
class SimulatedOutput:
    """A column of simulated output as its user describes it; made by :func:`simulated_output`.

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
        """The rig kind that it is: the simulated column drives, the measured one is compared with it."""
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
        """A rig file that says this; a recording carries it, for nothing has to be loaded for it."""
        sections: dict[str, Any] = {"model": {"simulated": {self.output: self.unit}}}
        if self.beside:
            sections["model"]["beside"] = dict(self.beside)
        if self.horizon is not None:
            sections["metric"] = {"horizon": self.horizon}
        return parse_rig(to_toml(sections), Path(f"{self.column}.toml"))


def simulated_output(
    output: str, unit: str, *, beside: Mapping[str, str] | None = None, horizon: float | None = None
) -> SimulatedOutput:
    """Describe a column of simulated output that stands beside a measured one.

    For a simulation that cannot be called from here: its results are exported, with the same times as what
    was measured. ``fit`` and ``diagnose`` then say by how much the two are shifted in time, scaled, bent or
    lagging, and over which recorded quantity the rest of the difference is.

    Args:
        output: Name of the measured signal; the simulated one is ``simulated_`` and this name.
        unit: The unit of both.
        beside: Units of other recorded signals, by name, over which a difference may be located.
        horizon: Length of the windows by which it is scored, s; 1 when absent.

    Returns:
        The rig that it is: :func:`labhil.recording`, :func:`labhil.fit` and :func:`labhil.diagnose` take it.

    Raises:
        UsageError: A name that is none, or that is given twice.

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
    made = SimulatedOutput(output, unit, dict(beside or {}), horizon)
    names = [output, made.column, *made.beside]
    wrong = [name for name in names if not name.isidentifier()]
    if wrong or len(set(names)) < len(names):
        raise UsageError(
            f"simulated output: expected names of letters, digits and _, each once, found {', '.join(names)}"
        )
    declare_kind(made.kind)
    declare_model(made.column, RigModel(lambda rig, record: SimulatedOutputModel(made, rig, record), (), ()))
    return made


class SimulatedOutputModel:
    """The way from a simulated column to the measured one (satisfies ``physics.model.Model``)."""

    metric = Metric.WINDOWED_SIMULATION
    fading_memory = True
    state_names: tuple[str, ...] = ()
    state_scale = np.empty(0)
    _extra: ExtraForce | None = None

    def __init__(self, simulated: SimulatedOutput, rig: RigFile, record: Record | None = None) -> None:
        self.simulated, self.kind = simulated, simulated.column
        self.fixed: dict[str, float] = {}
        self.force_unit = simulated.unit
        friction = [term.name for term in friction_terms("N", "m", 1.0, 1.0)]
        forces = dict.fromkeys((*friction, "constant_force", "spring_force"), NO_PORT)
        self.unobservable_terms: Mapping[str, str] = {**WITH_ANOTHER, **forces}
        self.rate = f"{simulated.column}_rate"
        x = np.array([1.0, -1.0]) if record is None else record.inputs[:, 0]
        self.terms: Mapping[str, Term] = _catalogue(simulated, float(np.ptp(x)) or 1.0)
        self.parameters = tuple(p for term in self.terms.values() for p in term.parameters)
        self.horizon = rig.metric.horizon or HORIZON
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
        """The same with one more difference, a curve or a course, in the unit of the output."""
        other = copy.copy(self)
        other._extra = force
        return other

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon, s."""
        return self.horizon

    def prepare(self, record: Record) -> Record:
        """The record itself."""
        return record

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """There are none: (w, 0)."""
        return np.empty((len(windows), 0))

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """The output as it would be measured, (N, 1)."""
        x = self._on_the_way(theta, record, windows)
        y = self._values.apply_sensor(theta, record, windows, x)
        return (y + self._difference(record)[windows.rows])[:, None]

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """The simulated value, its rate, and what was recorded beside it."""
        along = {
            self.simulated.column: record.inputs[windows.rows, 0],
            self.rate: _rate(record)[windows.rows],
            **{
                name: record.auxiliary[name][windows.rows]
                for name in self.simulated.beside
                if name in record.auxiliary
            },
        }
        return {**along, **self.drive_coordinates(theta, record, windows, along)}

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """The simulated value behind what delays and limits it."""
        return {"passed_on": self._on_the_way(theta, record, windows)}

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """The output at these coordinates, a lag to first order, (N,)."""
        x = coordinates["passed_on"]
        cubic, gain = (self._values.of(theta, n) for n in ("sensor_nonlinearity.cubic", "sensor_gain.gain"))
        lag = self._values.of(theta, "sensor_lag.time_constant") * coordinates[self.rate]
        offset = self._values.of(theta, "sensor_offset.offset")
        return np.asarray((1.0 + gain) * (x + cubic * x**3) + offset - lag)

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """What starts are fractions of, from this recording."""
        x, rate = record.inputs[:, 0], _rate(record)
        return {
            CharacteristicScale.UNIT: 1.0,
            CharacteristicScale.INPUT: float(np.abs(x).max()) or 1.0,
            CharacteristicScale.INPUT_RATE: float(np.quantile(np.abs(rate), 0.98)) or 1.0,
            CharacteristicScale.DRIVE: float(np.std(x)) or 1.0,
            CharacteristicScale.SPEED: float(np.sqrt(np.mean(rate**2))) or 1.0,
        }

    def _on_the_way(self, theta: FloatArray, record: Record, windows: Windows) -> FloatArray:
        """The simulated value at the samples of windows behind play, limits and the other clock, (N,)."""
        nodes, values = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        shift = self._values.of(theta, "clock_offset.offset")
        return np.interp(record.t[windows.rows] - shift, nodes, values)

    def _difference(self, record: Record) -> FloatArray:
        """What one more force is as a difference of the output, (n,)."""
        force = self._extra
        if force is None:
            return np.zeros(len(record))
        if force.course is not None:
            return force.course
        x, rate = record.inputs[:, 0], _rate(record)
        over_rate = force.acts in (CurveArgument.VELOCITY, CurveArgument.SPEED_AGAINST)
        places = rate if over_rate else x
        places = np.abs(places) if force.acts is CurveArgument.SPEED_AGAINST else places
        curve = np.interp(places, force.grid, force.values)
        return along_positive(force.acts, curve, rate, np.sign(rate))


def _rate(record: Record) -> FloatArray:
    """How fast the simulated value changes, (n,)."""
    return np.concatenate([np.gradient(part.inputs[:, 0], part.t) for part in record.recordings()])


def _catalogue(simulated: SimulatedOutput, span: float) -> dict[str, Term]:
    """All terms, their scales of the size that the simulation spans."""
    unit, channel = simulated.unit, simulated.output
    clocks = Term(
        "clock_offset",
        Enters.DIFFERENCE,
        f"that {channel} is measured later than it is simulated (earlier, where negative)",
        "y(t) = x(t − T_d)",
        "two clocks, or a delay that the simulation lacks",
        "fast motion and reversals",
        (Parameter("clock_offset.offset", "s", 0.05, *SHIFTS, starts=(0.02, -0.02), step=0.04),),
    )
    terms = [term for term in input_terms(unit) if term.name not in WITH_ANOTHER]
    terms += [clocks, *output_terms(channel, unit, span), offset_term(channel, unit, 0.1 * span)]
    return {term.key: replace(term, enters=Enters.DIFFERENCE) for term in terms}
