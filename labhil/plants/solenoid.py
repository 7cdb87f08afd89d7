"""A simulated solenoid: coil current in, plunger position out; field, spring, friction and two stops."""

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

SIGNALS = ("plunger_position", "coil_current", "magnetic_force")
STROKE = 0.005
FIELD_PARTS = 8
"""Into how many parts a sample period is cut while the field follows the current."""

SOLENOID = World(
    bare={
        "moving_mass": 0.064,  # kg
        "spring_stiffness": 6850.0,  # N/m
        "stop_low": 0.0,  # m
        "stop_high": STROKE,  # m
        "coil_resistance": 4.0,  # Ω
        "coil_inductance": 0.02,  # H
        "plunger_position_noise": 1e-5,  # m
        "coil_current_noise": 0.0,  # A
        "magnetic_force_noise": 0.1,  # N
        "noise_correlation": 0.0,  # of neighbouring samples
        "plunger_position_resolution": 0.0,  # m
        "stamp_jitter": 0.0,  # s
    },
    effects={
        **sized(
            FRICTION,
            {
                "viscous_friction": {"coefficient": 5.0},
                "coulomb_friction": {"level": 2.0},
                "stribeck_friction": {"level": 2.0, "velocity": 0.1},
                "static_friction": {"level": 1.0},
                "quadratic_viscous_friction": {"coefficient": 20.0},
                "cubic_viscous_friction": {"coefficient": 100.0},
                "friction_asymmetry": {"coefficient": 1.0, "level": 0.0},
                "position_dependent_friction": {"slope": 100.0},
            },
        ),
        "presliding_friction": Effect(
            "dry friction carried by bristles", {"stiffness": 2e5, "damping": 20.0}
        ),
        "spring_preload": Effect("a spring that pushes already at rest, N", {"force": 2.0}),
        "spring_hardening": Effect("a spring that stiffens, N/m³", {"coefficient": 5e7}),
        "end_stop_contact": Effect("a plunger that bounces at its stops", {"restitution": 0.4}),
        "eddy_current": Effect("a field that lags behind the current, s", {"time_constant": 0.003}),
        "magnetic_hysteresis": Effect("a field that remembers where the current turned, A", {"width": 0.1}),
        "magnetic_saturation": Effect("iron that saturates, 1/A", {"coefficient": 0.05}),
        "residual_magnetism": Effect("a field that stays without current, A", {"current": 0.08}),
        **sized(
            WAY_IN,
            {
                "time_delay": {"delay": 0.002},
                "dead_zone": {"left": 0.1, "right": 0.1},
                "saturation": {"limit": 2.0},
                "backlash": {"gap": 0.1},
                "actuator_lag": {"time_constant": 0.003},
                "rate_limit": {"rate": 20.0},
            },
        ),
        **sized(
            WAY_OUT,
            {
                "sensor_offset": {"offset": 1e-4},
                "sensor_nonlinearity": {"cubic": 2e3},
                "sensor_lag": {"time_constant": 0.002},
            },
        ),
    },
    positive=frozenset(
        {
            "moving_mass", "spring_stiffness", "coil_resistance", "coil_inductance",
            "stribeck_friction.velocity", "presliding_friction.stiffness", "saturation.limit",
            "rate_limit.rate", "actuator_lag.time_constant", "sensor_lag.time_constant",
            "hidden_latch.width",
        }
    ),
    hidden={
        "hidden_latch": Effect("a latch at one place", {"pull": 3.0, "place": 0.002, "width": 3e-4}),
        "hidden_leak": Effect("oil that is pressed out near the far stop, N·s/m", {"damping": 20.0}),
    },
)  # fmt: skip


class Plunger(NamedTuple):
    """Numbers of the plunger (SI)."""

    mass: float
    spring: float
    hardening: float
    preload: float
    latch: float
    latch_place: float
    latch_width: float
    leak: float
    high: float


@compiled
def magnet_force(i: float, x: float) -> float:
    """Force (N) at field current ``i`` (A) and position ``x`` (m): this project's own stated magnet."""
    y = x / STROKE
    linear = 8.0 + 2.0 * y - 3.0 * y * y
    return i * (linear + i * (12.0 + 1.5 * y - 2.0 * i))


@compiled
def push(x: float, v: float, _: float, u: float, m: Plunger) -> tuple[float, float]:
    """Acceleration without friction, m/s²; there is no inner state."""
    force = magnet_force(u, x) - m.preload - x * (m.spring + m.hardening * x * x)
    if m.latch != 0.0:
        away = (x - m.latch_place) / m.latch_width
        force -= m.latch * away * math.exp(0.5 - 0.5 * away * away)
    if m.leak != 0.0:
        force -= m.leak * v * math.exp((x - m.high) / 5e-4)
    return force / m.mass, 0.0


period_of = periods_for(push)


@compiled
def walk(
    inputs: FloatArray, state: FloatArray, history: FloatArray, newest: int, memory: FloatArray,
    moments: FloatArray, period: float, b: Body, m: Plunger, f: Friction, p: InputPath, out: FloatArray,
) -> None:  # fmt: skip
    """Advance the plant by one period per field current; ``out`` (n, 3): x, v and the current that acts."""
    for k in range(inputs.size):
        newest += 1
        history[newest % HISTORY] = inputs[k]
        period_of(state, history, newest, memory, moments, period, False, b, m, f, p)
        out[k, 0], out[k, 1], out[k, 2] = state[X], state[V], memory[-1]


class SolenoidPlant:
    """The world of one solenoid; it is made of the effects in ``terms`` and of nothing else.

    ``parameters`` overrides defaults by name (SI); ``seed`` fixes the noise; ``period`` is the time (s)
    between samples. Begins at rest at the lower stop, without current.
    """

    def __init__(
        self,
        parameters: Mapping[str, float] | None = None,
        terms: Iterable[str] = (),
        seed: int = 0,
        period: float = 0.001,
    ) -> None:
        self.terms = tuple(terms)
        self.parameters = SOLENOID.resolve(self.terms, parameters or {})
        self.period = period
        self._random = np.random.default_rng(seed)
        self._fine = period / FIELD_PARTS
        self._drive = Drive(self.parameters, self._fine, held=False)
        self._state = np.zeros(STATE_SIZE)
        self._state[X] = self.parameters["stop_low"]
        self._current, self._slope, self._eddy, self._play = 0.0, 0.0, 0.0, 0.0
        self._friction = Friction.of(self.parameters)
        p = self.parameters
        self._sensor = Sensor(p, period, p["stop_low"])
        self._channels = {name: Channel(p, name) for name in SIGNALS}
        self._body = Body(
            p["moving_mass"], p["stop_low"], p["stop_high"], p.get("end_stop_contact.restitution", 0.0), 2e-4
        )
        self._plunger = Plunger(
            p["moving_mass"], p["spring_stiffness"], p.get("spring_hardening.coefficient", 0.0),
            p.get("spring_preload.force", 0.0), p.get("hidden_latch.pull", 0.0),
            p.get("hidden_latch.place", 0.0), p.get("hidden_latch.width", 1.0),
            p.get("hidden_leak.damping", 0.0), p["stop_high"],
        )  # fmt: skip

    def step(self, current: float) -> Mapping[str, float]:
        """Bring the current straight to ``current`` (A) in one sample period; the signals at its end."""
        i = np.array([current])
        slope = (i - self._current) / self.period
        truth = self._walk(i)
        seen = self._measure(truth, self._sensor.follow(truth[:, 0]), i, slope)
        return {name: float(values[0]) for name, values in seen.items()}

    def simulate(self, current: FloatArray) -> Trajectory:
        """Go on through the currents (n,) at the samples, straight in between; begins with now."""
        i = np.asarray(current, dtype=np.float64)
        first = np.array([[self._state[X], self._state[V], self._drive.memory[-1]]])
        slope = np.r_[self._slope, np.diff(i) / self.period]
        shown = self._sensor.now
        self._current = float(i[0])
        moved = self._walk(i[1:])
        truth, position = np.concatenate([first, moved]), np.r_[shown, self._sensor.follow(moved[:, 0])]
        t = self.period * np.arange(len(i))
        jitter = self.parameters["stamp_jitter"] * self._random.standard_normal(len(i))
        names = ("plunger_position", "plunger_velocity", "field_current")
        states = dict(zip(names, truth.T, strict=True))
        return Trajectory(t + jitter, i, self._measure(truth, position, i, slope), states)

    def _walk(self, currents: FloatArray) -> FloatArray:
        """Let one sample period pass per current; x, v and the field's current that acts, (n, 3)."""
        if not len(currents):
            return np.empty((0, 3))
        fine = np.interp(
            np.arange(1, FIELD_PARTS * len(currents) + 1) / FIELD_PARTS,
            np.arange(len(currents) + 1),
            np.concatenate([[self._current], currents]),
        )
        field = self._field(fine)
        out = np.empty((len(fine), 3))
        drive = self._drive
        walk(
            field, self._state, drive.history, drive.newest, drive.memory, drive.moments, self._fine,
            self._body, self._plunger, self._friction, drive.path, out,
        )  # fmt: skip
        drive.newest += len(fine)
        before = currents[-2] if len(currents) > 1 else self._current
        self._current, self._slope = float(currents[-1]), float(currents[-1] - before) / self.period
        return out[FIELD_PARTS - 1 :: FIELD_PARTS]

    def _field(self, current: FloatArray) -> FloatArray:
        """The current (n,) that the field corresponds to."""
        p = self.parameters
        width = p.get("magnetic_hysteresis.width", 0.0)
        lag = p.get("eddy_current.time_constant", 0.0)
        decay = math.exp(-self._fine / lag) if lag else 0.0
        field = np.empty_like(current)
        for k, i in enumerate(current):
            before = self._play
            self._play = min(max(self._play, i - 0.5 * width), i + 0.5 * width)
            trail = (self._play - before) / self._fine * lag
            self._eddy = self._play - trail + (self._eddy - before + trail) * decay
            field[k] = self._eddy
        field += p.get("residual_magnetism.current", 0.0)
        return np.asarray(field / (1.0 + p.get("magnetic_saturation.coefficient", 0.0) * np.abs(field)))

    def _measure(
        self, truth: FloatArray, position: FloatArray, i: FloatArray, slope: FloatArray
    ) -> dict[str, FloatArray]:
        p = self.parameters
        force = np.array([magnet_force(float(a), float(x)) for x, _, a in truth])
        true = {"plunger_position": position, "coil_current": i, "magnetic_force": force}
        seen = {name: self._channels[name].sample(x, self._random) for name, x in true.items()}
        return seen | {"coil_voltage": p["coil_resistance"] * i + p["coil_inductance"] * slope}
