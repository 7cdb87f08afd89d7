"""The ball and beam of cases one and two (the text's 5.3): a bare beam, and one with paper tape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from labhil.physics.record import Record
from labhil.plants.ball_beam import BallBeamPlant
from labhil.signals import FloatArray
from labhil_benchmarks.reference import published
from labhil_benchmarks.reference.levels import Levels
from labhil_benchmarks.reference.study import Data, Study, Swarm

DURATION = 20.0
BITS = 8
RANGE = 0.5
NOISE = 1e-3
LARGEST, FASTEST = 1.2, 6.0
FREQUENCIES = (0.23, 0.31)
TEST_FREQUENCIES = (0.28, 0.39)
BEAM = 0.40
TERMS = (
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "quadratic_viscous_friction",
    "cubic_viscous_friction",
    "dead_zone",
    "time_delay",
)
MADE = ("viscous_friction", "coulomb_friction", "stribeck_friction", "time_delay")
SETUP = (
    f"Two sines of {FREQUENCIES[0]:g} and {FREQUENCIES[1]:g} Hz, {TEST_FREQUENCIES[0]:g} and "
    f"{TEST_FREQUENCIES[1]:g} Hz to test on, {BITS} bits at 100 Hz, the ball of 0.261 kg and 0.02 m and a "
    "delay of 0.05 s, as in the text; its plant is one with the values of the table's PSO column, without "
    "bristles, those parameters that the text finds to be nothing set to zero. Ours, since the text is "
    f"silent: a beam of {BEAM:g} m and a linkage ratio of {{ratio:g}}, {{amplitude:g}} rad a tone, "
    f"{DURATION:g} s, a range of {RANGE:g} m and {1e3 * NOISE:g} mm of noise before the converter (it "
    f"dithers the steps of {1e3 * RANGE / 2**BITS:.2g} mm), and a controller that keeps the ball on the "
    "beam, without which two open-loop sines let it roll off. The recorded input is the angle in effect."
)


@dataclass(frozen=True, slots=True)
class Mechanism:
    """What the text leaves open: linkage ratio, amplitude of a tone, rad, and a controller.

    ``kp`` rad/m and ``kd`` rad·s/m act on the measured position, the derivative through a lag of
    ``filter_time`` s: gentle, for what the servo chatters the beam's β̇² makes unstable.
    """

    ratio: float
    amplitude: float
    kp: float
    kd: float
    filter_time: float


def simulate(truth: Mapping[str, float], mechanism: Mechanism, seed: int) -> Data:
    """A recording and a test of the mechanism with these parameters."""
    record, test = (
        _run(truth, mechanism, f, 2 * seed + i) for i, f in enumerate((FREQUENCIES, TEST_FREQUENCIES))
    )
    step = RANGE / 2**BITS
    return Data(record, test, np.array([np.hypot(NOISE, step / np.sqrt(12.0))]), np.zeros(2))


def _run(
    truth: Mapping[str, float], mechanism: Mechanism, frequencies: tuple[float, float], seed: int
) -> Record:
    """Two sines with the stabilising controller, sample by sample."""
    made = {key: value for key, value in truth.items() if key.partition(".")[0] in MADE}
    numbers = {
        "crank_radius": mechanism.ratio * BEAM, "beam_length": BEAM, "position_noise": NOISE,
        "adc_bits": float(BITS), "adc_range": RANGE,
    }  # fmt: skip
    plant = BallBeamPlant({**numbers, **made}, MADE, seed)
    n = round(DURATION / plant.period)
    t: FloatArray = plant.period * np.arange(n, dtype=np.float64)
    wanted = mechanism.amplitude * np.sin(2.0 * np.pi * np.outer(t, frequencies)).sum(axis=1)
    u, y, slope = np.zeros(n), np.zeros(n), 0.0
    y[0] = plant.sensor.position(np.array([plant.count()]))[0]
    kept, reach = np.exp(-plant.period / mechanism.filter_time), FASTEST * plant.period
    for i in range(1, n):
        command = wanted[i - 1] - mechanism.kp * y[i - 1] - mechanism.kd * slope
        u[i] = np.clip(command, max(u[i - 1] - reach, -LARGEST), min(u[i - 1] + reach, LARGEST))
        y[i] = plant.sensor.position(np.array([plant.step(u[i])]))[0]
        slope = kept * slope + (1.0 - kept) * (y[i] - y[i - 1]) / plant.period
    return Record(t, u[:, None], y[:, None], ("servo_angle",), ("ball_position",), ("m",))


def _study(
    name: str,
    variant: str,
    parameters: published.ParameterTable,
    quality: published.QualityTable,
    mechanism: Mechanism,
) -> Study:
    absent = {"F_v2", "F_v3", "U_l", "U_r"}
    truth = tuple(0.0 if row.symbol in absent else row.pso for row in parameters.rows)
    rig = (
        '[rig]\nkind = "ball_beam"\n[known]\nball_mass = 0.261\nball_radius = 0.02\n'
        f"crank_radius = {mechanism.ratio * BEAM}\nbeam_length = {BEAM}\n"
    )
    return Study(
        name=name,
        variant=variant,
        parameters=parameters,
        quality=quality,
        rig=rig,
        terms=TERMS,
        truth=truth,
        sizes=(0.0, 0.0, 0.0, 0.2, 0.2, 0.0, 0.05, 0.05, 0.0),
        swarm=Swarm(90, 1000, "particles by the text's 5.3.1; iterations are not stated, as in Table 5.2"),
        setup=SETUP.format(ratio=mechanism.ratio, amplitude=mechanism.amplitude),
        simulate=partial(simulate, Levels(parameters.rows).to_ours(truth), mechanism),
    )


BALL_AND_BEAM = (
    _study("bare_beam", "", published.TABLE_5_10, published.TABLE_5_11, Mechanism(0.2, 0.6, 5.0, 2.0, 0.15)),
    _study("paper_tape", "", published.TABLE_5_12, published.TABLE_5_13, Mechanism(0.4, 0.5, 6.0, 1.0, 0.3)),
)
