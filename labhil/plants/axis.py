"""A simulated linear axis: held force in, position out; rigid, or with an elastically coupled load."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.plants.definition import (
    FRICTION,
    INPUT_EFFECTS,
    OUTPUT_EFFECTS,
    POSITIVE,
    SAMPLING,
    Effect,
    PlantDefinition,
    with_sizes,
)
from labhil.plants.driven import TOLERANCE, PlantSimulation, compile_kernel
from labhil.plants.friction import Friction
from labhil.plants.input_path import InputPath
from labhil.plants.integrator import PLANT_STATES, SENSOR, Body, V, Workspace, X
from labhil.plants.trajectory import Channel, SampleTimes, Trajectory, sense
from labhil.signals import FloatArray, IntArray

SIGNALS = ("position", "velocity", "temperature", "drive_current")
TEMPERATURE, LOAD_X, LOAD_V = PLANT_STATES, PLANT_STATES + 1, PLANT_STATES + 2

AXIS = PlantDefinition(
    bare={
        "moving_mass": 95.0,  # kg
        "drive_gain": 35.15,  # N/V, of the voltage that is reported beside the force
        "drive_constant": 50.0,  # N/A, of the current that is reported beside the force
        "temperature_start": 25.0,  # °C, also of what surrounds the axis
        "reference_temperature": 25.0,  # °C, at which viscous friction has the stated value
        "warming": 0.0,  # K/J of friction heat
        "cooling": 0.0,  # 1/s
        "position_noise": 2e-6,  # m
        "velocity_noise": 1e-3,  # m/s
        "temperature_noise": 0.0,  # K
        "drive_current_noise": 0.02,  # A
        "position_resolution": 0.0,  # m, of an encoder
        **SAMPLING,
    },
    effects={
        **with_sizes(
            FRICTION,
            {
                "viscous_friction": {"coefficient": 204.0},
                "coulomb_friction": {"level": 20.4},
                "stribeck_friction": {"level": 8.0, "velocity": 0.01},
                "static_friction": {"level": 5.0},
                "quadratic_viscous_friction": {"coefficient": 100.0},
                "cubic_viscous_friction": {"coefficient": 500.0},
                "friction_asymmetry": {"coefficient": 36.0, "level": 0.0},
                "position_dependent_friction": {"slope": 20.0},
                "load_dependent_friction": {"coefficient": 0.1},
                "presliding_friction": {"stiffness": 2e6, "damping": 2e3},
                "maxwell_slip_friction": {"stiffness": 2e6, "damping": 2e3, "attraction": 5e3},
            },
        ),
        "temperature_dependent_friction": Effect("viscous friction that falls with warmth", {"rate": 0.02}),
        "constant_force": Effect("a constant push, N", {"force": 3.2}),
        "spring_force": Effect("a spring towards zero, N/m", {"stiffness": 100.0}),
        "spring_hardening": Effect("a spring that stiffens, N/m³", {"coefficient": 1000.0}),
        "cogging_torque": Effect(
            "a force that repeats along the way, with a second harmonic, N",
            {"amplitude": 3.0, "order": 314.0, "phase": 0.0, "second": 0.0},
        ),
        "added_inertia": Effect("a load on the carriage, kg", {"mass": 10.0}),
        "joint_elasticity": Effect(
            "a share of the mass hangs on a spring (m/N) with a damper (N·s/m), behind the encoder",
            {"compliance": 2e-6, "damping": 300.0, "share": 0.7},
        ),
        **with_sizes(
            INPUT_EFFECTS,
            {
                "time_delay": {"delay": 0.004},
                "dead_zone": {"left": 5.0, "right": 5.0},
                "saturation": {"limit": 100.0},
                "backlash": {"gap": 10.0},
                "actuator_lag": {"time_constant": 0.005},
                "rate_limit": {"rate": 5000.0},
            },
        ),
        **with_sizes(
            OUTPUT_EFFECTS,
            {
                "sensor_offset": {"offset": 0.001},
                "sensor_nonlinearity": {"cubic": 0.1},
                "quantisation": {"step": 1e-4},
            },
        ),
    },
    positive=POSITIVE
    | {
        "moving_mass", "drive_gain", "drive_constant", "hidden_magnet.width", "hidden_sticky_patch.width",
    },
    hidden={
        "hidden_magnet": Effect("a magnet under the way that pulls", {"pull": 10.0, "width": 0.02}),
        "hidden_cable": Effect("a cable that pulls beyond a place, N/m", {"stiffness": 200.0, "from": 0.05}),
        "hidden_sticky_patch": Effect(
            "a place on the way that rubs harder", {"level": 15.0, "place": 0.05, "width": 0.02}
        ),
    },
)  # fmt: skip


class Carriage(NamedTuple):
    """Parameters of the axis, SI."""

    force: float
    spring: float
    hardening: float
    cogging: float
    second: float
    order: float
    phase: float
    load_coefficient: float
    start: float
    reference: float
    warming: float
    cooling: float
    viscosity_rate: float
    viscous: float
    dry: float
    load: float
    stiffness: float
    damping: float
    magnet: float
    magnet_width: float
    cable: float
    cable_start: float
    patch: float
    patch_position: float
    patch_width: float

    @classmethod
    def of(cls, p: Mapping[str, float]) -> Carriage:
        """Take them from the parameters of a plant."""
        compliance = p.get("joint_elasticity.compliance", 0.0)
        return cls(
            force=p.get("constant_force.force", 0.0),
            spring=p.get("spring_force.stiffness", 0.0),
            hardening=p.get("spring_hardening.coefficient", 0.0),
            cogging=p.get("cogging_torque.amplitude", 0.0),
            second=p.get("cogging_torque.second", 0.0),
            order=p.get("cogging_torque.order", 1.0),
            phase=p.get("cogging_torque.phase", 0.0),
            load_coefficient=p.get("load_dependent_friction.coefficient", 0.0),
            start=p["temperature_start"],
            reference=p["reference_temperature"],
            warming=p["warming"],
            cooling=p["cooling"],
            viscosity_rate=p.get("temperature_dependent_friction.rate", 0.0),
            viscous=p.get("viscous_friction.coefficient", 0.0),
            dry=p.get("coulomb_friction.level", 0.0),
            load=elastic_mass(p),
            stiffness=1.0 / compliance if compliance else 0.0,
            damping=p.get("joint_elasticity.damping", 0.0),
            magnet=p.get("hidden_magnet.pull", 0.0),
            magnet_width=p.get("hidden_magnet.width", 1.0),
            cable=p.get("hidden_cable.stiffness", 0.0),
            cable_start=p.get("hidden_cable.from", 0.0),
            patch=p.get("hidden_sticky_patch.level", 0.0),
            patch_position=p.get("hidden_sticky_patch.place", 0.0),
            patch_width=p.get("hidden_sticky_patch.width", 1.0),
        )


def total_mass(p: Mapping[str, float]) -> float:
    """Return the total moving mass, kg."""
    return p["moving_mass"] + p.get("added_inertia.mass", 0.0)


def elastic_mass(p: Mapping[str, float]) -> float:
    """Return the elastically coupled mass, kg; 0 where the joint is rigid."""
    share = p.get("joint_elasticity.share", 0.0) if p.get("joint_elasticity.compliance", 0.0) else 0.0
    return share * total_mass(p)


@compiled
def passive_force(x: float, m: Carriage) -> float:
    """Return the force (N) at a position without drive, friction and load."""
    force = m.force - x * (m.spring + m.hardening * x * x)
    if m.cogging != 0.0 or m.second != 0.0:
        angle = m.order * x + m.phase
        force -= m.cogging * math.sin(angle) + m.second * math.sin(2.0 * angle)
    if m.magnet != 0.0:
        offset = x / m.magnet_width
        force -= m.magnet * offset * math.exp(0.5 - 0.5 * offset * offset)
    if m.cable != 0.0 and x > m.cable_start:
        force -= m.cable * (x - m.cable_start)
    return force


@compiled
def applied_force(s: FloatArray, u: float, m: Carriage, rates: FloatArray) -> tuple[float, float, float]:
    """Return force without friction (N), additional dry friction (N), and the factor of viscous friction."""
    x, v = s[X], s[V]
    force = u + passive_force(x, m)
    rates[LOAD_X], rates[LOAD_V] = 0.0, 0.0
    if m.load > 0.0:
        pull = m.stiffness * (x - s[LOAD_X]) + m.damping * (v - s[LOAD_V])
        rates[LOAD_X], rates[LOAD_V] = s[LOAD_V], pull / m.load
        force -= pull
    viscosity = (
        math.exp(-m.viscosity_rate * (s[TEMPERATURE] - m.reference)) if m.viscosity_rate != 0.0 else 1.0
    )
    speed = abs(v)
    heat = speed * (m.dry + viscosity * m.viscous * speed)
    rates[TEMPERATURE] = m.warming * heat - m.cooling * (s[TEMPERATURE] - m.start)
    extra_level = m.load_coefficient * abs(u)
    if m.patch != 0.0:
        offset = (x - m.patch_position) / m.patch_width
        extra_level += m.patch * math.exp(-0.5 * offset * offset)
    return force, extra_level, viscosity


@compiled
def update_memory(s: FloatArray, u: float, m: Carriage) -> None:
    """Do nothing: an axis has no memory beside its states."""


run_axis = compile_kernel(applied_force, update_memory, __name__)


@compiled
def run(
    inputs: FloatArray, ends: FloatArray, clock: FloatArray, times: FloatArray, values: FloatArray,
    counters: IntArray, memory: FloatArray, is_held: bool, s: FloatArray, mode: FloatArray,
    b: Body, m: Carriage, f: Friction, p: InputPath, w: Workspace, out: FloatArray,
) -> None:  # fmt: skip
    """See :func:`labhil.plants.driven.run`."""
    run_axis(inputs, ends, clock, times, values, counters, memory, is_held, s, mode, b, m, f, p, w, out)


class AxisPlant:
    """A simulated axis; it starts at rest at position 0.

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
        period: float = 0.001,
    ) -> None:
        self.terms = tuple(terms)
        self.parameters = p = AXIS.resolve(self.terms, parameters or {})
        self.period = period
        lag, sensor_lag = (p.get(f"{name}.time_constant", 0.0) for name in ("actuator_lag", "sensor_lag"))
        body = Body(total_mass(p) - elastic_mass(p), -math.inf, math.inf, 0.0, lag, sensor_lag, X, TOLERANCE)
        plant_states = (p["temperature_start"], 0.0, 0.0)
        self.simulation = PlantSimulation(
            p, run, Carriage.of(p), body, SampleTimes(p, period, seed), plant_states=plant_states
        )
        step = p.get("quantisation.step", 0.0)
        self._channels = {name: Channel(p, name, seed, step * (name == "position")) for name in SIGNALS}

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.simulation.time

    def step(self, force: float) -> Mapping[str, float]:
        """Hold ``force`` (N) for one sample period; return the measured signals at its end."""
        measured = self._measure(self.simulation.step(force), np.array([force]))
        return {name: float(x[0]) for name, x in measured.items()}

    def simulate(self, force: FloatArray) -> Trajectory:
        """Simulate with forces (n,), N, that are held from each sample to the next; the first is now."""
        u = np.asarray(force, dtype=np.float64)
        rows, t = self.simulation.simulate(u)
        truth = {
            "position": rows[:, X],
            "velocity": rows[:, V],
            "temperature": rows[:, TEMPERATURE],
            "acting_force": rows[:, -1],
        }
        return Trajectory(self.simulation.sample_times.recorded(t), u, self._measure(rows, u), truth)

    def _measure(self, rows: FloatArray, force: FloatArray) -> dict[str, FloatArray]:
        p = self.parameters
        position = rows[:, SENSOR if "sensor_lag.time_constant" in p else X]
        signals = {
            "position": sense(position, p),
            "velocity": rows[:, V],
            "temperature": rows[:, TEMPERATURE],
            "drive_current": rows[:, -1] / p["drive_constant"],
        }
        measured = {name: self._channels[name].sample(x) for name, x in signals.items()}
        return measured | {"drive_voltage": force / p["drive_gain"]}
