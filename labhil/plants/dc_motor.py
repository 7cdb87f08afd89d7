"""A simulated DC motor: held voltage in; speed, current, angle and the winding's temperature out."""

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
from labhil.plants.mover import INNER, STATE_SIZE, Body, V, X
from labhil.plants.trajectory import Channel, Sensor, Trajectory
from labhil.plants.world import FRICTION, WAY_IN, WAY_OUT, World, sized
from labhil.signals import FloatArray

SIGNALS = ("speed", "current", "angle", "winding_temperature")
COPPER = 0.0039
BRUSH_CURRENT = 0.01
"""Current (A) over which the brushes' drop changes its sign."""

MOTOR = World(
    bare={
        "inertia": 0.1,  # kg·m²
        "torque_constant": 0.2,  # N·m/A
        "resistance": 1.5,  # Ω
        "inductance": 0.1,  # H
        "heat_capacity": 60.0,  # J/K, of the winding
        "heat_resistance": 4.0,  # K/W, from the winding to the air
        "ambient": 25.0,  # °C
        "speed_noise": 0.03,  # rad/s
        "current_noise": 0.03,  # A
        "angle_noise": 0.0,  # rad
        "winding_temperature_noise": 0.05,  # K
        "noise_correlation": 0.0,  # of neighbouring samples
        "speed_resolution": 0.0,  # rad/s, of an encoder
        "current_resolution": 0.0,  # A
        "stamp_jitter": 0.0,  # s, standard deviation of the stamps beside the samples' true times
    },
    effects={
        **sized(
            FRICTION,
            {
                "viscous_friction": {"coefficient": 0.05},
                "coulomb_friction": {"level": 0.2},
                "stribeck_friction": {"level": -0.1, "velocity": 0.01},
                "static_friction": {"level": 0.1},
                "quadratic_viscous_friction": {"coefficient": 0.05},
                "cubic_viscous_friction": {"coefficient": 0.02},
                "friction_asymmetry": {"coefficient": 0.02, "level": 0.0},
                "position_dependent_friction": {"slope": 0.005},
            },
        ),
        "presliding_friction": Effect(
            "dry friction carried by bristles", {"stiffness": 40.0, "damping": 0.2}
        ),
        "temperature_dependent_friction": Effect("viscous friction that falls with warmth", {"rate": 0.02}),
        "constant_force": Effect("a constant load torque, N·m", {"force": 0.05}),
        "cogging_torque": Effect(
            "a torque that repeats with the angle", {"amplitude": 0.05, "order": 12.0, "phase": 0.0}
        ),
        "spring_force": Effect("a torsion spring, N·m/rad", {"stiffness": 0.02}),
        "added_inertia": Effect("inertia on the shaft, kg·m²", {"mass": 0.02}),
        "brush_drop": Effect("a voltage that the brushes take, V", {"voltage": 0.3}),
        "supply_sag": Effect("a supply that gives way, 1/V", {"coefficient": 0.02}),
        "thermal_resistance": Effect("resistance that rises with warmth, 1/K", {"coefficient": COPPER}),
        **sized(
            WAY_IN,
            {
                "dead_zone": {"left": 0.4, "right": 0.5},
                "saturation": {"limit": 4.0},
                "backlash": {"gap": 0.5},
                "rate_limit": {"rate": 60.0},
            },
        ),
        **sized(WAY_OUT, {"sensor_offset": {"offset": 0.05}, "sensor_nonlinearity": {"cubic": 0.01}}),
    },
    positive=frozenset(
        {
            "inertia", "torque_constant", "resistance", "inductance", "heat_capacity", "heat_resistance",
            "stribeck_friction.velocity", "presliding_friction.stiffness", "saturation.limit",
            "rate_limit.rate", "actuator_lag.time_constant", "sensor_lag.time_constant",
            "hidden_magnet.width", "hidden_drag.speed",
        }
    ),
    hidden={
        "hidden_magnet": Effect("a magnet that grips the rotor at one angle", {"pull": 0.1, "width": 0.3}),
        "hidden_drag": Effect("a loose cable that drags at low speed only", {"level": 0.05, "speed": 0.5}),
    },
)  # fmt: skip


class Motor(NamedTuple):
    """Numbers of the motor (SI)."""

    inertia: float
    constant: float
    resistance: float
    inductance: float
    load: float
    cogging: float
    order: float
    phase: float
    spring: float
    brush: float
    sag: float
    magnet: float
    magnet_width: float
    drag: float
    drag_speed: float


@compiled
def push(angle: float, w: float, i: float, u: float, m: Motor) -> tuple[float, float]:
    """Angular acceleration without friction, rad/s², and di/dt, A/s."""
    torque = m.constant * i - m.load - m.spring * angle
    torque -= m.cogging * math.sin(m.order * angle + m.phase)
    if m.magnet != 0.0:
        away = ((angle + math.pi) % (2.0 * math.pi) - math.pi) / m.magnet_width
        torque -= m.magnet * away * math.exp(0.5 - 0.5 * away * away)
    if m.drag != 0.0:
        torque -= m.drag * w / m.drag_speed * math.exp(1.0 - abs(w) / m.drag_speed)
    supplied = u * (1.0 - m.sag * abs(u))
    drop = m.brush * math.tanh(i / BRUSH_CURRENT)
    return torque / m.inertia, (supplied - m.resistance * i - m.constant * w - drop) / m.inductance


period_of = periods_for(push)


@compiled
def walk(
    inputs: FloatArray, state: FloatArray, history: FloatArray, newest: int, memory: FloatArray,
    moments: FloatArray, period: float, heat: FloatArray, thermal: FloatArray, rate: float,
    b: Body, m: Motor, f: Friction, p: InputPath, out: FloatArray,
) -> None:  # fmt: skip
    """Advance the plant by one sample period per input; ``out`` (n, 4) gets ω, i, angle, temperature.

    ``heat`` (1,) is the winding's temperature; ``thermal`` holds heat capacity, heat resistance, ambient
    and the resistance's coefficient; viscous friction falls with exp(−rate·ΔT).
    """
    for k in range(inputs.size):
        newest += 1
        history[newest % HISTORY] = inputs[k]
        warmth = heat[0] - thermal[2]
        now = Motor(
            m.inertia, m.constant, m.resistance * (1.0 + thermal[3] * warmth), m.inductance, m.load,
            m.cogging, m.order, m.phase, m.spring, m.brush, m.sag, m.magnet, m.magnet_width,
            m.drag, m.drag_speed,
        )  # fmt: skip
        g = Friction(
            f.viscous * math.exp(-rate * warmth), f.quadratic, f.cubic, f.asymmetric, f.coulomb, f.stribeck,
            f.stribeck_velocity, f.static, f.asymmetric_level, f.slope, f.stiffness, f.damping,
        )  # fmt: skip
        period_of(state, history, newest, memory, moments, period, True, b, now, g, p)
        loss = now.resistance * state[INNER] ** 2
        heat[0] += period * (loss - (heat[0] - thermal[2]) / thermal[1]) / thermal[0]
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = state[V], state[INNER], state[X], heat[0]


class DcMotorPlant:
    """The world of one motor; it is made of the effects in ``terms`` and of nothing else.

    ``parameters`` overrides defaults by name (SI); ``seed`` fixes the noise; ``period`` is the time (s)
    between samples. Begins at rest without current, at ambient temperature.
    """

    def __init__(
        self,
        parameters: Mapping[str, float] | None = None,
        terms: Iterable[str] = (),
        seed: int = 0,
        period: float = 0.01,
    ) -> None:
        self.terms = tuple(terms)
        self.parameters = MOTOR.resolve(self.terms, parameters or {})
        self.period = period
        self._random = np.random.default_rng(seed)
        self._drive = Drive(self.parameters, period, held=True)
        self._state = np.zeros(STATE_SIZE)
        self._heat = np.array([self.parameters["ambient"]])
        self._friction = Friction.of(self.parameters)
        self._motor = self._numbers()
        self._sensor = Sensor(self.parameters, period, 0.0)
        self._channels = {name: Channel(self.parameters, name) for name in SIGNALS}
        self._body = Body(self._motor.inertia, -np.inf, np.inf, 0.0, self._longest())

    def _numbers(self) -> Motor:
        p = self.parameters
        return Motor(
            inertia=p["inertia"] + p.get("added_inertia.mass", 0.0),
            constant=p["torque_constant"],
            resistance=p["resistance"],
            inductance=p["inductance"],
            load=p.get("constant_force.force", 0.0),
            cogging=p.get("cogging_torque.amplitude", 0.0),
            order=p.get("cogging_torque.order", 1.0),
            phase=p.get("cogging_torque.phase", 0.0),
            spring=p.get("spring_force.stiffness", 0.0),
            brush=p.get("brush_drop.voltage", 0.0),
            sag=p.get("supply_sag.coefficient", 0.0),
            magnet=p.get("hidden_magnet.pull", 0.0),
            magnet_width=p.get("hidden_magnet.width", 1.0),
            drag=p.get("hidden_drag.level", 0.0),
            drag_speed=p.get("hidden_drag.speed", 1.0),
        )

    def _longest(self) -> float:
        """Longest step, s: short against the winding's time constant, also where the brushes shorten it."""
        m = self._motor
        with_brushes = m.inductance / (m.resistance + abs(m.brush) / BRUSH_CURRENT)
        return min(2e-3, 0.1 * m.inductance / m.resistance, with_brushes)

    def step(self, voltage: float) -> Mapping[str, float]:
        """Hold ``voltage`` (V) for one sample period; return the signals at its end, measured."""
        truth = self._walk(np.array([voltage]))
        seen = self._measure(truth, self._sensor.follow(truth[:, 0]))
        return {name: float(values[0]) for name, values in seen.items()}

    def simulate(self, voltage: FloatArray) -> Trajectory:
        """Go on through the voltages (n,) that are held from each sample to the next; begins with now."""
        u = np.asarray(voltage, dtype=np.float64)
        first = np.array([[self._state[V], self._state[INNER], self._state[X], self._heat[0]]])
        shown = self._sensor.now
        moved = self._walk(u[:-1])
        truth, speed = np.concatenate([first, moved]), np.r_[shown, self._sensor.follow(moved[:, 0])]
        t = self.period * np.arange(len(u))
        jitter = self.parameters["stamp_jitter"] * self._random.standard_normal(len(u))
        states = dict(zip(SIGNALS, truth.T, strict=True))
        return Trajectory(t + jitter, u, self._measure(truth, speed), states)

    def _walk(self, inputs: FloatArray) -> FloatArray:
        """Let one sample period pass per voltage that is held in it; ω, i, angle, temperature (n, 4)."""
        p, drive = self.parameters, self._drive
        thermal = np.array(
            [
                p["heat_capacity"],
                p["heat_resistance"],
                p["ambient"],
                p.get("thermal_resistance.coefficient", 0.0),
            ]
        )
        out = np.empty((len(inputs), 4))
        # a held command acts from its own sample on: it is the one before the newest at the period's end
        drive.history[drive.newest % HISTORY] = inputs[0] if len(inputs) else 0.0
        following = np.append(inputs[1:], inputs[-1:])
        walk(
            following, self._state, drive.history, drive.newest, drive.memory, drive.moments, self.period,
            self._heat, thermal, p.get("temperature_dependent_friction.rate", 0.0), self._body, self._motor,
            self._friction, drive.path, out,
        )  # fmt: skip
        drive.newest += len(inputs)
        return out

    def _measure(self, truth: FloatArray, speed: FloatArray) -> dict[str, FloatArray]:
        columns = (speed, *truth.T[1:])
        return {
            name: self._channels[name].sample(x, self._random)
            for name, x in zip(SIGNALS, columns, strict=True)
        }
