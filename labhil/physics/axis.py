"""A driven axis as it is fitted: M·ẍ = F − friction + F₀ − spring, F given or drive_gain·voltage.

The benchmark EMPS (Janot, Gautier, Brunot 2019) is one. Without [known] moving_mass the mass is estimated;
with a voltage and without [known] drive_gain the mass must be known, or only ratios are.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from labhil.physics import sliding
from labhil.physics.drive_balance import CUT_OFF, Balance, DriveMotion
from labhil.physics.driven import DrivenPath
from labhil.physics.extra_force import ExtraForce, MovedPart
from labhil.physics.friction_terms import friction_terms, load_dependent_friction
from labhil.physics.guesses import straight_starts, yardsticks_of
from labhil.physics.model import Metric, Record, Windows
from labhil.physics.path_terms import input_terms, output_terms
from labhil.physics.terms import TWO_WAVES, CharacteristicScale, Enters, Parameter, Term
from labhil.physics.values import Values, horizon_of, known_numbers, near
from labhil.rig import RigFile
from labhil.signals import FloatArray

TIME_CONSTANTS = 3.0
REFERENCE = 20.0
"""Temperature (°C) at which viscous friction has its stated value."""

STATE_SPAN = 0.05
"""Seconds over which the first position and velocity of a window are guessed."""


WIDTH = 0.4
"""Of the test functions under which forces are balanced for a first estimate of the mass, s."""


class Sizes:
    """What a recording says of the axis before anything is fitted (SI).

    The balance of forces is regressed in its weak form (Shinbrot 1957): no derivative of a noisy signal is
    needed.
    """

    def __init__(self, record: Record | None, gain: float) -> None:
        self.force, self.speed, self.span, self.mass, self.time_constant = 100.0, 0.1, 0.2, 100.0, 0.5
        if record is None:
            return
        recordings = record.recordings()
        self.force = float(np.sqrt(np.mean((gain * record.inputs[:, 0]) ** 2))) or 1.0
        self.span = max(float(np.ptp(recording.outputs[:, 0])) for recording in recordings) or 1.0
        speeds = np.concatenate([_speeds(recording) for recording in recordings])
        self.speed = float(np.sqrt(np.mean(speeds**2))) or 1.0
        weak = np.vstack([_weak_form(recording, gain) for recording in recordings])
        norms = np.maximum(np.linalg.norm(weak, axis=0), 1e-300)
        balance = np.linalg.lstsq(weak[:, 1:] / norms[1:], weak[:, 0], rcond=None)[0] / norms[1:]
        mass, drag = balance[:2]
        self.mass = float(mass) if mass > 0.0 else self.force / (self.speed / WIDTH)
        self.time_constant = float(np.clip(mass / drag, 0.01, 10.0)) if mass > 0.0 and drag > 0.0 else 0.5

    @property
    def drag(self) -> float:
        """Viscous friction that has the time constant, N·s/m."""
        return self.mass / self.time_constant


def _stride(record: Record) -> int:
    return max(1, int(0.05 / record.period))


def _speeds(record: Record) -> FloatArray:
    """Velocities (m,) over stretches long enough for noise not to matter."""
    stride = _stride(record)
    return np.asarray(np.diff(record.outputs[::stride, 0]) / np.diff(record.t[::stride]))


def _weak_form(record: Record, gain: float) -> FloatArray:
    """The balance of forces under test functions φ, (m, 6): of drive, mass, drag, dry friction, spring, bias.

    F = M·ẍ + c·ẋ + T·sgn ẋ + k·x + b times φ and integrated; derivatives are passed on to φ, which fades at
    both ends with two of its derivatives.
    """
    u, x = gain * record.inputs[:, 0], record.outputs[:, 0] - record.outputs[0, 0]
    half = max(4, min(int(0.5 * WIDTH / record.period), (len(record) - 1) // 4))
    s = np.arange(-half, half + 1) / half
    width, well = half * record.period, 1.0 - s * s
    functions = {0: well**3, 1: -6.0 * s * well**2 / width, 2: 6.0 * well * (5.0 * s * s - 1.0) / width**2}
    side = np.sign(np.gradient(_smooth(x, _stride(record))))
    columns = ((u, 0, 1.0), (x, 2, 1.0), (x, 1, -1.0), (side, 0, 1.0), (x, 0, 1.0), (np.ones_like(x), 0, 1.0))
    hop = max(half // 2, 1)
    stretches = (sliding_window_view(values, len(s))[::hop] for values, _, _ in columns)
    passed = zip(stretches, columns, strict=True)
    return np.column_stack([sign * (values @ functions[order]) for values, (_, order, sign) in passed])


def _smooth(x: FloatArray, width: int) -> FloatArray:
    kernel = np.ones(2 * width + 1) / (2 * width + 1)
    return np.asarray(np.convolve(np.pad(x, width, mode="edge"), kernel, mode="valid"))


def catalogue(s: Sizes) -> dict[str, Term]:
    """All terms, their scales of the axis' size."""
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
        Term(
            "temperature_dependent_friction", Enters.FORCE, "viscous friction that falls as the axis warms",
            "c(T) = c·exp(−α·(T − 20 °C))", "viscosity of grease",
            "long runs that warm the axis",
            (Parameter("temperature_dependent_friction.rate", "1/K", 0.02, -0.2, 0.2),),
            needs=("temperature",),
        ),
    )  # fmt: skip
    terms = friction_terms("N", "m", level, s.speed) + loads + input_terms("N")
    terms += (load_dependent_friction("the drive's force"),)
    terms += output_terms("position", "m", s.span)
    return {term.key: term for term in terms}


class AxisModel:
    """The white-box model of one axis (satisfies ``physics.model.Model``).

    Driven by ``drive_force``, or by ``drive_voltage`` times drive_gain; simulates ``position``.
    """

    kind = "axis"
    coordinate_units: Mapping[str, str] = {
        "position": "m",
        "axis_velocity": "m/s",
        "drive_force": "N",
        "drive_voltage": "V",
    }
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
        available = set(record.auxiliary) if record is not None else {"temperature"}
        everything = catalogue(self.sizes)
        self.terms: Mapping[str, Term] = {
            k: t
            for k, t in everything.items()
            if set(t.needs) <= available and (k != "added_inertia" or "moving_mass" in self.fixed)
        }
        self.unobservable_terms: Mapping[str, str] = {
            "sensor_offset": "a constant offset of position is taken up by each window's own initial state"
        } | {k: f"needs {', '.join(t.needs)}" for k, t in everything.items() if not set(t.needs) <= available}
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
        self.cut_off = rig.metric.cut_off or CUT_OFF
        self._stated = rig.metric.horizon
        self.horizon = horizon_of(self._stated, TIME_CONSTANTS * self.sizes.time_constant, record)
        self._path = DrivenPath()

    def with_force(self, force: ExtraForce) -> AxisModel:
        """The same axis under one more force, N."""
        other = copy.copy(self)
        other._extra = force
        return other

    def horizon_at(self, theta: FloatArray) -> float:
        """Three times mass over viscous friction, s."""
        drag = self._values.of(theta, "viscous_friction.coefficient")
        if self._stated or drag <= 0.0:
            return self._stated or self.horizon
        return near(TIME_CONSTANTS * self._mass(theta) / drag, self.horizon)

    def prepare(self, record: Record) -> Record:
        """The record itself."""
        return record

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Position and slope of a straight line through the first samples of each window."""
        return straight_starts(record, windows, STATE_SPAN)

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Measured position in m, (N, 1)."""
        x = self._trajectory(theta, record, windows, states)[:, 0]
        return self._values.sensed(theta, record, windows, x)[:, None]

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Position, velocity and input along the simulation."""
        motion = self._trajectory(theta, record, windows, states)
        along = {
            "position": motion[:, 0],
            "axis_velocity": motion[:, 1],
            record.input_names[0]: record.inputs[windows.rows, 0],
        }
        return {**along, **self.driven(theta, record, windows, along)}

    def driven(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """What acts of the input behind the way in."""
        return {"acting_drive": self._path.at_samples(record, windows, lambda n: self._values.of(theta, n))}

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Force on the moving mass at these coordinates, N; zero where it rests."""
        x, v = coordinates["position"], coordinates["axis_velocity"]
        u = coordinates["acting_drive"]
        part, law = self._part(theta), self._values.friction_law(theta, self._mass(theta))
        force = sliding.accelerations(u, x, v, self._table(theta), part, law) * self._mass(theta)
        return np.asarray(force - self._values.added_drag(theta, v))

    def balance(self, theta: FloatArray, record: Record) -> Balance:
        """What the drive had to push for the measured motion and what it pushed, behind the low-pass.

        What a sensor's own effects do to the position is not undone.
        """
        motion = DriveMotion.of(record, self.cut_off)
        nodes, values = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        return Balance(
            motion.at_judged(self.needed(theta, record, motion)),
            self.gain(theta) * motion.drive(nodes, values),
            self._mass(theta) * motion.noise,
            motion.low_pass.cut_off,
        )

    def needed(self, theta: FloatArray, record: Record, motion: DriveMotion) -> FloatArray:
        """Force of the drive in N that a motion takes, M·ẍ + friction − all other forces, (n,)."""
        idle = {"position": motion.x, "axis_velocity": motion.v, "acting_drive": np.zeros_like(motion.x)}
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
        """What starts are fractions of, from this recording."""
        return yardsticks_of(record, self.sizes.force, self.sizes.speed)

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
        table = np.zeros((sliding.POWERS, sliding.POWERS))
        table[1, 0] = self.gain(theta) / self._mass(theta)
        return sliding.table_of(table)

    def _warming(self, theta: FloatArray, record: Record) -> FloatArray:
        """Viscous friction over what it is at the reference temperature, (n,)."""
        rate = self._values.of(theta, "temperature_dependent_friction.rate")
        return np.exp(-rate * (record.auxiliary["temperature"] - REFERENCE)) if rate else np.ones(len(record))

    def _trajectory(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """x and v of all windows, (N, 2)."""
        nodes, values = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        change = self._warming(theta, record)
        out = np.empty((len(windows.rows), 3))
        mass = self._mass(theta)
        given = (
            record.t, nodes, values, windows.first, windows.last, states, self._table(theta),
            self._part(theta), self._values.friction_law(theta, mass), change,
        )  # fmt: skip
        beside = self._values.beside(theta, mass, self._extra, record)
        if beside is None:
            sliding.simulate(*given, out)
        else:
            sliding.simulate_pushed(*given, *beside, out)
        return out[:, :2]
