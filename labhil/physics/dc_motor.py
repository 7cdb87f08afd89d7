"""The DC motor as it is fitted: rig parameters, terms, and their way into the winding kernel.

Equations 4.1 to 4.9 of the reference text. From voltage and speed alone resistance and inductance times a,
inertia and torques divided by a, change nothing; the model does not hide this, and the statistics show it.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from labhil.physics import winding
from labhil.physics.dc_motor_terms import REFERENCE, Sizes, catalogue, own_parameters
from labhil.physics.driven import DrivenPath
from labhil.physics.extra_force import ExtraForce, MovedPart
from labhil.physics.guesses import yardsticks_of
from labhil.physics.model import Metric, Record, Windows
from labhil.physics.terms import CharacteristicScale, Term
from labhil.physics.values import Values, horizon_of, known_numbers, near
from labhil.rig import RigFile
from labhil.signals import FloatArray

TIME_CONSTANTS = 3.0
"""Scored horizon in mechanical time constants."""

BRUSH_WIDTH = 0.01
"""Share of the typical current over which the brushes' drop changes its sign."""

TURN = 2.0 * np.pi
"""After which an angle repeats, rad."""

MOTION = ("speed", "current")
"""Where the outputs stand in a trajectory."""


class DcMotorModel:
    """The white-box model of one DC motor (satisfies ``physics.model.Model``).

    Driven by ``voltage``; simulates ``speed``, ``current`` or both. Parameters that the rig file does not
    know are estimated. States are speed, current and, as an offset that nobody fits, the angle; where no
    recording has the angle, it may be one more state (:meth:`with_place`).
    """

    kind = "dc_motor"
    coordinate_units: Mapping[str, str] = {
        "shaft_velocity": "rad/s",
        "shaft_angle": "rad",
        "current": "A",
        "voltage": "V",
        "voltage_rate": "V/s",
    }
    metric = Metric.WINDOWED_SIMULATION
    fading_memory = True
    state_names: tuple[str, ...] = ("shaft_velocity", "current")
    force_unit = "N·m"
    _extra: ExtraForce | None = None

    def __init__(self, rig: RigFile, record: Record | None = None) -> None:
        self.sizes = Sizes(record)
        self.outputs = record.output_names if record is not None else ("speed", "current")
        available = set(record.auxiliary) if record is not None else {"angle", "winding_temperature"}
        self.fixed = known_numbers(rig)
        everything = catalogue(self.sizes, self.outputs, "inertia" in self.fixed)
        self.terms: Mapping[str, Term] = {k: t for k, t in everything.items() if set(t.needs) <= available}
        self.unobservable_terms: Mapping[str, str] = {
            k: f"needs {', '.join(t.needs)}" for k, t in everything.items() if k not in self.terms
        }
        estimated = tuple(p for n, p in own_parameters(self.sizes).items() if n not in self.fixed)
        self.parameters = estimated + tuple(p for term in self.terms.values() for p in term.parameters)
        self.state_scale = np.array([0.05 * self.sizes.speed, 0.1 * self.sizes.current])
        self._values = Values(self.fixed, self.parameters)
        self._stated = rig.metric.horizon
        self.horizon = horizon_of(self._stated, TIME_CONSTANTS * self.sizes.time_constant, record)
        self._path = DrivenPath()
        # without a measured angle each window counts its own from zero
        has_angle = record is not None and "angle" in record.auxiliary
        self.moved = (MovedPart("shaft_angle" if has_angle else "", "shaft_velocity", TURN),)

    def with_place(self) -> DcMotorModel:
        """The same motor with the angle as one more state of every window, guessed from the measured speed.

        Itself where recordings have the angle, or not even the speed.
        """
        if self.moved[0].position or "speed" not in self.outputs:
            return self
        other = copy.copy(self)
        other.moved = (replace(self.moved[0], position="shaft_angle"),)
        other.state_names = (*self.state_names, "shaft_angle")
        other.state_scale = np.append(self.state_scale, 1.0)
        return other

    def with_force(self, force: ExtraForce) -> DcMotorModel:
        """The same motor under one more torque, N·m."""
        other = copy.copy(self)
        other._extra = force
        return other

    def horizon_at(self, theta: FloatArray) -> float:
        """Three mechanical time constants J/(c + K²/R), s."""
        if self._stated:
            return self._stated
        value = self._values.of
        damping = value(theta, "viscous_friction.coefficient")
        damping += value(theta, "torque_constant") ** 2 / value(theta, "resistance")
        return near(TIME_CONSTANTS * self._inertia(theta) / damping, self.horizon)

    def prepare(self, record: Record) -> Record:
        """The record itself."""
        return record

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Mean of the first samples of each window; a channel that is not there is guessed from the other."""
        states = np.zeros((len(windows), len(self.state_names)))
        count = max(2, min(5, int(0.02 * self.sizes.time_constant / record.period)))
        constant = self.fixed.get("torque_constant", self.sizes.constant)
        resistance = self.fixed.get("resistance", self.sizes.resistance)
        for w, (first, last) in enumerate(zip(windows.first, windows.last, strict=True)):
            rows = slice(first, min(first + count, last))
            means = dict(zip(self.outputs, record.outputs[rows].mean(axis=0), strict=True))
            u = float(record.inputs[first, 0])
            speed = means.get("speed")
            current = means.get("current")
            if speed is None:
                speed = (u - resistance * float(current or 0.0)) / constant
            if current is None:
                current = (u - constant * speed) / resistance
            states[w, :2] = speed, current
        if len(self.state_names) > 2:
            states[:, 2] = self._shaft_angle(record)[windows.first]
        return states

    def _shaft_angle(self, record: Record) -> FloatArray:
        """How far the shaft turned since the begin of each recording by its measured speed, rad, (n,)."""
        speed = record.outputs[:, self.outputs.index("speed")]
        return np.concatenate(
            [cumulative_trapezoid(speed[a:b], record.t[a:b], initial=0.0) for a, b in record.spans]
        )

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Speed in rad/s and current in A, those that the record has, (N, channels)."""
        motion = self._trajectory(theta, record, windows, states)
        columns = [motion[:, MOTION.index(name)] for name in self.outputs]
        seen = [self._values.sensed(theta, record, windows, columns[0])]
        if len(columns) > 1:
            gain = 1.0 + self._values.of(theta, "sensor_gain.current_gain")
            seen.append(gain * columns[1] + self._values.of(theta, "sensor_offset.current_offset"))
        return np.column_stack(seen)

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Speed, current and voltage along the simulation."""
        motion = self._trajectory(theta, record, windows, states)
        u = record.inputs[:, 0]
        along = {
            "shaft_velocity": motion[:, 0],
            "shaft_angle": motion[:, 2],
            "current": motion[:, 1],
            "voltage": u[windows.rows],
            "voltage_rate": np.gradient(u, record.t)[windows.rows],
        }
        return {**along, **self.driven(theta, record, windows, along)}

    def driven(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """The voltage behind the way in, less brushes and what warmth adds to R·i, V."""
        node_t, voltage = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        u = np.interp(record.t[windows.rows], node_t, voltage)
        u = u * (1.0 - self._values.of(theta, "supply_sag.coefficient") * np.abs(u))
        warm = (self._warm(theta, record)[windows.rows] - 1.0) * self._values.of(theta, "resistance")
        brushes = self._values.of(theta, "brush_drop.voltage")
        across = np.clip(along["current"] / (BRUSH_WIDTH * self.sizes.current), -1.0, 1.0)
        return {"acting_voltage": u - warm * along["current"] - brushes * across}

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Torque on the rotor at these coordinates, N·m; zero where it rests."""
        i, angle, w = (coordinates[name] for name in ("current", "shaft_angle", "shaft_velocity"))
        inertia = self._inertia(theta)
        law = self._values.friction_law(theta, inertia)
        torque = winding.accelerations(i, angle, w, self._motor(theta), law) * inertia
        return np.asarray(torque - self._values.added_drag(theta, w))

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """What starts are fractions of, from this recording."""
        return yardsticks_of(record, self.sizes.torque, self.sizes.speed)

    def _inertia(self, theta: FloatArray) -> float:
        return self._values.of(theta, "inertia") + self._values.of(theta, "added_inertia.mass")

    def _motor(self, theta: FloatArray) -> winding.Motor:
        inertia = self._inertia(theta)
        return winding.Motor(
            inertia=inertia,
            constant=self._values.of(theta, "torque_constant"),
            resistance=self._values.of(theta, "resistance"),
            inductance=self._values.of(theta, "inductance"),
            brush_drop=self._values.of(theta, "brush_drop.voltage"),
            brush_width=BRUSH_WIDTH * self.sizes.current,
            load=self._values.of(theta, "constant_force.force") / inertia,
            spring=self._values.of(theta, "spring_force.stiffness") / inertia,
            cogging_sine=self._values.of(theta, "cogging_torque.sine") / inertia,
            cogging_cosine=self._values.of(theta, "cogging_torque.cosine") / inertia,
            cogging_order=self._values.of(theta, "cogging_torque.order"),
        )

    def _trajectory(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """ω, i and angle of all windows, (N, 3)."""
        node_t, voltage = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        voltage = voltage * (1.0 - self._values.of(theta, "supply_sag.coefficient") * np.abs(voltage))
        starts = np.zeros((len(windows), 3))
        starts[:, : states.shape[1]] = states
        if "angle" in record.auxiliary:
            starts[:, 2] = record.auxiliary["angle"][windows.first]
        out = np.empty((len(windows.rows), 3))
        law = self._values.friction_law(theta, self._inertia(theta))
        warm, change = self._warm(theta, record), self._viscous_change(theta, record)
        given = (
            record.t, node_t, voltage, windows.first, windows.last, starts, self._motor(theta), law,
            warm, change,
        )  # fmt: skip
        beside = self._values.beside(theta, self._inertia(theta), self._extra, record)
        if beside is None:
            winding.simulate(*given, out)
        else:
            winding.simulate_pushed(*given, *beside, out)
        return out

    def _warm(self, theta: FloatArray, record: Record) -> FloatArray:
        coefficient = self._values.of(theta, "thermal_resistance.coefficient")
        if not coefficient:
            return np.ones(len(record))
        return np.asarray(1.0 + coefficient * (record.auxiliary["winding_temperature"] - REFERENCE))

    def _viscous_change(self, theta: FloatArray, record: Record) -> FloatArray:
        rate = self._values.of(theta, "temperature_dependent_friction.rate")
        if not rate:
            return np.ones(len(record))
        return np.asarray(np.exp(-rate * (record.auxiliary["winding_temperature"] - REFERENCE)))
