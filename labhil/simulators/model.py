"""The model of a user's own simulator with all effects of the catalogue (a ``physics.model.Model``).

``right_hand_side`` evaluates the simulator, ``confounded`` compares sensitivities.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from labhil.errors import RecordingError
from labhil.physics import sliding
from labhil.physics.at_port import Course, Pushes
from labhil.physics.driven import InputPath
from labhil.physics.extra_force import ExtraForce, MovedPart, Pushed, PushedCourse
from labhil.physics.guesses import characteristic_scales_of
from labhil.physics.model import Metric, index_of, start_values
from labhil.physics.moving_part import Stops
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale, Parameter, Term, why_without_channels
from labhil.physics.values import Values, known_numbers
from labhil.physics.warming import RATE, TEMPERATURE, WARMS, viscous_change
from labhil.rig import RigFile
from labhil.signals import FloatArray
from labhil.simulators.agreement import disagreement_note
from labhil.simulators.catalogue import Sizes, catalogue, velocities_of
from labhil.simulators.confounded import find_confounded, find_dependent
from labhil.simulators.laws import Kernels
from labhil.simulators.probing import find_dead_parameters
from labhil.simulators.right_hand_side import LocalDynamics, RightHandSide, kernels_of
from labhil.simulators.stepped import SteppedSimulator
from labhil.simulators.tables import OperatingRange

if TYPE_CHECKING:
    from labhil.simulators.simulator import Simulator


@dataclass(frozen=True, slots=True)
class SimulatorOptions:
    """How a simulator is examined along a recording.

    Attributes:
        initial_time: Length of the straight line that gives the first state of a window, s.
        n_operating_points: Samples of the recording at which the right-hand side is linearised.
        min_horizon_samples: Shortest scored horizon in samples.
        max_deviation: Deviation of a simulator's own steps from the fitted simulation above which a note
            states it, relative to the motion.
    """

    initial_time: float = 0.05
    n_operating_points: int = 12
    min_horizon_samples: int = 40
    max_deviation: float = 0.1


OPTIONS = SimulatorOptions()


class SimulatorModel:
    """A user's simulator with the effects of the catalogue at its coordinate, input and output.

    The outputs are the measured ones of position and velocity.
    """

    metric = Metric.WINDOWED_SIMULATION
    fading_memory = False
    _extra: ExtraForce | None = None

    def __init__(
        self,
        simulator: Simulator,
        rig: RigFile,
        record: Record | None = None,
        *,
        options: SimulatorOptions = OPTIONS,
    ) -> None:
        self.simulator, self.nominal, self._options = simulator, simulator.nominal, options
        self.kind = simulator.name
        self.position, self.velocity = simulator.states
        self.state_names = (self.position, _velocity_name(self.position, self.velocity))
        self.fixed: dict[str, float] = known_numbers(rig)
        self.force_unit = simulator.force_unit
        self.coordinate_units: Mapping[str, str] = {
            **dict(zip(self.state_names, simulator.states.values(), strict=True)),
            **simulator.inputs,
        }
        self.moved = (MovedPart(*self.state_names),)
        self.columns = [list(simulator.states).index(name) for name in simulator.outputs]
        self._velocity_column = self.columns.index(1) if 1 in self.columns else None
        self._path = InputPath()
        self._right_hand_side = RightHandSide(simulator)
        self._non_smooth = self._right_hand_side.non_smooth
        parameters = tuple(q.parameter(n) for n, q in simulator.parameters.items() if n not in self.fixed)
        self._set_terms(parameters, {}, Sizes())
        self.unobservable_terms: Mapping[str, str] = {}
        self._scale_to(parameters, record)
        self.horizon = rig.metric.horizon or simulator.horizon or self.sizes.horizon
        self.notes: list[str] = []
        if record is not None:
            self._examine(parameters, record)

    def _set_terms(self, parameters: tuple[Parameter, ...], terms: Mapping[str, Term], sizes: Sizes) -> None:
        self.sizes, self.terms = sizes, terms
        self.parameters = parameters + tuple(p for term in terms.values() for p in term.parameters)
        self._values = Values(self.fixed, self.parameters)
        self.state_scale = np.array([0.02 * sizes.span, 0.1 * sizes.speed])

    def _scale_to(self, parameters: tuple[Parameter, ...], record: Record | None) -> None:
        """Choose scales and terms by a recording."""
        sizes = Sizes()
        if record is not None:
            self._set_range(record)
            dynamics = self._dynamics(start_values(parameters))
            sizes = Sizes.of(record, self._velocity_column, dynamics.inertia, dynamics.gain)
            rows = np.linspace(0, len(record) - 2, self._options.n_operating_points).astype(int)
            initial = self.initial_states(record, Windows.of([(r, min(r + 8, len(record))) for r in rows]))
            self._right_hand_side.set_operating_points(np.column_stack([initial, record.inputs[rows, 0]]))
            period = (
                2.0 * np.pi / float(np.sqrt(max(self._dynamics(start_values(parameters)).stiffness, 1e-12)))
            )
            min_horizon = self._options.min_horizon_samples * record.period
            # one period: a pendulum that passes its upper rest forgets its past within a few
            sizes = replace(sizes, horizon=max(min(sizes.horizon, period), min_horizon))
        length = self.simulator.states[self.position]
        channel, unit = next(iter(self.simulator.outputs.items()))
        drive = next(iter(self.simulator.inputs.values()))
        terms = catalogue(sizes, self.force_unit, length, self.position, drive, channel, unit)
        measured = {TEMPERATURE} if record is None else set(record.auxiliary)
        missing = self.unobservable_terms = why_without_channels(terms, measured)
        self._set_terms(parameters, {k: t for k, t in terms.items() if k not in missing}, sizes)

    def _set_range(self, record: Record) -> None:
        """Choose the range in which the simulator is evaluated by a recording."""
        positions = record.outputs[:, 0] if self.columns[0] == 0 else None
        speeds = np.concatenate(
            [velocities_of(recording, self._velocity_column) for recording in record.recordings()]
        )
        inputs, clip = record.inputs[:, 0], self._non_smooth.clip
        self._right_hand_side.set_range(
            OperatingRange.along(positions, speeds, inputs, record.max_horizon, clip)
        )

    def _examine(self, parameters: tuple[Parameter, ...], record: Record) -> None:
        """Fix parameters that have no effect of their own, and exclude effects that cannot be observed."""
        windows = _short_windows(record, self.horizon)
        states, theta = self.initial_states(record, windows), start_values(self.parameters)

        def simulate(values: FloatArray) -> FloatArray:
            return self.simulate(values, record, windows, states)

        if not np.isfinite(simulate(theta)).all():
            raise RecordingError(
                f"simulator {self.kind!r}: expected finite outputs along the recording at the starts of its "
                "parameters, found some that are none; give starts that are nearer, or bounds"
            )
        dead = find_dead_parameters(simulate, theta, [p.name for p in parameters])
        self.notes = [*self.simulator.notes]
        self.notes += [_dead_note(name, self.simulator, self.kind) for name in dead]
        if self.sizes.measured is not None:
            names = record.output_names[0], record.input_names[0], self.kind
            gain = self._dynamics(start_values(parameters)).gain
            note = disagreement_note(self.sizes.measured, gain, names)
            self.notes += [note] if note else []
        estimated = self._fix(parameters, dead)
        if self.simulator.stepped is not None:
            self.notes += self._compare_with_steps(self.simulator.stepped, record, windows, states)
            dependent = find_dependent(self, estimated, record, windows, states)
            self.notes += [_dependent_note(name, self.simulator) for name in dependent]
            estimated = self._fix(estimated, dependent)
        confounded = find_confounded(self, estimated, record, windows, states)
        if "viscous_friction" in confounded and WARMS in self.terms:
            confounded[WARMS] = "the friction that warms is the simulator's own"
        self.unobservable_terms = {**self.unobservable_terms, **confounded}
        observable = {key: term for key, term in self.terms.items() if key not in self.unobservable_terms}
        self._set_terms(estimated, observable, self.sizes)

    def _compare_with_steps(
        self, stepped: SteppedSimulator, record: Record, windows: Windows, states: FloatArray
    ) -> list[str]:
        """Return a note where the simulator's own steps differ from the fitted simulation."""
        theta, index = start_values(self.parameters), index_of(self.parameters)
        for name, value in self.nominal.items():
            if name in index:
                theta[index[name]] = value
        own_values = [self._values.of(theta, name) for name in self.simulator.parameters]
        nodes = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        stepped_outputs = stepped.roll_out(own_values, record, nodes, windows, states)[:, self.columns[0]]
        if not np.isfinite(stepped_outputs).all():
            raise RecordingError(
                f"simulator {self.kind!r}: expected finite outputs where it steps along the recording by "
                "itself, found some that are none; give starts that are nearer, or a shorter time step"
            )
        fitted = self._trajectory(theta, record, windows, states)[:, self.columns[0]]
        share = float(np.sqrt(np.mean((stepped_outputs - fitted) ** 2))) / (float(np.std(fitted)) or 1.0)
        return [_deviation_note(self.kind, share)] if share > self._options.max_deviation else []

    def _fix(self, parameters: tuple[Parameter, ...], names: Collection[str]) -> tuple[Parameter, ...]:
        """Fix these parameters at their starts; return the others."""
        self.fixed |= {p.name: p.starts[0] for p in parameters if p.name in names}
        remaining = tuple(p for p in parameters if p.name not in names)
        self._set_terms(remaining, self.terms, self.sizes)
        return remaining

    def with_force(self, force: ExtraForce) -> SimulatorModel:
        """Return this model with one additional force."""
        forced = copy.copy(self)
        forced._extra = force
        return forced

    def horizon_at(self, theta: FloatArray) -> float:
        """Return the scored horizon, s: as stated, or one period of the motion."""
        return self.horizon

    def prepare(self, record: Record) -> Record:
        """Return the record as it is."""
        return record

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Fit straight lines to the first samples of each window; 0 for a position that is not measured.

        Args:
            record: The recording.
            windows: w windows.

        Returns:
            Position and velocity at the start of each window, (w, 2).
        """
        count = max(4, int(self._options.initial_time / record.period))
        states = np.zeros((len(windows), 2))
        for w, (first, last) in enumerate(zip(windows.first, windows.last, strict=True)):
            stop = min(first + count, last)
            if stop - first < 2:
                continue
            lines = np.polyfit(record.t[first:stop] - record.t[first], record.outputs[first:stop], 1)
            for column, state in enumerate(self.columns):
                states[w, state] = lines[1, column]
                if state == 0 and 1 not in self.columns:
                    states[w, 1] = lines[0, column]
        return states

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulate the measured outputs of all windows, (N, channels), from position and velocity (w, 2)."""
        outputs = self._trajectory(theta, record, windows, states)[:, self.columns]
        outputs[:, 0] = self._values.apply_sensor(theta, record, windows, outputs[:, 0])
        return outputs

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Return position, velocity, input and acting drive along the simulation, (N,) each."""
        motion = self._trajectory(theta, record, windows, states)
        motion_coordinates = {
            self.state_names[0]: motion[:, 0],
            self.state_names[1]: motion[:, 1],
            record.input_names[0]: record.inputs[windows.rows, 0],
        }
        return {**motion_coordinates, **self.drive_coordinates(theta, record, windows, motion_coordinates)}

    def drive_coordinates(
        self,
        theta: FloatArray,
        record: Record,
        windows: Windows,
        motion_coordinates: Mapping[str, FloatArray],
    ) -> Mapping[str, FloatArray]:
        """Return the input behind delay, backlash, limits and lag, and the bend of bristles, each (N,)."""
        x, v = (motion_coordinates[name] for name in self.state_names)
        return {
            "acting_drive": self._path.at_samples(record, windows, lambda n: self._input_parameter(theta, n)),
            "bend": self._values.bends(theta, windows, x, v),
        }

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Return the generalised force on the inertia at these coordinates, (N,); zero where it rests."""
        x, v = (np.ascontiguousarray(coordinates[name]) for name in self.state_names)
        part, inertia = self._part(theta)
        force = self._kernels.pull(x, v, coordinates["bend"], coordinates["acting_drive"], part) * inertia
        return np.asarray(force - self._values.added_drag(theta, v))

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Return the sizes of which starts are fractions, from this recording."""
        return characteristic_scales_of(record, self.sizes.force, self.sizes.speed)

    @cached_property
    def _kernels(self) -> Kernels:
        return kernels_of(self.simulator)

    def _dynamics(self, theta: FloatArray) -> LocalDynamics:
        numbers = tuple(self._values.of(theta, name) for name in self.simulator.parameters) or (0.0,)
        return self._right_hand_side.at(numbers)

    def _part(self, theta: FloatArray) -> tuple[tuple[Any, Pushes], float]:
        """Return the argument of the kernels and the total inertia."""
        dynamics = self._dynamics(theta)
        inertia = dynamics.inertia + self._values.of(theta, "added_inertia.inertia")

        def over(name: str) -> float:
            return self._values.of(theta, name) / inertia

        extra = sliding.Part(
            over("constant_force.force"), over("spring_force.stiffness"),
            over("spring_hardening.coefficient"), over("cogging_torque.sine"), over("cogging_torque.cosine"),
            self._values.of(theta, "cogging_torque.order"), -np.inf, np.inf, 0.0,
        )  # fmt: skip
        law = tuple(self._values.friction_law(theta, inertia).tolist())
        share = dynamics.inertia / inertia
        load = abs(dynamics.gain) * share
        return (
            dynamics.values,
            Pushes(extra, law, share, load, dynamics.stiffness, dynamics.damping),
        ), inertia

    def _input_parameter(self, theta: FloatArray, name: str) -> float:
        """Return a parameter of the input path; the simulator's own delay is part of the delay."""
        delay = self._non_smooth.delay if name == "time_delay.delay" else 0.0
        return self._values.of(theta, name) + delay

    def _trajectory(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Simulate position and velocity of all windows, (N, 2)."""
        nodes, values = self._path.nodes(record, 0, lambda name: self._input_parameter(theta, name))
        out = np.empty((len(windows.rows), 3))
        initial = np.column_stack([states, np.zeros(len(states))])
        part, inertia = self._part(theta)
        warming = viscous_change(self._values.of(theta, RATE), record, TEMPERATURE)
        course = Course(warming, part[1].law)
        arguments = (
            record.t,
            nodes,
            values,
            windows.first,
            windows.last,
            initial,
            Stops(*self._non_smooth.stops, 0.0),
        )
        additional = self._values.additional_force(theta, inertia, self._extra, record)
        if additional is None:
            self._kernels.run(*arguments, part, course, out)
        else:
            force, along = additional
            self._kernels.run_pushed(*arguments, Pushed(part, force), PushedCourse(course, along), out)
        return out[:, :2]


def _velocity_name(position: str, velocity: str) -> str:
    """Return a name by which analyses recognise a velocity."""
    return velocity if velocity.endswith("_velocity") else f"{position}_velocity"


def _short_windows(record: Record, horizon: float) -> Windows:
    """Choose up to 8 windows along a record, each of a horizon at most."""
    rows = max(8, int(horizon / record.period))
    spans = [
        (first, min(first + rows, end))
        for begin, end in record.spans
        for first in range(begin, end - 8, rows)
    ]
    return Windows.of([spans[i] for i in np.unique(np.linspace(0, len(spans) - 1, 8).astype(int))])


def _dead_note(name: str, simulator: Simulator, kind: str) -> str:
    return (
        f"{name} changes nothing in the simulated {', '.join(simulator.outputs)} of {kind}: its value never "
        f"reached the simulation. It stays at {simulator.parameters[name].start:g} and is not estimated."
    )


def _deviation_note(kind: str, share: float) -> str:
    return (
        f"{kind}, stepping by itself from the same states, differs from what is fitted by {100 * share:.2g} "
        "% of the motion: a long time step of its own, soft dry friction, contacts or stops. `labhil patch` "
        "runs the file itself."
    )


def _dependent_note(name: str, simulator: Simulator) -> str:
    return (
        f"{name} stays at {simulator.parameters[name].start:g} as in the file: the outputs change with it "
        "just as with the other parameters. State those under [known] to have it estimated."
    )
