"""A simulated DC motor: held voltage in; speed, current, angle and the winding's temperature out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.plants.driven import TOLERANCE, Drive, kernel_for
from labhil.plants.effects import Effect
from labhil.plants.friction import Friction
from labhil.plants.input_path import InputPath
from labhil.plants.mover import INNER, SENSOR, Body, V, Work, X
from labhil.plants.trajectory import Channel, Stamps, Trajectory, sensed
from labhil.plants.world import FRICTION, POSITIVE, SAMPLING, WAY_IN, WAY_OUT, World, sized
from labhil.signals import FloatArray, IntArray

SIGNALS = ("speed", "current", "angle", "winding_temperature")
COPPER = 0.0039
BRUSH_CURRENT = 0.01
"""Current (A) over which the brushes' drop changes its sign."""
CURRENT, WARMTH = INNER, INNER + 1

MOTOR = World(
    bare={
        "inertia": 0.1,  # kg·m²
        "torque_constant": 0.2,  # N·m/A
        "resistance": 1.5,  # Ω
        "inductance": 0.1,  # H
        "heat_capacity": 60.0,  # J/K, of the winding
        "heat_resistance": 4.0,  # K/W, from the winding to the air
        "ambient": 25.0,  # °C, where the winding begins
        "reference_temperature": 25.0,  # °C, at which resistance and viscous friction are what is said
        "speed_noise": 0.03,  # rad/s
        "current_noise": 0.03,  # A
        "angle_noise": 0.0,  # rad
        "winding_temperature_noise": 0.05,  # K
        "speed_resolution": 0.0,  # rad/s, of an encoder
        "current_resolution": 0.0,  # A
        "angle_resolution": 0.0,  # rad
        **SAMPLING,
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
                "load_dependent_friction": {"coefficient": 0.1},
                "presliding_friction": {"stiffness": 40.0, "damping": 0.2},
                "maxwell_slip_friction": {"stiffness": 40.0, "damping": 0.2, "attraction": 20.0},
            },
        ),
        "temperature_dependent_friction": Effect("viscous friction that falls with warmth", {"rate": 0.02}),
        "constant_force": Effect("a constant load torque, N·m", {"force": 0.05}),
        "cogging_torque": Effect(
            "a torque that repeats with the angle, with a second harmonic, N·m",
            {"amplitude": 0.05, "order": 12.0, "phase": 0.0, "second": 0.0},
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
        **sized(
            WAY_OUT,
            {
                "sensor_gain": {"current_gain": 0.0},
                "sensor_offset": {"offset": 0.05, "current_offset": 0.0},
                "sensor_nonlinearity": {"cubic": 0.01},
                "quantisation": {"step": 0.05},
            },
        ),
    },
    positive=POSITIVE
    | {
        "inertia", "torque_constant", "resistance", "inductance", "heat_capacity", "heat_resistance",
        "hidden_magnet.width", "hidden_drag.speed", "hidden_sticky_patch.width",
    },
    hidden={
        "hidden_magnet": Effect("a magnet that grips the rotor at one angle", {"pull": 0.1, "width": 0.3}),
        "hidden_drag": Effect("a loose cable that drags at low speed only", {"level": 0.05, "speed": 0.5}),
        "hidden_sticky_patch": Effect(
            "a place on every turn that rubs harder", {"level": 0.1, "place": 1.0, "width": 0.4}
        ),
    },
)  # fmt: skip


class Motor(NamedTuple):
    """Numbers of the motor (SI)."""

    constant: float
    resistance: float
    copper: float
    inductance: float
    capacity: float
    to_air: float
    ambient: float
    reference: float
    thinning: float
    load: float
    load_share: float
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
    patch_place: float
    patch_width: float

    @classmethod
    def of(cls, p: Mapping[str, float]) -> Motor:
        """Pick them out of a plant's parameters."""
        return cls(
            constant=p["torque_constant"],
            resistance=p["resistance"],
            copper=p.get("thermal_resistance.coefficient", 0.0),
            inductance=p["inductance"],
            capacity=p["heat_capacity"],
            to_air=p["heat_resistance"],
            ambient=p["ambient"],
            reference=p["reference_temperature"],
            thinning=p.get("temperature_dependent_friction.rate", 0.0),
            load=p.get("constant_force.force", 0.0),
            load_share=p.get("load_dependent_friction.coefficient", 0.0),
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
            patch_place=p.get("hidden_sticky_patch.place", 0.0),
            patch_width=p.get("hidden_sticky_patch.width", 1.0),
        )


@compiled
def away_from(angle: float, place: float) -> float:
    """How far an angle is from a place on the turn, −π … π."""
    return (angle - place + math.pi) % (2.0 * math.pi) - math.pi


@compiled
def torque_of(s: FloatArray, m: Motor) -> float:
    """Torque on the rotor by all but friction, N·m."""
    angle, w = s[X], s[V]
    torque = m.constant * s[CURRENT] - m.load - m.spring * angle
    if m.cogging != 0.0 or m.second != 0.0:
        turned = m.order * angle + m.phase
        torque -= m.cogging * math.sin(turned) + m.second * math.sin(2.0 * turned)
    if m.magnet != 0.0:
        away = away_from(angle, 0.0) / m.magnet_width
        torque -= m.magnet * away * math.exp(0.5 - 0.5 * away * away)
    if m.drag != 0.0:
        torque -= m.drag * w / m.drag_speed * math.exp(1.0 - abs(w) / m.drag_speed)
    return torque


@compiled
def push(s: FloatArray, u: float, m: Motor, rates: FloatArray) -> tuple[float, float, float]:
    """Torque without friction, further dry friction (N·m), and what is left of viscous friction.

    L·di/dt = U − R·i − K·ω − brushes; C·dT/dt = R·i² − (T − T_air)/R_th.
    """
    i, warmth = s[CURRENT], s[WARMTH] - m.reference
    resistance = m.resistance * (1.0 + m.copper * warmth)
    supplied = u * (1.0 - m.sag * abs(u))
    drop = m.brush * math.tanh(i / BRUSH_CURRENT) if m.brush != 0.0 else 0.0
    rates[CURRENT] = (supplied - resistance * i - m.constant * s[V] - drop) / m.inductance
    rates[WARMTH] = (resistance * i * i - (s[WARMTH] - m.ambient) / m.to_air) / m.capacity
    rubs = m.load_share * abs(m.constant * i)
    if m.patch != 0.0:
        away = away_from(s[X], m.patch_place) / m.patch_width
        rubs += m.patch * math.exp(-0.5 * away * away)
    return torque_of(s, m), rubs, math.exp(-m.thinning * warmth) if m.thinning != 0.0 else 1.0


@compiled
def remember(s: FloatArray, u: float, m: Motor) -> None:
    """A motor keeps nothing beside its states."""


run_motor = kernel_for(push, remember, __name__)


@compiled
def run(
    inputs: FloatArray, ends: FloatArray, clock: FloatArray, times: FloatArray, values: FloatArray,
    count: IntArray, memory: FloatArray, held: bool, s: FloatArray, mode: FloatArray,
    b: Body, m: Motor, f: Friction, p: InputPath, w: Work, out: FloatArray,
) -> None:  # fmt: skip
    """See :func:`labhil.plants.driven.run`."""
    run_motor(inputs, ends, clock, times, values, count, memory, held, s, mode, b, m, f, p, w, out)


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
        self.parameters = p = MOTOR.resolve(self.terms, parameters or {})
        self.period = period
        inertia = p["inertia"] + p.get("added_inertia.mass", 0.0)
        lag, sensor_lag = (p.get(f"{name}.time_constant", 0.0) for name in ("actuator_lag", "sensor_lag"))
        body = Body(inertia, -math.inf, math.inf, 0.0, lag, sensor_lag, V, TOLERANCE)
        stamps = Stamps(p, period, seed)
        self.drive = Drive(p, run, Motor.of(p), body, stamps, inner=(0.0, p["ambient"]))
        step = p.get("quantisation.step", 0.0)
        self._channels = {name: Channel(p, name, seed, step * (name == "speed")) for name in SIGNALS}

    def step(self, voltage: float) -> Mapping[str, float]:
        """Hold ``voltage`` (V) for one sample period; return the signals at its end, measured."""
        return {name: float(x[0]) for name, x in self._measure(self.drive.step(voltage)).items()}

    def simulate(self, voltage: FloatArray) -> Trajectory:
        """Go on through the voltages (n,) that are held from each sample to the next; begins with now."""
        u = np.asarray(voltage, dtype=np.float64)
        rows, t = self.drive.follow(u)
        columns = (V, CURRENT, X, WARMTH, -1)
        truth = dict(zip((*SIGNALS, "terminal_voltage"), rows.T[list(columns)], strict=True))
        return Trajectory(self.drive.stamps.seen(t), u, self._measure(rows), truth)

    def _measure(self, rows: FloatArray) -> dict[str, FloatArray]:
        p = self.parameters
        speed = rows[:, SENSOR if "sensor_lag.time_constant" in p else V]
        true = {
            "speed": sensed(speed, p),
            "current": sensed(rows[:, CURRENT], p, "current_"),
            "angle": rows[:, X],
            "winding_temperature": rows[:, WARMTH],
        }
        return {name: self._channels[name].sample(x) for name, x in true.items()}
