"""The solenoid actuator (the text's 5.2)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from labhil.physics.record import Record
from labhil.plants.solenoid import SolenoidPlant
from labhil.plants.trajectory import Trajectory
from labhil.signals import FloatArray
from labhil_benchmarks.reference import published
from labhil_benchmarks.reference.levels import Levels
from labhil_benchmarks.reference.study import Data, Study, Swarm

PERIOD = 0.001
DURATION = 5.0
HIGHEST = 2.7
STOP = 0.015
DECIBEL = 25.0
FREQUENCIES = (1.0, 4.0)
TEST_FREQUENCIES = (1.5, 5.0)
TERMS = ("viscous_friction", "coulomb_friction", "stribeck_friction")
SETUP = (
    f"Two sines of {FREQUENCIES[0]:g} and {FREQUENCIES[1]:g} Hz between 0 and {HIGHEST:g} A, white noise "
    f"{DECIBEL:g} dB below the power of the position, as in the text. Ours, since the text is silent: the "
    f"force surface F(i, x) (known to the model), equal amplitudes that begin at 0 A, {DURATION:g} s at "
    f"{1 / PERIOD:g} Hz, {TEST_FREQUENCIES[0]:g} and {TEST_FREQUENCIES[1]:g} Hz to test on. As in eq. 4.10 "
    f"no stop is in the way (the far one stands at {1e3 * STOP:g} mm)."
)


def current(frequencies: tuple[float, ...], t: FloatArray) -> FloatArray:
    """Coil current (n,) A: as many cosines between 0 and the highest current, together 0 at t = 0."""
    each = 0.5 * HIGHEST / len(frequencies)
    return np.asarray(each * np.sum(1.0 - np.cos(2.0 * np.pi * np.outer(t, frequencies)), axis=1))


def simulate(truth: Mapping[str, float], seed: int) -> Data:
    """A recording and a test of the solenoid with these parameters."""
    quiet = _run(truth, 0.0, FREQUENCIES, 0).truth["plunger_position"]
    noise = float(np.sqrt(np.mean(quiet**2)) * 10.0 ** (-DECIBEL / 20.0))
    runs = [_run(truth, noise, f, 2 * seed + i) for i, f in enumerate((FREQUENCIES, TEST_FREQUENCIES))]
    record, test = (
        Record(
            run.t,
            run.input[:, None],
            run.measured["plunger_position"][:, None],
            ("coil_current",),
            ("plunger_position",),
            ("m",),
        )
        for run in runs
    )
    return Data(record, test, np.array([noise]), np.zeros(2))


def _run(truth: Mapping[str, float], noise: float, frequencies: tuple[float, ...], seed: int) -> Trajectory:
    numbers = {**truth, "plunger_position_noise": noise, "stop_high": STOP}
    t: FloatArray = PERIOD * np.arange(round(DURATION / PERIOD), dtype=np.float64)
    return SolenoidPlant(numbers, TERMS, seed, PERIOD).simulate(current(frequencies, t))


TRUTH = tuple(row.real or 0.0 for row in published.TABLE_5_8.rows)

SOLENOID = Study(
    name="solenoid",
    variant="",
    parameters=published.TABLE_5_8,
    quality=published.TABLE_5_9,
    rig=f'[rig]\nkind = "solenoid"\n[known]\nstop_low = 0.0\nstop_high = {STOP}\n',
    terms=TERMS,
    truth=TRUTH,
    sizes=TRUTH,
    swarm=Swarm(60, 2000, "Table 5.7"),
    setup=SETUP,
    simulate=partial(simulate, Levels(published.TABLE_5_8.rows).to_ours(TRUTH)),
)
