"""White-box model of a driven linear axis: force or voltage in, position out.

M·ẍ = F − friction + F₀ − k·x − k₃·x³ − cogging, with mass M (kg), position x (m), drive force F (N; the
input, or drive_gain (N/V) times the input voltage) and the forces of ``physics.sliding``, its kernel. The
benchmark EMPS (Janot, Gautier, Brunot 2019) is such an axis. Without [known] moving_mass the mass is
estimated; with a voltage and without [known] drive_gain, only the ratios of forces to mass and gain are
identifiable.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np

from labhil.physics import sliding
from labhil.physics.drive_balance import DEFAULT_CUT_OFF, Balance, DriveMotion
from labhil.physics.driven import InputPath
from labhil.physics.extra_force import ExtraForce, MovedPart
from labhil.physics.friction_terms import friction_terms, load_dependent_friction
from labhil.physics.guesses import characteristic_scales_of, states_from_line_fit
from labhil.physics.model import Metric
from labhil.physics.path_terms import input_terms, output_terms
from labhil.physics.record import Record, Windows
from labhil.physics.terms import (
    TWO_WAVES,
    CharacteristicScale,
    Enters,
    Parameter,
    Term,
    why_without_channels,
)  # fmt: skip
from labhil.physics.values import Values, horizon_of, known_numbers, limit_horizon
from labhil.physics.warming import RATE, TEMPERATURE, viscous_change, warming_friction
from labhil.physics.weak_form import regress_mass_and_drag
from labhil.rig import RigFile
from labhil.signals import FloatArray

HORIZON_TIME_CONSTANTS = 3.0
"""Scored horizon in time constants of mass and viscous friction."""

INITIAL_STATE_SPAN = 0.05
"""Span of the line fit that gives the initial state of a window, s."""


class Sizes:
    """First estimates of the axis' parameters before a fit (SI), for starts and scales.

    Args:
        record: The recording; None for default sizes.
        gain: Force per unit of the input.
        test_width: Width of the test functions, s.
    """

    def __init__(self, record: Record | None, gain: float, *, test_width: float = 0.4) -> None:
        self.force, self.speed, self.span, self.mass, self.time_constant = 100.0, 0.1, 0.2, 100.0, 0.5
        if record is None:
            return
        recordings = record.recordings()
        self.force = float(np.sqrt(np.mean((gain * record.inputs[:, 0]) ** 2))) or 1.0
        self.span = max(float(np.ptp(recording.outputs[:, 0])) for recording in recordings) or 1.0
        speeds = np.concatenate([_speeds(recording) for recording in recordings])
        self.speed = float(np.sqrt(np.mean(speeds**2))) or 1.0
        mass, drag, _ = regress_mass_and_drag(recordings, gain, test_width)
        self.mass = mass if mass > 0.0 else self.force / (self.speed / test_width)
        self.time_constant = float(np.clip(mass / drag, 0.01, 10.0)) if mass > 0.0 and drag > 0.0 else 0.5

    @property
    def drag(self) -> float:
        """Viscous friction that gives the time constant, N·s/m."""
        return self.mass / self.time_constant


def _stride(record: Record) -> int:
    """Samples in 0.05 s."""
    return max(1, int(0.05 / record.period))


def _speeds(record: Record) -> FloatArray:
    """Velocities (m,) by differences over 0.05 s, long enough to average noise."""
    stride = _stride(record)
    return np.asarray(np.diff(record.outputs[::stride, 0]) / np.diff(record.t[::stride]))


def catalogue(s: Sizes) -> dict[str, Term]:
    """Terms of an axis, by key, with scales of its size."""
    level = 0.1 * s.force
    loads = (
        Term(
            "constant_force", Enters.FORCE, "a constant push (tilt, offset of the drive)", "F = F_0",
            "standard", "motion both ways", (Parameter("constant_force.force", "N", level),),
        ),
        Term(
            "spring_force", Enters.FORCE, "a pull back towards zero in proportion to position", "F = −k·x",
            "Hooke", "motion over the whole range",
            (Parameter("spring_force.stiffness", "N/m", level / s.span),),
        ),
        Term(
            "spring_hardening", Enters.FORCE, "a pull back towards zero that stiffens with position",
            "F = −k₃·x³", "Duffing", "motion over the whole range",
            (Parameter("spring_hardening.coefficient", "N/m³", level / s.span**3),),
        ),
        Term(
            "cogging_torque", Enters.FORCE, "a force that repeats along the way (magnets, a screw's pitch)",
            "F = −a·sin kx − b·cos kx", "period of the drive", "slow motion",
            (
                Parameter("cogging_torque.sine", "N", level, starts=(0.3 * level,)),
                Parameter("cogging_torque.cosine", "N", level, starts=(0.3 * level,)),
                Parameter(
                    "cogging_torque.order", "rad/m", 20.0 / s.span, TWO_WAVES / s.span, 2e3 / s.span,
                    starts=(20.0 / s.span, 60.0 / s.span, 200.0 / s.span), shape=True, waves_over="position",
                ),
            ),
        ),
        Term(
            "added_inertia", Enters.FORCE, "more mass than is known (a load)", "(M + m)·ẍ = …",
            "standard", "acceleration",
            (Parameter("added_inertia.mass", "kg", 0.1 * s.mass, -0.5 * s.mass),),
        ),
        warming_friction("the axis", TEMPERATURE),
    )  # fmt: skip
    terms = friction_terms("N", "m", level, s.speed) + loads + input_terms("N")
    terms += (load_dependent_friction("the drive's force"),)
    terms += output_terms("position", "m", s.span)
    return {term.key: term for term in terms}


class AxisModel:
    """White-box model of one axis (implements ``physics.model.Model``).

    The input is ``drive_force`` or ``drive_voltage``, the output is ``position``.

    Args:
        rig: The rig file.
        record: The recording that typical sizes are taken from; None for default sizes.
    """

    kind = "axis"
    coordinate_units: Mapping[str, str] = {
        "position": "m",
        "axis_velocity": "m/s",
        "drive_force": "N",
        "drive_voltage": "V",
    }
    releases_interpreter = True
    metric = Metric.WINDOWED_SIMULATION
    fading_memory = False
    state_names = ("position", "axis_velocity")
    force_unit = "N"
    moved = (MovedPart("position", "axis_velocity"),)
    _extra: ExtraForce | None = None

    def __init__(self, rig: RigFile, record: Record | None = None) -> None:
        self.volts = record is not None and record.input_names[0] == "drive_voltage"
        self.fixed = known_numbers(rig)
        self.sizes = Sizes(record, self.fixed.get("drive_gain", 1.0) if self.volts else 1.0)
        available = set(record.auxiliary) if record is not None else {TEMPERATURE}
        everything = catalogue(self.sizes)
        self.terms: Mapping[str, Term] = {
            k: t
            for k, t in everything.items()
            if set(t.needs) <= available and (k != "added_inertia" or "moving_mass" in self.fixed)
        }
        self.unobservable_terms: Mapping[str, str] = {
            "sensor_offset": "a constant offset of position is taken up by each window's own initial state"
        } | why_without_channels(everything, available)
        typical = {"moving_mass": ("kg", self.sizes.mass)}
        if self.volts and "drive_gain" not in self.fixed:
            typical["drive_gain"] = ("N/V", 1.0)
        self.parameters = tuple(
            Parameter(n, unit, size, 1e-3 * size, 1e3 * size, starts=(size,))
            for n, (unit, size) in typical.items()
            if n not in self.fixed
        ) + tuple(p for term in self.terms.values() for p in term.parameters)
        self.state_scale = np.array([0.02 * self.sizes.span, 0.1 * self.sizes.speed])
        self._values = Values(self.fixed, self.parameters)
        self.cut_off = rig.metric.cut_off or DEFAULT_CUT_OFF
        self._stated = rig.metric.horizon
        self.horizon = horizon_of(self._stated, HORIZON_TIME_CONSTANTS * self.sizes.time_constant, record)
        self._path = InputPath()

    def with_force(self, force: ExtraForce) -> AxisModel:
        """Copy of the axis with an additional force, N."""
        other = copy.copy(self)
        other._extra = force
        return other

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon: three times mass over viscous friction, s."""
        drag = self._values.of(theta, "viscous_friction.coefficient")
        if self._stated or drag <= 0.0:
            return self._stated or self.horizon
        return limit_horizon(HORIZON_TIME_CONSTANTS * self._mass(theta) / drag, self.horizon)

    def prepare(self, record: Record) -> Record:
        """Return the record unchanged: nothing is filtered."""
        return record

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Position and velocity of a straight line through the first samples of each window, (w, 2)."""
        return states_from_line_fit(record, windows, INITIAL_STATE_SPAN)

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulate the measured position, (N, 1), m."""
        x = self._trajectory(theta, record, windows, states)[:, 0]
        return self._values.apply_sensor(theta, record, windows, x)[:, None]

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Position, velocity and input along the simulation, each (N,)."""
        motion = self._trajectory(theta, record, windows, states)
        along = {
            "position": motion[:, 0],
            "axis_velocity": motion[:, 1],
            record.input_names[0]: record.inputs[windows.rows, 0],
        }
        return {**along, **self.drive_coordinates(theta, record, windows, along)}

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Input behind the effects of the input path, and bend of the bristles, each (N,)."""
        return {
            "acting_drive": self._path.at_samples(record, windows, lambda n: self._values.of(theta, n)),
            "bend": self._values.bends(theta, windows, along["position"], along["axis_velocity"]),
        }

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Force on the moving mass at these coordinates, (N,), N; zero where it is at rest."""
        x, v = coordinates["position"], coordinates["axis_velocity"]
        u, bend = coordinates["acting_drive"], coordinates["bend"]
        part, law = self._part(theta), self._values.friction_law(theta, self._mass(theta))
        force = sliding.accelerations(u, x, v, bend, self._table(theta), part, law) * self._mass(theta)
        return np.asarray(force - self._values.added_drag(theta, v))

    def balance(self, theta: FloatArray, record: Record) -> Balance:
        """Compute the drive force that the measured motion needs and the one exerted, low-pass filtered.

        Effects of the sensor on the position are not corrected.
        """
        motion = DriveMotion.of(record, self.cut_off)
        nodes, values = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        return Balance(
            motion.filter_and_select(self.inverse_dynamics(theta, record, motion)),
            self.gain(theta) * motion.drive(nodes, values),
            self._mass(theta) * motion.noise,
            motion.low_pass.cut_off,
        )

    def inverse_dynamics(self, theta: FloatArray, record: Record, motion: DriveMotion) -> FloatArray:
        """Inverse dynamics: drive force that a motion needs, M·ẍ + friction − other forces, (n,), N."""
        idle = {
            "position": motion.x,
            "axis_velocity": motion.v,
            "acting_drive": np.zeros_like(motion.x),
            "bend": np.sign(motion.v),
        }
        force = self._mass(theta) * motion.a - self.generalised_force(theta, idle)
        if np.any(change := self._warming(theta, record) - 1.0):
            drag = self._values.of(theta, "viscous_friction.coefficient")
            force += drag * np.interp(motion.t, record.t, change) * motion.v
        # F = force + μ·|F|·sgn v, solved for F; μ is smaller than one
        share = self._values.of(theta, "load_dependent_friction.coefficient")
        return np.asarray(force / (1.0 - share * np.sign(motion.v) * np.sign(force)))

    def gain(self, theta: FloatArray) -> float:
        """Force per unit of the recorded drive, N/V; 1 where the force itself is recorded."""
        return self._values.of(theta, "drive_gain") if self.volts else 1.0

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Characteristic scales of this recording."""
        return characteristic_scales_of(record, self.sizes.force, self.sizes.speed)

    def _mass(self, theta: FloatArray) -> float:
        return self._values.of(theta, "moving_mass") + self._values.of(theta, "added_inertia.mass")

    def _part(self, theta: FloatArray) -> sliding.Part:
        mass = self._mass(theta)
        return sliding.Part(
            force=self._values.of(theta, "constant_force.force") / mass,
            spring=self._values.of(theta, "spring_force.stiffness") / mass,
            hardening=self._values.of(theta, "spring_hardening.coefficient") / mass,
            cogging_sine=self._values.of(theta, "cogging_torque.sine") / mass,
            cogging_cosine=self._values.of(theta, "cogging_torque.cosine") / mass,
            cogging_order=self._values.of(theta, "cogging_torque.order"),
            low=-np.inf,
            high=np.inf,
            restitution=0.0,
        )

    def _table(self, theta: FloatArray) -> sliding.Table:
        table = np.zeros((sliding.N_POWERS, sliding.N_POWERS))
        table[1, 0] = self.gain(theta) / self._mass(theta)
        return sliding.table_from_array(table)

    def _warming(self, theta: FloatArray, record: Record) -> FloatArray:
        """Viscous friction over that at the reference temperature, (n,)."""
        return viscous_change(self._values.of(theta, RATE), record, TEMPERATURE)

    def _trajectory(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Position and velocity of all windows, (N, 2)."""
        nodes, values = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        change = self._warming(theta, record)
        out = np.empty((len(windows.rows), 3))
        mass = self._mass(theta)
        given = (
            record.t, nodes, values, windows.first, windows.last, states, self._table(theta),
            self._part(theta), self._values.friction_law(theta, mass), change,
        )  # fmt: skip
        additional = self._values.additional_force(theta, mass, self._extra, record)
        if additional is None:
            sliding.simulate(*given, out)
        else:
            sliding.simulate_with_force(*given, *additional, out)
        return out[:, :2]
