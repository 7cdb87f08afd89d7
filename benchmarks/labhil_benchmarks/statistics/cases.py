"""The benchmark's cases: a plant with known parameters and an experiment that a user would make with it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from labhil.kinds import KINDS
from labhil.physics.record import Record
from labhil.plants.ball_beam import BallBeamPlant
from labhil.plants.rigs import plant_of
from labhil.signals import FloatArray
from labhil_benchmarks.statistics import arm
from labhil_benchmarks.statistics.noise import noise_like
from labhil_benchmarks.statistics.trial import Case, Simulated

BALL_BEAM_TRUTH: Mapping[str, float] = {
    "viscous_friction.coefficient": 0.26,
    "coulomb_friction.level": 0.09,
    "stribeck_friction.level": 0.06,
    "stribeck_friction.velocity": 0.02,
}
BALL_BEAM_RIG = """
[rig]
kind = "ball_beam"
[known]
ball_mass = 0.261
ball_radius = 0.02
crank_radius = 0.08
beam_length = 0.40
"""


STEP = 0.5 / 1024
"""Step of the ball-and-beam bench's converter, m: 10 bits over half a metre."""


def held_ball(
    terms: tuple[str, ...], parameters: Mapping[str, float], noise: FloatArray, phase: float
) -> Record:
    """Two sines on a ball and beam with the stabilising controller, sample by sample.

    ``noise`` (n,) m is added before the converter; ``phase`` (rad) sets the second sine.
    """
    plant = BallBeamPlant({**parameters, "position_noise": 0.0}, terms)
    n = len(noise)
    t: FloatArray = plant.period * np.arange(n, dtype=np.float64)
    excitation = 0.6 * (np.sin(2 * np.pi * 0.23 * t) + np.sin(2 * np.pi * 0.31 * t + phase))
    u, y, slope = np.zeros(n), np.zeros(n), 0.0
    y[0] = STEP * np.rint((plant.position + noise[0]) / STEP)
    forget = np.exp(-plant.period / 0.03)
    for i in range(1, n):
        wanted = excitation[i - 1] - 7.0 * y[i - 1] - 3.0 * slope
        u[i] = np.clip(wanted, max(u[i - 1] - 0.12, -1.2), min(u[i - 1] + 0.12, 1.2))
        plant.step(u[i])
        y[i] = STEP * np.rint((plant.position + noise[i]) / STEP)
        slope = forget * slope + (1.0 - forget) * (y[i] - y[i - 1]) / plant.period
    return Record(t, u[:, None], y[:, None], ("servo_angle",), ("ball_position",), ("m",))


def ball_beam(seed: int, coloured: bool) -> Simulated:
    """Half a minute on a beam with dry friction, and as much to test on."""
    random = np.random.default_rng([seed, coloured])
    terms = ("viscous_friction", "coulomb_friction", "stribeck_friction")
    record, test = (
        held_ball(terms, BALL_BEAM_TRUTH, noise_like(n, 4e-4, coloured, random), random.uniform(0.0, 6.28))
        for n in (3000, 3000)
    )
    return Simulated(record, test, np.array([np.hypot(4e-4, STEP / np.sqrt(12.0))]))


MOTOR_TRUTH: Mapping[str, float] = {
    "inertia": 0.1,
    "torque_constant": 0.2,
    "inductance": 0.1,
    "resistance": 1.5,
    "viscous_friction.coefficient": 0.05,
    "coulomb_friction.level": 0.2,
    "stribeck_friction.level": -0.1,
    "stribeck_friction.velocity": 0.01,
    "quadratic_viscous_friction.coefficient": 0.05,
    "cubic_viscous_friction.coefficient": 0.02,
}
"""Case two of the reference text (its T_s of 0.1 and T_c of 0.2 make a Stribeck level of −0.1 N·m)."""

MOTOR_TERMS = (
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "quadratic_viscous_friction",
    "cubic_viscous_friction",
)
FROM_SPEED_TERMS = MOTOR_TERMS[:2]
FROM_SPEED_TRUTH = {
    key: value for key, value in MOTOR_TRUTH.items() if key.split(".")[0] not in MOTOR_TERMS[2:]
}
FROM_SPEED_UNKNOWN = tuple(key for key in FROM_SPEED_TRUTH if key != "torque_constant")
AXIS_TRUTH: Mapping[str, float] = {
    "moving_mass": 95.0,
    "viscous_friction.coefficient": 204.0,
    "coulomb_friction.level": 20.4,
    "constant_force.force": -3.2,
}
SOLENOID_TRUTH: Mapping[str, float] = {
    "moving_mass": 0.064,
    "spring_stiffness": 6850.0,
    "viscous_friction.coefficient": 5.0,
    "coulomb_friction.level": 2.0,
    "stribeck_friction.level": 2.0,
    "stribeck_friction.velocity": 0.1,
}
SOLENOID_TERMS = ("viscous_friction", "coulomb_friction", "stribeck_friction")


def levels(n: int, dwell: int, reach: float, random: np.random.Generator) -> FloatArray:
    """A pseudo-random multilevel sequence (n,) between ± ``reach``, each level held for ``dwell`` samples."""
    return np.repeat(random.uniform(-reach, reach, -(-n // dwell)), dwell)[:n]


def driven(
    kind: str,
    inputs: FloatArray,
    period: float,
    parameters: Mapping[str, float],
    terms: tuple[str, ...],
    decibels: float,
    coloured: bool,
    random: np.random.Generator,
    channels: tuple[tuple[str, str], ...],
) -> tuple[Record, FloatArray]:
    """A record of a plant that ``inputs`` (n,) drive, with noise so many dB of power under each channel."""
    silent = {f"{name}_noise": 0.0 for name, _ in channels}
    trajectory = plant_of(kind, {**parameters, **silent}, terms, 0, period).simulate(inputs)
    clean = np.column_stack([trajectory.measured[name] for name, _ in channels])
    noise = clean.std(axis=0) * 10.0 ** (-decibels / 20.0)
    added = np.column_stack([noise_like(len(clean), s, coloured, random) for s in noise])
    names = tuple(name for name, _ in channels)
    units = tuple(unit for _, unit in channels)
    signal = KINDS[kind].inputs[0]
    record = Record(
        trajectory.t, inputs[:, None], clean + added, (signal.name,), names, units, (signal.hold,)
    )
    return record, np.asarray(noise)


def motor(seed: int, coloured: bool) -> Simulated:
    """Twenty seconds of voltage levels within ± 5 V, 28 dB, speed and current."""
    return _motor(seed, coloured, 2000, MOTOR_TERMS, (("speed", "rad/s"), ("current", "A")))


def motor_from_speed(seed: int, coloured: bool) -> Simulated:
    """Twelve seconds of the same with the speed alone, of a motor with the simplest friction."""
    return _motor(seed, coloured, 1200, FROM_SPEED_TERMS, (("speed", "rad/s"),))


def _motor(
    seed: int, coloured: bool, samples: int, terms: tuple[str, ...], channels: tuple[tuple[str, str], ...]
) -> Simulated:
    random = np.random.default_rng([seed, coloured])
    (record, noise), (test, _) = (
        driven("dc_motor", levels(n, 50, 5.0, random), 0.01, {}, terms, 28.0, coloured, random, channels)
        for n in (samples, 1000)
    )
    return Simulated(record, test, noise)


def axis(seed: int, coloured: bool) -> Simulated:
    """Ten seconds of force levels within ± 80 N at 200 Hz, 60 dB (an encoder is precise)."""
    random = np.random.default_rng([seed, coloured])
    terms = ("viscous_friction", "coulomb_friction", "constant_force")
    values = {"constant_force.force": -3.2}
    channels = (("position", "m"),)
    (record, noise), (test, _) = (
        driven("axis", levels(n, 60, 80.0, random), 0.005, values, terms, 60.0, coloured, random, channels)
        for n in (2000, 1000)
    )
    return Simulated(record, test, noise)


def solenoid(seed: int, coloured: bool) -> Simulated:
    """Two seconds of two sines (1 and 4 Hz, as in the text) at 1 kHz, 25 dB, clear of the stops."""
    random = np.random.default_rng([seed, coloured])
    channels = (("plunger_position", "m"),)
    records = []
    for n in (2000, 2000):
        t = 0.001 * np.arange(n)
        a, b = random.uniform(0.0, 2.0 * np.pi, 2)
        current = 1.0 + 0.33 * np.sin(2.0 * np.pi * t + a) + 0.2 * np.sin(8.0 * np.pi * t + b)
        records.append(
            driven("solenoid", current, 0.001, {}, SOLENOID_TERMS, 25.0, coloured, random, channels)
        )
    return Simulated(records[0][0], records[1][0], records[0][1])


CASES: Mapping[str, Case] = {
    case.name: case
    for case in (
        Case(
            "ball_beam",
            BALL_BEAM_RIG,
            ("viscous_friction", "coulomb_friction", "stribeck_friction"),
            ("quadratic_viscous_friction", "constant_force", "time_delay"),
            BALL_BEAM_TRUTH,
            ball_beam,
        ),
        Case(
            "dc_motor",
            '[rig]\nkind = "dc_motor"\n',
            MOTOR_TERMS,
            ("constant_force", "time_delay", "brush_drop"),
            MOTOR_TRUTH,
            motor,
        ),
        Case(
            "dc_motor_speed_only",
            '[rig]\nkind = "dc_motor"\n',
            FROM_SPEED_TERMS,
            (),
            FROM_SPEED_TRUTH,
            motor_from_speed,
            unknown=FROM_SPEED_UNKNOWN,
        ),
        Case(
            "axis",
            '[rig]\nkind = "axis"\n',
            ("viscous_friction", "coulomb_friction", "constant_force"),
            ("quadratic_viscous_friction", "friction_asymmetry", "time_delay"),
            AXIS_TRUTH,
            axis,
        ),
        Case(
            "solenoid",
            '[rig]\nkind = "solenoid"\n[known]\nstop_low = 0.0\nstop_high = 0.005\n',
            SOLENOID_TERMS,
            ("spring_preload", "time_delay", "eddy_current"),
            SOLENOID_TRUTH,
            solenoid,
        ),
        Case("ur5", arm.RIG, arm.TERMS, arm.ABSENT, arm.TRUTH, arm.arm),
    )
}
