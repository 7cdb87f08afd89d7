"""A simulated DC motor: held voltage in; speed, current, angle and the winding's temperature out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.plants.dc_motor_definition import MOTOR
from labhil.plants.driven import TOLERANCE, PlantSimulation, compile_kernel
from labhil.plants.friction import Friction
from labhil.plants.input_path import InputPath
from labhil.plants.integrator import PLANT_STATES, SENSOR, Body, V, Workspace, X
from labhil.plants.trajectory import Channel, SampleTimes, Trajectory, sense
from labhil.signals import FloatArray, IntArray

SIGNALS = ("speed", "current", "angle", "winding_temperature")
BRUSH_CURRENT = 0.01
"""Current (A) over which the brushes' drop changes its sign."""
CURRENT, TEMPERATURE = PLANT_STATES, PLANT_STATES + 1


class Motor(NamedTuple):
    """Parameters of the motor, SI."""

    constant: float
    resistance: float
    copper: float
    inductance: float
    heat_capacity: float
    thermal_resistance: float
    ambient: float
    reference: float
    viscosity_rate: float
    load: float
    load_coefficient: float
    cogging: float
    second: float
    order: float
    phase: float
    spring: float
    brush: float
    sag: float
    magnet: float
    magnet_width: float
    drag: float
    drag_speed: float
    patch: float
    patch_position: float
    patch_width: float

    @classmethod
    def of(cls, p: Mapping[str, float]) -> Motor:
        """Take them from the parameters of a plant."""
        return cls(
            constant=p["torque_constant"],
            resistance=p["resistance"],
            copper=p.get("thermal_resistance.coefficient", 0.0),
            inductance=p["inductance"],
            heat_capacity=p["heat_capacity"],
            thermal_resistance=p["heat_resistance"],
            ambient=p["ambient"],
            reference=p["reference_temperature"],
            viscosity_rate=p.get("temperature_dependent_friction.rate", 0.0),
            load=p.get("constant_force.force", 0.0),
            load_coefficient=p.get("load_dependent_friction.coefficient", 0.0),
            cogging=p.get("cogging_torque.amplitude", 0.0),
            second=p.get("cogging_torque.second", 0.0),
            order=p.get("cogging_torque.order", 1.0),
            phase=p.get("cogging_torque.phase", 0.0),
            spring=p.get("spring_force.stiffness", 0.0),
            brush=p.get("brush_drop.voltage", 0.0),
            sag=p.get("supply_sag.coefficient", 0.0),
            magnet=p.get("hidden_magnet.pull", 0.0),
            magnet_width=p.get("hidden_magnet.width", 1.0),
            drag=p.get("hidden_drag.level", 0.0),
            drag_speed=p.get("hidden_drag.speed", 1.0),
            patch=p.get("hidden_sticky_patch.level", 0.0),
            patch_position=p.get("hidden_sticky_patch.place", 0.0),
            patch_width=p.get("hidden_sticky_patch.width", 1.0),
        )


@compiled
def angle_difference(angle: float, place: float) -> float:
    """Return the difference of two angles, −π … π."""
    return (angle - place + math.pi) % (2.0 * math.pi) - math.pi


@compiled
def net_torque(s: FloatArray, m: Motor) -> float:
    """Return the torque on the rotor without friction, N·m."""
    angle, w = s[X], s[V]
    torque = m.constant * s[CURRENT] - m.load - m.spring * angle
    if m.cogging != 0.0 or m.second != 0.0:
        phase = m.order * angle + m.phase
        torque -= m.cogging * math.sin(phase) + m.second * math.sin(2.0 * phase)
    if m.magnet != 0.0:
        offset = angle_difference(angle, 0.0) / m.magnet_width
        torque -= m.magnet * offset * math.exp(0.5 - 0.5 * offset * offset)
    if m.drag != 0.0:
        torque -= m.drag * w / m.drag_speed * math.exp(1.0 - abs(w) / m.drag_speed)
    return torque


@compiled
def applied_force(s: FloatArray, u: float, m: Motor, rates: FloatArray) -> tuple[float, float, float]:
    """Return torque without friction, additional dry friction (N·m), and the factor of viscous friction.

    L·di/dt = U − R·i − K·ω − brushes; C·dT/dt = R·i² − (T − T_air)/R_th.
    """
    i, excess_temperature = s[CURRENT], s[TEMPERATURE] - m.reference
    resistance = m.resistance * (1.0 + m.copper * excess_temperature)
    supplied = u * (1.0 - m.sag * abs(u))
    drop = m.brush * math.tanh(i / BRUSH_CURRENT) if m.brush != 0.0 else 0.0
    rates[CURRENT] = (supplied - resistance * i - m.constant * s[V] - drop) / m.inductance
    rates[TEMPERATURE] = (
        resistance * i * i - (s[TEMPERATURE] - m.ambient) / m.thermal_resistance
    ) / m.heat_capacity
    extra_level = m.load_coefficient * abs(m.constant * i)
    if m.patch != 0.0:
        offset = angle_difference(s[X], m.patch_position) / m.patch_width
        extra_level += m.patch * math.exp(-0.5 * offset * offset)
    return (
        net_torque(s, m),
        extra_level,
        math.exp(-m.viscosity_rate * excess_temperature) if m.viscosity_rate != 0.0 else 1.0,
    )


@compiled
def update_memory(s: FloatArray, u: float, m: Motor) -> None:
    """Do nothing: a motor has no memory beside its states."""


run_motor = compile_kernel(applied_force, update_memory, __name__)


@compiled
def run(
    inputs: FloatArray, ends: FloatArray, clock: FloatArray, times: FloatArray, values: FloatArray,
    counters: IntArray, memory: FloatArray, is_held: bool, s: FloatArray, mode: FloatArray,
    b: Body, m: Motor, f: Friction, p: InputPath, w: Workspace, out: FloatArray,
) -> None:  # fmt: skip
    """See :func:`labhil.plants.driven.run`."""
    run_motor(inputs, ends, clock, times, values, counters, memory, is_held, s, mode, b, m, f, p, w, out)


class DcMotorPlant:
    """A simulated motor; it starts at rest without current, at ambient temperature.

    Args:
        parameters: Values by name, SI, that replace defaults.
        terms: Names of the effects that it has.
        seed: Seed of the noise.
        period: Time between samples, s.
    """

    def __init__(
        self,
        parameters: Mapping[str, float] | None = None,
        terms: Iterable[str] = (),
        seed: int = 0,
        period: float = 0.01,
    ) -> None:
        self.terms = tuple(terms)
        self.parameters = p = MOTOR.resolve(self.terms, parameters or {})
        self.period = period
        inertia = p["inertia"] + p.get("added_inertia.mass", 0.0)
        lag, sensor_lag = (p.get(f"{name}.time_constant", 0.0) for name in ("actuator_lag", "sensor_lag"))
        body = Body(inertia, -math.inf, math.inf, 0.0, lag, sensor_lag, V, TOLERANCE)
        sample_times = SampleTimes(p, period, seed)
        self.simulation = PlantSimulation(
            p, run, Motor.of(p), body, sample_times, plant_states=(0.0, p["ambient"])
        )
        step = p.get("quantisation.step", 0.0)
        self._channels = {name: Channel(p, name, seed, step * (name == "speed")) for name in SIGNALS}

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.simulation.time

    def step(self, voltage: float) -> Mapping[str, float]:
        """Hold ``voltage`` (V) for one sample period; return the measured signals at its end."""
        return {name: float(x[0]) for name, x in self.advance(np.array([voltage])).items()}

    def advance(self, voltage: FloatArray) -> Mapping[str, FloatArray]:
        """Hold each of the voltages (n,), V, for one sample period.

        Return the measured signals at the ends, (n,).
        """
        return self._measure(self.simulation.advance(voltage)[0])

    def simulate(self, voltage: FloatArray) -> Trajectory:
        """Simulate with voltages (n,), V, that are held from each sample to the next; the first is now."""
        u = np.asarray(voltage, dtype=np.float64)
        rows, t = self.simulation.simulate(u)
        columns = (V, CURRENT, X, TEMPERATURE, -1)
        truth = dict(zip((*SIGNALS, "terminal_voltage"), rows.T[list(columns)], strict=True))
        return Trajectory(self.simulation.sample_times.recorded(t), u, self._measure(rows), truth)

    def _measure(self, rows: FloatArray) -> dict[str, FloatArray]:
        p = self.parameters
        speed = rows[:, SENSOR if "sensor_lag.time_constant" in p else V]
        signals = {
            "speed": sense(speed, p),
            "current": sense(rows[:, CURRENT], p, "current_"),
            "angle": rows[:, X],
            "winding_temperature": rows[:, TEMPERATURE],
        }
        return {name: self._channels[name].sample(x) for name, x in signals.items()}
