"""The DC motor of cases two and three (the text's 5.1), with speed alone and with the current as well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from labhil.experiment.excitation import prms, sample
from labhil.physics.record import Record
from labhil.plants.dc_motor import DcMotorPlant
from labhil.plants.trajectory import Trajectory
from labhil.signals import FloatArray, Hold
from labhil_benchmarks.reference import published
from labhil_benchmarks.reference.levels import Levels
from labhil_benchmarks.reference.study import Combination, Data, Study, Swarm

PERIOD = 0.01
DURATION = 60.0
HIGHEST = 5.0
LEVELS = 11
DWELL = 0.3
UNITS = {"speed": "rad/s", "current": "A"}
TERMS = (
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "quadratic_viscous_friction",
    "cubic_viscous_friction",
)
SETUP = (
    f"PRMS of ±{HIGHEST:g} V, white noise {{decibel:g}} dB below the power of each signal, as in the text. "
    f"Ours, since the text is silent: {LEVELS} levels held for {DWELL:g} s, {DURATION:g} s at "
    f"{1 / PERIOD:g} Hz, another draw of the sequence to test on, the motor at rest at the beginning."
)


COMBINATIONS = (
    Combination("R·J/K", "V·s²/rad", lambda v: v["R"] * v["J"] / v["K"]),
    Combination("L/R", "s", lambda v: v["L"] / v["R"]),
    Combination("R·T_s/K", "V", lambda v: v["R"] * v["T_s"] / v["K"]),
    Combination("R·T_c/K", "V", lambda v: v["R"] * v["T_c"] / v["K"]),
    Combination("K + R·T_v1/K", "V·s/rad", lambda v: v["K"] + v["R"] * v["T_v1"] / v["K"]),
    Combination("R·T_v2/K", "V·s²/rad²", lambda v: v["R"] * v["T_v2"] / v["K"]),
    Combination("R·T_v3/K", "V·s³/rad³", lambda v: v["R"] * v["T_v3"] / v["K"]),
)
"""What voltage and speed know: (R, L)·a with (J, all torques)/a changes the current only."""


def simulate(truth: Mapping[str, float], channels: Sequence[str], decibel: float, seed: int) -> Data:
    """A recording and a test of the motor with these parameters; noise ``decibel`` below each signal."""
    quiet = _run(truth, 0.0, 0.0, 2 * seed)
    noise = {
        name: float(np.sqrt(np.mean(quiet.truth[name] ** 2)) * 10.0 ** (-decibel / 20.0)) for name in UNITS
    }
    record, test = (_run(truth, noise["speed"], noise["current"], 2 * seed + i) for i in (0, 1))
    sigma = np.array([noise[name] for name in channels])
    return Data(_record(record, channels), _record(test, channels), sigma, np.zeros(2))


def _run(truth: Mapping[str, float], speed_noise: float, current_noise: float, seed: int) -> Trajectory:
    numbers = {**truth, "speed_noise": speed_noise, "current_noise": current_noise}
    plant = DcMotorPlant(numbers, TERMS, seed, PERIOD)
    t: FloatArray = PERIOD * np.arange(round(DURATION / PERIOD), dtype=np.float64)
    return plant.simulate(sample(prms(-HIGHEST, HIGHEST, LEVELS, DWELL, DURATION, seed), t))


def _record(run: Trajectory, channels: Sequence[str]) -> Record:
    outputs: FloatArray = np.column_stack([run.measured[name] for name in channels])
    units = tuple(UNITS[name] for name in channels)
    return Record(run.t, run.input[:, None], outputs, ("voltage",), tuple(channels), units, (Hold.ZERO,))


def _study(
    name: str,
    parameters: published.ParameterTable,
    quality: published.QualityTable,
    decibel: float,
    channels: tuple[str, ...],
    linear: published.QualityTable | None = None,
) -> Study:
    truth = tuple(row.real if row.real is not None else row.pso for row in parameters.rows)
    alone = channels == ("speed",)
    return Study(
        name=f"{name}_{'speed' if alone else 'current'}",
        variant="speed alone, as in the text" if alone else "speed and current",
        parameters=parameters,
        quality=quality,
        rig='[rig]\nkind = "dc_motor"\n',
        terms=TERMS,
        truth=truth,
        sizes=tuple(row.real or 0.0 for row in published.TABLE_5_3.rows),
        swarm=Swarm(100, 1000, "Table 5.2"),
        setup=SETUP.format(decibel=decibel),
        simulate=partial(simulate, Levels(parameters.rows).to_ours(truth), channels, decibel),
        linear=linear,
        held="R" if alone else "",
        invariant=("K", "ω_s") if alone else (),
        combinations=COMBINATIONS if alone else (),
    )


CASE_TWO = (published.TABLE_5_3, published.TABLE_5_4, 28.0)
CASE_THREE = (published.TABLE_5_5, published.TABLE_5_6, 25.0)

MOTOR = (
    _study("motor_two", *CASE_TWO, ("speed",), published.TABLE_5_1),
    _study("motor_two", *CASE_TWO, ("speed", "current")),
    _study("motor_three", *CASE_THREE, ("speed",)),
    _study("motor_three", *CASE_THREE, ("speed", "current")),
)
"""Table 5.1 has the plant and the signal of case two, and so its data."""
