"""What an analysis works on where the rig is a user's own simulator (satisfies ``physics.model.Model``)."""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from labhil.errors import RecordingError
from labhil.physics import sliding, tabulated
from labhil.physics.at_port import Course, Pushes
from labhil.physics.driven import InputPath
from labhil.physics.extra_force import ExtraForce, MovedPart, Pushed, PushedCourse
from labhil.physics.guesses import characteristic_scales_of
from labhil.physics.model import Metric, Record, Windows, index_of, start_values
from labhil.physics.moving_part import Stops
from labhil.physics.terms import CharacteristicScale, Parameter, Term
from labhil.physics.values import Values, known_numbers
from labhil.rig import RigFile
from labhil.signals import FloatArray
from labhil.simulators.catalogue import Sizes, catalogue, rates
from labhil.simulators.confounded import find_confounded, find_dependent
from labhil.simulators.laws import Kernels, kernels_of
from labhil.simulators.probing import dead_parameters
from labhil.simulators.stepped import Held, Stepped
from labhil.simulators.tables import Reach, Shape, table_of

if TYPE_CHECKING:
    from labhil.simulators.simulator import Simulator

STATE_SPAN = 0.05
"""Seconds over which the first position and velocity of a window are guessed."""

PLACES = 12
"""Places along a recording at which the stiffness of the right-hand side is evaluated."""

FEWEST_ROWS = 40
"""Samples that a scored horizon has at least."""

STRAYS = 0.1
"""Share of the motion by which a simulator's own steps may differ from what is fitted without a note."""

NUDGE = 1e-4
REMEMBERED = 32
_KERNELS: dict[int, tuple[Simulator, Kernels]] = {}


def compiled_of(simulator: Simulator) -> Kernels:
    """The kernels of a simulator, compiled once in a process; of stepped ones, once for all."""
    if simulator.stepped is not None:
        return Kernels(tabulated.look_up, tabulated.pulls, tabulated.run, tabulated.run_pushed)
    entry = _KERNELS.get(id(simulator.f))
    if entry is None or entry[0].f is not simulator.f or entry[0].states != simulator.states:
        entry = _KERNELS[id(simulator.f)] = (simulator, kernels_of(simulator))
    return entry[1]


class LocalDynamics(NamedTuple):
    """The right-hand side at some values of its parameters: gain, inertia, and largest slopes."""

    values: Any
    gain: float
    inertia: float
    stiff: float
    quick: float


class SimulatorModel:
    """The model of a user's simulator with the catalogue at its ports.

    Simulates the measured ones of position and velocity; the input is the simulator's own.
    """

    metric = Metric.WINDOWED_SIMULATION
    fading_memory = False
    _extra: ExtraForce | None = None

    def __init__(self, simulator: Simulator, rig: RigFile, record: Record | None = None) -> None:
        self.simulator, self.nominal = simulator, simulator.nominal
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
        self._remembered: dict[tuple[float, ...], LocalDynamics] = {}
        self._places = np.array([[0.0, 0.0, 0.0], [0.3, 0.1, 0.1]])
        self._held = Held() if simulator.stepped is None else simulator.stepped.held
        self._reach = Reach()
        self._shape: Shape | None = None
        parameters = tuple(q.parameter(n) for n, q in simulator.parameters.items() if n not in self.fixed)
        self._set(parameters, {}, Sizes())
        self._measure(parameters, record)
        self.horizon = rig.metric.horizon or simulator.horizon or self.sizes.horizon
        self.unobservable_terms: Mapping[str, str] = {}
        self.notes: list[str] = []
        if record is not None:
            self._try_out(parameters, record)

    def _set(self, parameters: tuple[Parameter, ...], terms: Mapping[str, Term], sizes: Sizes) -> None:
        self.sizes, self.terms = sizes, terms
        self.parameters = parameters + tuple(p for term in terms.values() for p in term.parameters)
        self._values = Values(self.fixed, self.parameters)
        self.state_scale = np.array([0.02 * sizes.span, 0.1 * sizes.speed])

    def _measure(self, parameters: tuple[Parameter, ...], record: Record | None) -> None:
        """Take scales and terms from a recording."""
        sizes = Sizes()
        if record is not None:
            self._look_along(record)
            at = self._dynamics(start_values(parameters))
            sizes = Sizes.of(record, self._velocity_column, at.inertia, at.gain)
            rows = np.linspace(0, len(record) - 2, PLACES).astype(int)
            begun = self.initial_states(record, Windows.of([(r, min(r + 8, len(record))) for r in rows]))
            self._places = np.column_stack([begun, record.inputs[rows, 0]])
            self._remembered.clear()
            swing = 2.0 * np.pi / float(np.sqrt(max(self._dynamics(start_values(parameters)).stiff, 1e-12)))
            shortest = FEWEST_ROWS * record.period
            # one swing: what goes over its upper rest forgets within a few where it came from
            sizes = replace(sizes, horizon=max(min(sizes.horizon, swing), shortest))
        length = self.simulator.states[self.position]
        channel, unit = next(iter(self.simulator.outputs.items()))
        drive = next(iter(self.simulator.inputs.values()))
        self._set(
            parameters, catalogue(sizes, self.force_unit, length, self.position, drive, channel, unit), sizes
        )

    def _look_along(self, record: Record) -> None:
        """Take the range in which the simulator will be evaluated from a recording."""
        place = record.outputs[:, 0] if self.columns[0] == 0 else None
        speeds = np.concatenate(
            [rates(recording, self._velocity_column) for recording in record.recordings()]
        )
        self._reach = Reach.along(place, speeds, record.inputs[:, 0], record.max_horizon, self._held.clip)
        self._shape = None
        self._remembered.clear()

    def _try_out(self, parameters: tuple[Parameter, ...], record: Record) -> None:
        """Find parameters that never reach the outputs, and effects that look like others."""
        windows = _short_windows(record, self.horizon)
        states, theta = self.initial_states(record, windows), start_values(self.parameters)

        def simulate(values: FloatArray) -> FloatArray:
            return self.simulate(values, record, windows, states)

        if not np.isfinite(simulate(theta)).all():
            raise RecordingError(
                f"simulator {self.kind!r}: expected finite outputs along the recording at the starts of its "
                "parameters, found some that are none; give starts that are nearer, or bounds"
            )
        dead = dead_parameters(simulate, theta, [p.name for p in parameters])
        self.notes = [*self.simulator.notes]
        self.notes += [_dead_note(name, self.simulator, self.kind) for name in dead]
        alive = self._without(parameters, dead)
        if self.simulator.stepped is not None:
            self.notes += self._compare_with_own_steps(self.simulator.stepped, record, windows, states)
            same = find_dependent(self, alive, record, windows, states)
            self.notes += [_same_note(name, self.simulator) for name in same]
            alive = self._without(alive, same)
        self.unobservable_terms = find_confounded(self, alive, record, windows, states)
        observable = {key: term for key, term in self.terms.items() if key not in self.unobservable_terms}
        self._set(alive, observable, self.sizes)

    def _compare_with_own_steps(
        self, stepped: Stepped, record: Record, windows: Windows, states: FloatArray
    ) -> list[str]:
        """A note where the simulator's own steps differ from the fitted simulation."""
        theta, index = start_values(self.parameters), index_of(self.parameters)
        for name, value in self.nominal.items():
            if name in index:
                theta[index[name]] = value
        numbers = [self._values.of(theta, name) for name in self.simulator.parameters]
        nodes = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        itself = stepped.roll_out(numbers, record, nodes, windows, states)[:, self.columns[0]]
        if not np.isfinite(itself).all():
            raise RecordingError(
                f"simulator {self.kind!r}: expected finite outputs where it steps along the recording by "
                "itself, found some that are none; give starts that are nearer, or a shorter time step"
            )
        fitted = self._trajectory(theta, record, windows, states)[:, self.columns[0]]
        share = float(np.sqrt(np.mean((itself - fitted) ** 2))) / (float(np.std(fitted)) or 1.0)
        return [_strays_note(self.kind, share)] if share > STRAYS else []

    def _without(self, parameters: tuple[Parameter, ...], names: Collection[str]) -> tuple[Parameter, ...]:
        """The parameters without these, which stay at their starts."""
        self.fixed |= {p.name: p.starts[0] for p in parameters if p.name in names}
        kept = tuple(p for p in parameters if p.name not in names)
        self._set(kept, self.terms, self.sizes)
        return kept

    def with_force(self, force: ExtraForce) -> SimulatorModel:
        """The same simulator under one more force."""
        forced = copy.copy(self)
        forced._extra = force
        return forced

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon, s: as stated, or a swing, at most a period of the measured motion."""
        return self.horizon

    def prepare(self, record: Record) -> Record:
        """The record itself."""
        return record

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Straight lines through the first samples of each window, (w, 2); 0 for a place nobody measures."""
        count = max(4, int(STATE_SPAN / record.period))
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
        """Measured states, (N, channels)."""
        outputs = self._trajectory(theta, record, windows, states)[:, self.columns]
        outputs[:, 0] = self._values.apply_sensor(theta, record, windows, outputs[:, 0])
        return outputs

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Position, velocity and input along the simulation."""
        motion = self._trajectory(theta, record, windows, states)
        along = {
            self.state_names[0]: motion[:, 0],
            self.state_names[1]: motion[:, 1],
            record.input_names[0]: record.inputs[windows.rows, 0],
        }
        return {**along, **self.drive_coordinates(theta, record, windows, along)}

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """What acts of the input behind the way in."""
        return {"acting_drive": self._path.at_samples(record, windows, lambda n: self._on_the_way(theta, n))}

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Force on the inertia at these coordinates; zero where it rests."""
        x, v = (np.ascontiguousarray(coordinates[name]) for name in self.state_names)
        part, inertia = self._part(theta)
        force = self._kernels.pull(x, v, coordinates["acting_drive"], part) * inertia
        return np.asarray(force - self._values.added_drag(theta, v))

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """What starts are fractions of, from this recording."""
        return characteristic_scales_of(record, self.sizes.force, self.sizes.speed)

    @cached_property
    def _kernels(self) -> Kernels:
        return compiled_of(self.simulator)

    def _dynamics(self, theta: FloatArray) -> LocalDynamics:
        """The right-hand side at these values, cached: most simulations change other parameters."""
        names = self.simulator.parameters
        numbers = tuple(self._values.of(theta, name) for name in names) or (0.0,)
        dynamics = self._remembered.get(numbers)
        if dynamics is None:
            if len(self._remembered) >= REMEMBERED:
                self._remembered.clear()
            dynamics = self._remembered[numbers] = self._linearise(numbers)
        return dynamics

    def _linearise(self, numbers: tuple[float, ...]) -> LocalDynamics:
        p, f = self._kernel_parameters(numbers), self._kernels.acceleration
        gain = f(0.0, 0.0, 1.0, p) - f(0.0, 0.0, 0.0, p)
        inertia = self._stated_inertia(numbers)
        stiff = quick = 0.0
        for x, v, u in self._places.tolist():
            base = f(x, v, u, p)
            stiff = max(stiff, abs(f(x + NUDGE, v, u, p) - base) / NUDGE)
            quick = max(quick, abs(f(x, v + NUDGE, u, p) - base) / NUDGE)
        mass = abs(inertia) if inertia is not None else 1.0 / max(abs(gain), 1e-12)
        return LocalDynamics(p, gain, mass, stiff, quick)

    def _stated_inertia(self, numbers: tuple[float, ...]) -> float | None:
        if self.simulator.stepped is not None:
            return self.simulator.stepped.inertia(numbers)
        name = self.simulator.coordinate.inertia
        return dict(zip(self.simulator.parameters, numbers, strict=False)).get(name)

    def _kernel_parameters(self, numbers: tuple[float, ...]) -> Any:
        """The simulator at these values, in the form that the kernels take."""
        if self.simulator.stepped is None:
            return self.simulator.records[2](*numbers)
        ask = self.simulator.stepped.ask(numbers)
        if self._shape is None:
            self._shape = Shape.of(ask, self._reach, self.kind, self._held.rough)
        return table_of(ask, self._reach, self._shape, self._held.clip)

    def _part(self, theta: FloatArray) -> tuple[tuple[Any, Pushes], float]:
        """What the kernel takes, and the inertia with what was added to it."""
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
        return (dynamics.values, Pushes(extra, law, share, load, dynamics.stiff, dynamics.quick)), inertia

    def _on_the_way(self, theta: FloatArray, name: str) -> float:
        """A value of the way in, with the delay that the simulator has of its own."""
        delay = self._held.delay if name == "time_delay.delay" else 0.0
        return self._values.of(theta, name) + delay

    def _trajectory(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Position and velocity of all windows, (N, 2)."""
        nodes, values = self._path.nodes(record, 0, lambda name: self._on_the_way(theta, name))
        out = np.empty((len(windows.rows), 3))
        begun = np.column_stack([states, np.zeros(len(states))])
        part, inertia = self._part(theta)
        given = (record.t, nodes, values, windows.first, windows.last, begun, Stops(*self._held.stops, 0.0))
        beside = self._values.additional_force(theta, inertia, self._extra, record)
        if beside is None:
            self._kernels.run(*given, part, Course(0.0), out)
        else:
            beyond, along = beside
            self._kernels.run_pushed(*given, Pushed(part, beyond), PushedCourse(Course(0.0), along), out)
        return out[:, :2]


def _velocity_name(position: str, velocity: str) -> str:
    """What analyses know to be zero at rest."""
    return velocity if velocity.endswith("_velocity") else f"{position}_velocity"


def _short_windows(record: Record, horizon: float) -> Windows:
    """A few windows along a record, each of a horizon at most."""
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
        f"reached the simulation. It is left at {simulator.parameters[name].start:g} and not estimated."
    )


def _strays_note(kind: str, share: float) -> str:
    return (
        f"{kind}, stepping by itself from the same states, differs from what is fitted by {100 * share:.2g} "
        "% of the motion: a long time step of its own, soft dry friction, contacts or stops. `labhil patch` "
        "runs the file itself."
    )


def _same_note(name: str, simulator: Simulator) -> str:
    return (
        f"{name} is left at {simulator.parameters[name].start:g} as in the file: the outputs change with it "
        "just as with the other parameters. State those under [known] to have it estimated."
    )
