"""A simulated axis: held force in, position out; dry friction by events or on bristles."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.plants.driven import Drive, periods_for
from labhil.plants.effects import Effect
from labhil.plants.friction import Friction
from labhil.plants.input_path import HISTORY, InputPath
from labhil.plants.mover import STATE_SIZE, Body, V, X
from labhil.plants.trajectory import Channel, Sensor, Trajectory
from labhil.plants.world import FRICTION, WAY_IN, WAY_OUT, World, sized
from labhil.signals import FloatArray

AXIS = World(
    bare={
        "moving_mass": 95.0,  # kg
        "drive_gain": 35.15,  # N/V, of the voltage that is told beside the force
        "temperature_start": 25.0,  # °C
        "warming": 0.0,  # K/J of friction heat
        "position_noise": 2e-6,  # m
        "velocity_noise": 1e-3,  # m/s
        "noise_correlation": 0.0,  # of neighbouring samples
        "position_resolution": 0.0,  # m, of an encoder
        "stamp_jitter": 0.0,  # s
    },
    effects={
        **sized(
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
            },
        ),
        "presliding_friction": Effect(
            "dry friction carried by bristles", {"stiffness": 2e6, "damping": 2e3}
        ),
        "temperature_dependent_friction": Effect("viscous friction that falls with warmth", {"rate": 0.02}),
        "constant_force": Effect("a constant push, N", {"force": 3.2}),
        "spring_force": Effect("a spring towards zero, N/m", {"stiffness": 100.0}),
        "spring_hardening": Effect("a spring that stiffens, N/m³", {"coefficient": 1000.0}),
        "cogging_torque": Effect(
            "a force that repeats along the way", {"amplitude": 3.0, "order": 314.0, "phase": 0.0}
        ),
        "added_inertia": Effect("a load on the carriage, kg", {"mass": 10.0}),
        **sized(
            WAY_IN,
            {
                "time_delay": {"delay": 0.004},
                "dead_zone": {"left": 5.0, "right": 5.0},
                "saturation": {"limit": 100.0},
                "backlash": {"gap": 10.0},
                "actuator_lag": {"time_constant": 0.005},
                "rate_limit": {"rate": 5000.0},
            },
        ),
        **sized(
            WAY_OUT,
            {"sensor_offset": {"offset": 0.001}, "sensor_nonlinearity": {"cubic": 0.1}},
        ),
    },
    positive=frozenset(
        {
            "moving_mass", "drive_gain", "stribeck_friction.velocity", "presliding_friction.stiffness",
            "saturation.limit", "rate_limit.rate", "actuator_lag.time_constant", "sensor_lag.time_constant",
            "hidden_magnet.width",
        }
    ),
    hidden={
        "hidden_magnet": Effect("a magnet under the way that pulls", {"pull": 10.0, "width": 0.02}),
        "hidden_cable": Effect("a cable that pulls beyond a place, N/m", {"stiffness": 200.0, "from": 0.05}),
    },
)  # fmt: skip


class Carriage(NamedTuple):
    """Numbers of the axis over its mass (SI)."""

    inverse_mass: float
    force: float
    spring: float
    hardening: float
    cogging: float
    order: float
    phase: float
    magnet: float
    magnet_width: float
    cable: float
    cable_from: float


@compiled
def push(x: float, v: float, _: float, u: float, m: Carriage) -> tuple[float, float]:
    """Acceleration without friction, m/s²; there is no inner state."""
    a = u * m.inverse_mass + m.force - x * (m.spring + m.hardening * x * x)
    a -= m.cogging * math.sin(m.order * x + m.phase)
    if m.magnet != 0.0:
        away = x / m.magnet_width
        a -= m.magnet * away * math.exp(0.5 - 0.5 * away * away)
    if m.cable != 0.0 and x > m.cable_from:
        a -= m.cable * (x - m.cable_from)
    return a, 0.0


period_of = periods_for(push)


@compiled
def walk(
    inputs: FloatArray, state: FloatArray, history: FloatArray, newest: int, memory: FloatArray,
    moments: FloatArray, period: float, heat: FloatArray, warming: float, rate: float,
    b: Body, m: Carriage, f: Friction, p: InputPath, out: FloatArray,
) -> None:  # fmt: skip
    """Advance the plant by one sample period per input; ``out`` (n, 3) gets x, v and temperature.

    ``heat`` (2,) is the temperature and the one at which viscous friction is what it is said to be.
    """
    for k in range(inputs.size):
        newest += 1
        history[newest % HISTORY] = inputs[k]
        g = Friction(
            f.viscous * math.exp(-rate * (heat[0] - heat[1])), f.quadratic, f.cubic, f.asymmetric, f.coulomb,
            f.stribeck, f.stribeck_velocity, f.static, f.asymmetric_level, f.slope, f.stiffness, f.damping,
        )  # fmt: skip
        period_of(state, history, newest, memory, moments, period, True, b, m, g, p)
        speed = abs(state[V])
        heat[0] += period * warming * speed * (g.coulomb + g.viscous * speed)
        out[k, 0], out[k, 1], out[k, 2] = state[X], state[V], heat[0]


class AxisPlant:
    """The world of one axis; it is made of the effects in ``terms`` and of nothing else.

    ``parameters`` overrides defaults by name (SI); ``seed`` fixes the noise; ``period`` is the time (s)
    between samples. Begins at rest at position zero.
    """

    def __init__(
        self,
        parameters: Mapping[str, float] | None = None,
        terms: Iterable[str] = (),
        seed: int = 0,
        period: float = 0.001,
    ) -> None:
        self.terms = tuple(terms)
        self.parameters = AXIS.resolve(self.terms, parameters or {})
        self.period = period
        self._random = np.random.default_rng(seed)
        self._drive = Drive(self.parameters, period, held=True)
        self._state = np.zeros(STATE_SIZE)
        start = self.parameters["temperature_start"]
        self._heat = np.array([start, start])
        self._friction = Friction.of(self.parameters)
        self._sensor = Sensor(self.parameters, period, 0.0)
        self._channels = {name: Channel(self.parameters, name) for name in ("position", "velocity")}
        mass = self.parameters["moving_mass"] + self.parameters.get("added_inertia.mass", 0.0)
        self._body = Body(mass, -np.inf, np.inf, 0.0, 1e-3)
        self._carriage = self._numbers(mass)

    def _numbers(self, mass: float) -> Carriage:
        p = self.parameters
        return Carriage(
            inverse_mass=1.0 / mass,
            force=p.get("constant_force.force", 0.0) / mass,
            spring=p.get("spring_force.stiffness", 0.0) / mass,
            hardening=p.get("spring_hardening.coefficient", 0.0) / mass,
            cogging=p.get("cogging_torque.amplitude", 0.0) / mass,
            order=p.get("cogging_torque.order", 1.0),
            phase=p.get("cogging_torque.phase", 0.0),
            magnet=p.get("hidden_magnet.pull", 0.0) / mass,
            magnet_width=p.get("hidden_magnet.width", 1.0),
            cable=p.get("hidden_cable.stiffness", 0.0) / mass,
            cable_from=p.get("hidden_cable.from", 0.0),
        )

    def step(self, force: float) -> Mapping[str, float]:
        """Hold ``force`` (N) for one sample period; return the signals at its end, measured."""
        truth = self._walk(np.array([force]))
        seen = self._measure(truth, self._sensor.follow(truth[:, 0]), np.array([force]))
        return {name: float(values[0]) for name, values in seen.items()}

    def simulate(self, force: FloatArray) -> Trajectory:
        """Go on through the forces (n,) that are held from each sample to the next; begins with now."""
        u = np.asarray(force, dtype=np.float64)
        first = np.array([[self._state[X], self._state[V], self._heat[0]]])
        shown = self._sensor.now
        moved = self._walk(u[:-1])
        truth, position = np.concatenate([first, moved]), np.r_[shown, self._sensor.follow(moved[:, 0])]
        t = self.period * np.arange(len(u))
        jitter = self.parameters["stamp_jitter"] * self._random.standard_normal(len(u))
        states = dict(zip(("position", "velocity", "temperature"), truth.T, strict=True))
        return Trajectory(t + jitter, u, self._measure(truth, position, u), states)

    def _walk(self, inputs: FloatArray) -> FloatArray:
        """Let one sample period pass per force that is held in it; x, v, temperature (n, 3)."""
        p, drive = self.parameters, self._drive
        out = np.empty((len(inputs), 3))
        drive.history[drive.newest % HISTORY] = inputs[0] if len(inputs) else 0.0
        walk(
            np.append(inputs[1:], inputs[-1:]), self._state, drive.history, drive.newest, drive.memory,
            drive.moments, self.period, self._heat, p["warming"],
            p.get("temperature_dependent_friction.rate", 0.0), self._body, self._carriage, self._friction,
            drive.path, out,
        )  # fmt: skip
        drive.newest += len(inputs)
        return out

    def _measure(self, truth: FloatArray, position: FloatArray, force: FloatArray) -> dict[str, FloatArray]:
        return {
            "position": self._channels["position"].sample(position, self._random),
            "velocity": self._channels["velocity"].sample(truth[:, 1], self._random),
            "temperature": truth[:, 2],
            "drive_voltage": force / self.parameters["drive_gain"],
        }
