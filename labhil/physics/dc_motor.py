"""White-box model of a DC motor: voltage in, speed and current out.

U = R·i + L·di/dt + K·ω and J·ω̇ = K·i − friction − load; the symbols are in ``physics.winding``, the kernel
that simulates it, the terms in ``physics.dc_motor_terms``. Equations 4.1 to 4.9 of the reference text.
Voltage and speed alone do not identify all parameters: R and L may be multiplied by a factor if J and all
torques are divided by it. The statistics of a fit show this.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from labhil.physics import winding
from labhil.physics.dc_motor_terms import Sizes, catalogue, motor_parameters
from labhil.physics.driven import InputPath
from labhil.physics.extra_force import ExtraForce, MovedPart
from labhil.physics.guesses import characteristic_scales_of
from labhil.physics.model import Metric
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale, Term, why_without_channels
from labhil.physics.values import Values, horizon_of, known_numbers, limit_horizon
from labhil.physics.warming import RATE, REFERENCE_TEMPERATURE, viscous_change
from labhil.rig import RigFile
from labhil.signals import FloatArray

HORIZON_TIME_CONSTANTS = 3.0
"""Scored horizon in mechanical time constants."""

BRUSH_WIDTH_SHARE = 0.01
"""Half-width of the range in which the brush drop changes its sign, as a share of the typical current."""

FULL_TURN = 2.0 * np.pi
"""Period of the angle, rad."""

TRAJECTORY_COLUMNS = ("speed", "current")
"""Outputs in the order of the columns of a trajectory."""


class DcMotorModel:
    """White-box model of one DC motor (implements ``physics.model.Model``).

    The input is ``voltage``, the outputs are ``speed``, ``current`` or both. Parameters that the rig file
    does not state are estimated. The states are speed and current; the angle starts at its measured value.
    Where it is not recorded, it may be a further state (:meth:`with_place`).

    Args:
        rig: The rig file.
        record: The recording that typical sizes are taken from; None for default sizes.
    """

    kind = "dc_motor"
    coordinate_units: Mapping[str, str] = {
        "shaft_velocity": "rad/s",
        "shaft_angle": "rad",
        "current": "A",
        "voltage": "V",
        "voltage_rate": "V/s",
    }
    releases_interpreter = True
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
        self.unobservable_terms: Mapping[str, str] = why_without_channels(everything, available)
        estimated = tuple(p for n, p in motor_parameters(self.sizes).items() if n not in self.fixed)
        self.parameters = estimated + tuple(p for term in self.terms.values() for p in term.parameters)
        self.state_scale = np.array([0.05 * self.sizes.speed, 0.1 * self.sizes.current])
        self._values = Values(self.fixed, self.parameters)
        self._stated = rig.metric.horizon
        self.horizon = horizon_of(self._stated, HORIZON_TIME_CONSTANTS * self.sizes.time_constant, record)
        self._path = InputPath()
        # without a measured angle, each window starts at angle zero
        has_angle = record is not None and "angle" in record.auxiliary
        self.moved = (MovedPart("shaft_angle" if has_angle else "", "shaft_velocity", FULL_TURN),)

    def with_place(self) -> DcMotorModel:
        """Copy with the angle as a further state of every window, guessed from the measured speed.

        The model itself if the recording has the angle, or has no speed.
        """
        if self.moved[0].position or "speed" not in self.outputs:
            return self
        other = copy.copy(self)
        other.moved = (replace(self.moved[0], position="shaft_angle"),)
        other.state_names = (*self.state_names, "shaft_angle")
        other.state_scale = np.append(self.state_scale, 1.0)
        return other

    def with_force(self, force: ExtraForce) -> DcMotorModel:
        """Copy of the motor with an additional torque, N·m."""
        other = copy.copy(self)
        other._extra = force
        return other

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon: three mechanical time constants J/(c + K²/R), s."""
        if self._stated:
            return self._stated
        value = self._values.of
        damping = value(theta, "viscous_friction.coefficient")
        damping += value(theta, "torque_constant") ** 2 / value(theta, "resistance")
        return limit_horizon(HORIZON_TIME_CONSTANTS * self._inertia(theta) / damping, self.horizon)

    def prepare(self, record: Record) -> Record:
        """Return the record unchanged: nothing is filtered."""
        return record

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Mean of the first samples of each window; a missing channel is guessed from the other."""
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
        """Angle since the start of each recording by integration of the measured speed, (n,), rad."""
        speed = record.outputs[:, self.outputs.index("speed")]
        return np.concatenate(
            [cumulative_trapezoid(speed[a:b], record.t[a:b], initial=0.0) for a, b in record.spans]
        )

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulate speed (rad/s) and current (A), as far as the record has them, (N, channels)."""
        motion = self._trajectory(theta, record, windows, states)
        columns = [motion[:, TRAJECTORY_COLUMNS.index(name)] for name in self.outputs]
        measured = [self._values.apply_sensor(theta, record, windows, columns[0])]
        if len(columns) > 1:
            gain = 1.0 + self._values.of(theta, "sensor_gain.current_gain")
            measured.append(gain * columns[1] + self._values.of(theta, "sensor_offset.current_offset"))
        return np.column_stack(measured)

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Speed, angle, current and voltage along the simulation, each (N,)."""
        motion = self._trajectory(theta, record, windows, states)
        u = record.inputs[:, 0]
        along = {
            "shaft_velocity": motion[:, 0],
            "shaft_angle": motion[:, 2],
            "current": motion[:, 1],
            "voltage": u[windows.rows],
            "voltage_rate": np.gradient(u, record.t)[windows.rows],
        }
        return {**along, **self.drive_coordinates(theta, record, windows, along)}

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Voltage behind the input path less brush drop and warming (V), bend of the bristles, each (N,)."""
        node_t, voltage = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        u = np.interp(record.t[windows.rows], node_t, voltage)
        u = u * (1.0 - self._values.of(theta, "supply_sag.coefficient") * np.abs(u))
        warm = (self._warm(theta, record)[windows.rows] - 1.0) * self._values.of(theta, "resistance")
        brushes = self._values.of(theta, "brush_drop.voltage")
        across = np.clip(along["current"] / (BRUSH_WIDTH_SHARE * self.sizes.current), -1.0, 1.0)
        return {
            "acting_voltage": u - warm * along["current"] - brushes * across,
            "bend": self._values.bends(theta, windows, along["shaft_angle"], along["shaft_velocity"]),
        }

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Torque on the rotor at these coordinates, (N,), N·m; zero where it is at rest."""
        i, angle, w = (coordinates[name] for name in ("current", "shaft_angle", "shaft_velocity"))
        inertia = self._inertia(theta)
        law = self._values.friction_law(theta, inertia)
        bend = coordinates["bend"]
        torque = winding.accelerations(i, angle, w, bend, self._motor(theta), law) * inertia
        return np.asarray(torque - self._values.added_drag(theta, w))

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Characteristic scales of this recording."""
        return characteristic_scales_of(record, self.sizes.torque, self.sizes.speed)

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
            brush_width=BRUSH_WIDTH_SHARE * self.sizes.current,
            load=self._values.of(theta, "constant_force.force") / inertia,
            spring=self._values.of(theta, "spring_force.stiffness") / inertia,
            cogging_sine=self._values.of(theta, "cogging_torque.sine") / inertia,
            cogging_cosine=self._values.of(theta, "cogging_torque.cosine") / inertia,
            cogging_order=self._values.of(theta, "cogging_torque.order"),
        )

    def _trajectory(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Speed, current and angle of all windows, (N, 3)."""
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
        additional = self._values.additional_force(theta, self._inertia(theta), self._extra, record)
        if additional is None:
            winding.simulate(*given, out)
        else:
            winding.simulate_with_force(*given, *additional, out)
        return out

    def _warm(self, theta: FloatArray, record: Record) -> FloatArray:
        """Resistance over that at the reference temperature, (n,)."""
        coefficient = self._values.of(theta, "thermal_resistance.coefficient")
        if not coefficient:
            return np.ones(len(record))
        return np.asarray(
            1.0 + coefficient * (record.auxiliary["winding_temperature"] - REFERENCE_TEMPERATURE)
        )

    def _viscous_change(self, theta: FloatArray, record: Record) -> FloatArray:
        """Viscous friction over that at the reference temperature, (n,)."""
        return viscous_change(self._values.of(theta, RATE), record, "winding_temperature")
