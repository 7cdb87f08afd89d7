"""A simulated solenoid: coil current in, plunger position out, with field, spring, friction and two stops."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.plants.driven import PlantSimulation, compile_kernel
from labhil.plants.force_map import mapped_force, no_table
from labhil.plants.friction import Friction
from labhil.plants.input_path import InputPath
from labhil.plants.integrator import PLANT_STATES, SENSOR, Body, V, Workspace, X
from labhil.plants.solenoid_definition import SOLENOID, STROKE
from labhil.plants.trajectory import Channel, SampleTimes, Trajectory, sense
from labhil.signals import FloatArray, IntArray

SIGNALS = ("plunger_position", "coil_current", "coil_voltage", "magnetic_force")
TOLERANCE_WITH_HYSTERESIS = 1e-10
"""Error of a step relative to the size of a state; a hysteresis turns within steps."""
TURNED, EDDY, TEMPERATURE = PLANT_STATES, PLANT_STATES + 1, PLANT_STATES + 2
"""Indices of the states: output of the hysteresis, lag of the field, temperature of the coil."""


class Plunger(NamedTuple):
    """Parameters of the plunger, its magnet and its coil, SI."""

    spring: float
    hardening: float
    force: float
    load_coefficient: float
    width: float
    eddy: float
    residual: float
    knee: float
    resistance: float
    copper: float
    heat_capacity: float
    thermal_resistance: float
    ambient: float
    reference: float
    latch: float
    latch_position: float
    latch_width: float
    leak: float
    high: float
    patch: float
    patch_position: float
    patch_width: float
    map_10: float
    map_11: float
    map_12: float
    map_20: float
    map_21: float
    map_30: float
    mapped: bool
    table: FloatArray

    @classmethod
    def of(cls, p: Mapping[str, float], table: FloatArray | None = None) -> Plunger:
        """Take them from the parameters of a plant; a ``table`` replaces the magnet of the parameters."""
        return cls(
            spring=p["spring_stiffness"],
            hardening=p.get("spring_hardening.coefficient", 0.0),
            force=p.get("constant_force.force", 0.0) - p.get("spring_preload.force", 0.0),
            load_coefficient=p.get("load_dependent_friction.coefficient", 0.0),
            width=p.get("magnetic_hysteresis.width", 0.0),
            eddy=p.get("eddy_current.time_constant", 0.0),
            residual=p.get("residual_magnetism.current", 0.0),
            knee=p.get("magnetic_saturation.coefficient", 0.0),
            resistance=p["coil_resistance"],
            copper=p.get("thermal_resistance.coefficient", 0.0),
            heat_capacity=p["heat_capacity"],
            thermal_resistance=p["heat_resistance"],
            ambient=p["ambient"],
            reference=p["reference_temperature"],
            latch=p.get("hidden_latch.pull", 0.0),
            latch_position=p.get("hidden_latch.place", 0.0),
            latch_width=p.get("hidden_latch.width", 1.0),
            leak=p.get("hidden_leak.damping", 0.0),
            high=p["stop_high"],
            patch=p.get("hidden_sticky_patch.level", 0.0),
            patch_position=p.get("hidden_sticky_patch.place", 0.0),
            patch_width=p.get("hidden_sticky_patch.width", 1.0),
            map_10=p["force_map_10"],
            map_11=p["force_map_11"],
            map_12=p["force_map_12"],
            map_20=p["force_map_20"],
            map_21=p["force_map_21"],
            map_30=p["force_map_30"],
            mapped=table is not None,
            table=no_table() if table is None else table,
        )


@compiled
def magnet_force(i: float, x: float, m: Plunger) -> float:
    """Return the force (N) at field current ``i`` (A) and position ``x`` (m)."""
    if m.mapped:
        return mapped_force(i, x, m.table)[0]
    y = x / STROKE
    linear = m.map_10 + m.map_11 * y + m.map_12 * y * y
    return i * (linear + i * (m.map_20 + m.map_21 * y + m.map_30 * i))


@compiled
def force_per_current(i: float, x: float, m: Plunger) -> float:
    """Return ∂F/∂i of the magnet, N/A, which is also the induced voltage per velocity, V·s/m."""
    if m.mapped:
        return mapped_force(i, x, m.table)[1]
    y = x / STROKE
    linear = m.map_10 + m.map_11 * y + m.map_12 * y * y
    return linear + i * (2.0 * m.map_20 + 2.0 * m.map_21 * y + 3.0 * m.map_30 * i)


@compiled
def turn_magnet(before: float, u: float, width: float) -> float:
    """Apply the hysteresis to a current (A): a backlash of full width ``width``, last at ``before``."""
    return min(max(before, u - 0.5 * width), u + 0.5 * width)


@compiled
def field_of(s: FloatArray, u: float, m: Plunger) -> float:
    """Return the current (A) that corresponds to the field."""
    i = s[EDDY] if m.eddy > 0.0 else turn_magnet(s[TURNED], u, m.width)
    i += m.residual
    return i / (1.0 + m.knee * abs(i))


@compiled
def applied_force(s: FloatArray, u: float, m: Plunger, rates: FloatArray) -> tuple[float, float, float]:
    """Return force without friction (N), additional dry friction (N), and the factor of viscous friction."""
    x, v = s[X], s[V]
    rates[TURNED] = 0.0
    rates[EDDY] = (turn_magnet(s[TURNED], u, m.width) - s[EDDY]) / m.eddy if m.eddy > 0.0 else 0.0
    resistance = m.resistance * (1.0 + m.copper * (s[TEMPERATURE] - m.reference))
    rates[TEMPERATURE] = (
        resistance * u * u - (s[TEMPERATURE] - m.ambient) / m.thermal_resistance
    ) / m.heat_capacity
    magnet = magnet_force(field_of(s, u, m), x, m)
    force = magnet + m.force - x * (m.spring + m.hardening * x * x)
    if m.latch != 0.0:
        offset = (x - m.latch_position) / m.latch_width
        force -= m.latch * offset * math.exp(0.5 - 0.5 * offset * offset)
    if m.leak != 0.0:
        force -= m.leak * v * math.exp((x - m.high) / 5e-4)
    extra_level = m.load_coefficient * abs(magnet)
    if m.patch != 0.0:
        offset = (x - m.patch_position) / m.patch_width
        extra_level += m.patch * math.exp(-0.5 * offset * offset)
    return force, extra_level, 1.0


@compiled
def update_memory(s: FloatArray, u: float, m: Plunger) -> None:
    """Update the output of the hysteresis."""
    s[TURNED] = turn_magnet(s[TURNED], u, m.width)


run_plunger = compile_kernel(applied_force, update_memory, __name__)


@compiled
def run(
    inputs: FloatArray, ends: FloatArray, clock: FloatArray, times: FloatArray, values: FloatArray,
    counters: IntArray, memory: FloatArray, is_held: bool, s: FloatArray, mode: FloatArray,
    b: Body, m: Plunger, f: Friction, p: InputPath, w: Workspace, out: FloatArray,
) -> None:  # fmt: skip
    """See :func:`labhil.plants.driven.run`."""
    run_plunger(inputs, ends, clock, times, values, counters, memory, is_held, s, mode, b, m, f, p, w, out)


@compiled
def magnet(rows: FloatArray, m: Plunger, out: FloatArray) -> None:
    """Write field current, force and ∂F/∂i (n, 3) at states and acting currents (n, states + 1)."""
    for k in range(len(rows)):
        i = field_of(rows[k], rows[k, -1], m)
        out[k, 0], out[k, 1] = i, magnet_force(i, rows[k, X], m)
        out[k, 2] = force_per_current(i, rows[k, X], m)


class SolenoidPlant:
    """A simulated solenoid; it starts at rest at the lower stop, without current.

    Args:
        parameters: Values by name, SI, that replace defaults.
        terms: Names of the effects that it has.
        seed: Seed of the noise.
        period: Time between samples, s.
        force_map: Measured forces of a magnet (:mod:`labhil.plants.force_map`) that replace the parameters.
    """

    def __init__(
        self,
        parameters: Mapping[str, float] | None = None,
        terms: Iterable[str] = (),
        seed: int = 0,
        period: float = 0.001,
        force_map: FloatArray | None = None,
    ) -> None:
        self.terms = tuple(terms)
        self.parameters = p = SOLENOID.resolve(self.terms, parameters or {})
        self.period = period
        lag, sensor_lag = (p.get(f"{name}.time_constant", 0.0) for name in ("actuator_lag", "sensor_lag"))
        restitution = p.get("end_stop_contact.restitution", 0.0)
        body = Body(
            p["moving_mass"],
            p["stop_low"],
            p["stop_high"],
            restitution,
            lag,
            sensor_lag,
            X,
            TOLERANCE_WITH_HYSTERESIS,
        )
        self._plunger = Plunger.of(p, force_map)
        sample_times, plant_states = SampleTimes(p, period, seed), (0.0, 0.0, p["ambient"])
        self.simulation = PlantSimulation(
            p, run, self._plunger, body, sample_times, False, p["stop_low"], plant_states
        )
        step = p.get("quantisation.step", 0.0)
        self._channels = {
            name: Channel(p, name, seed, step * (name == "plunger_position")) for name in SIGNALS
        }
        self._now, self._slope = 0.0, 0.0

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.simulation.time

    def step(self, current: float) -> Mapping[str, float]:
        """Change the current linearly to ``current`` (A) within a sample period.

        Return the signals at its end.
        """
        return {name: float(x[0]) for name, x in self.advance(np.array([current])).items()}

    def advance(self, current: FloatArray) -> Mapping[str, FloatArray]:
        """Change the current linearly to each of the currents (n,), A, within a sample period.

        Returns:
            The measured signals at the ends of the periods, (n,) each.
        """
        before = self.simulation.time
        rows, ends = self.simulation.advance(current)
        slope = np.append(current[0] - self._now, current[1:] - current[:-1])
        slope /= np.append(ends[0] - before, ends[1:] - ends[:-1])
        self._now, self._slope = float(current[-1]), float(slope[-1])
        return self._measure(rows, current, slope, ends)

    def simulate(self, current: FloatArray) -> Trajectory:
        """Simulate with currents (n,), A, at the samples, linear in between; the first is now.

        The input of the trajectory is the measured current.
        """
        i = np.asarray(current, dtype=np.float64)
        start = self.simulation.time
        rows, t = self.simulation.simulate(i)
        slope = np.append(self._slope, np.diff(i) / np.diff(t))
        self._now, self._slope = float(i[-1]), float(slope[-1])
        measured = self._measure(rows, i, slope, start + t)
        truth = {
            "plunger_position": rows[:, X],
            "plunger_velocity": rows[:, V],
            "field_current": self._magnet(rows)[:, 0],
            "coil_current": i,
            "coil_temperature": rows[:, TEMPERATURE],
        }
        return Trajectory(self.simulation.sample_times.recorded(t), measured["coil_current"], measured, truth)

    def coil(self) -> tuple[float, float]:
        """Return the present resistance of the coil (Ω) and its induced voltage (V)."""
        row = self.simulation.row[None]
        return float(self._resistance(row)[0]), float(self._induced(row, self._magnet(row)[:, 2])[0])

    def _magnet(self, rows: FloatArray) -> FloatArray:
        out = np.empty((len(rows), 3))
        magnet(rows, self._plunger, out)
        return out

    def _measure(
        self, rows: FloatArray, i: FloatArray, slope: FloatArray, t: FloatArray
    ) -> dict[str, FloatArray]:
        p = self.parameters
        _, force, slope_by_current = self._magnet(rows).T
        ripple = np.sin(2.0 * np.pi * p.get("pwm_ripple.frequency", 0.0) * t)
        position = rows[:, SENSOR if "sensor_lag.time_constant" in p else X]
        signals = {
            "plunger_position": sense(position, p),
            "coil_current": i + p.get("pwm_ripple.current", 0.0) * ripple,
            "coil_voltage": self._resistance(rows) * i
            + p["coil_inductance"] * slope
            + self._induced(rows, slope_by_current)
            + p.get("pwm_ripple.voltage", 0.0) * ripple,
            "magnetic_force": force,
        }
        measured = {name: self._channels[name].sample(x) for name, x in signals.items()}
        return measured | {"coil_current_command": i + p["loop_time"] * slope}

    def _resistance(self, rows: FloatArray) -> FloatArray:
        p = self.parameters
        excess_temperature = rows[:, TEMPERATURE] - p["reference_temperature"]
        factor = 1.0 + p.get("thermal_resistance.coefficient", 0.0) * excess_temperature
        return np.asarray(p["coil_resistance"] * factor)

    def _induced(self, rows: FloatArray, slope_by_current: FloatArray) -> FloatArray:
        return np.asarray(self.parameters.get("motional_emf.share", 0.0) * slope_by_current * rows[:, V])
