"""How long a fit takes beside what one would type by hand: scipy on odeint. A command, no test:

    PYTHONPATH=benchmarks python benchmarks/measuring/measure_fit.py --seeds 3 -o FILE.json

The recording is the DC motor of the reference text's case two, speed alone: 20 s at 1 kHz, noise 28 dB below
the speed, five terms of friction and four constants of the motor, ten parameters. Each recording is fitted by
``scipy.optimize.least_squares`` on ``odeint`` with a right-hand side in plain Python, from starts within a
factor of 1.5 of the truth, and by labhil without any: least squares alone with Wald's intervals,
and the default with its statistics. All in this process, one after the other, on one core; kernels are
compiled before. χ² is the sum of squared residuals over the recording's noise: equal values are one minimum.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import exp, tanh
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import odeint
from scipy.optimize import least_squares

from labhil import cores
from labhil.identify.fit import Options, fit
from labhil.identify.intervals import Intervals
from labhil.physics.record import Record
from labhil_benchmarks.reference import motor
from labhil_benchmarks.reference.study import Study
from measured import tell

PERIOD, DURATION = 1e-3, 20.0
ROUGH = 1.5
"""Largest factor between a start of scipy and the truth."""

NAMES = (
    "inertia",
    "torque_constant",
    "inductance",
    "resistance",
    "viscous_friction.coefficient",
    "coulomb_friction.level",
    "stribeck_friction.level",
    "stribeck_friction.velocity",
    "quadratic_viscous_friction.coefficient",
    "cubic_viscous_friction.coefficient",
)


@dataclass(frozen=True, slots=True)
class Timed:
    """A fit: seconds of the processor, simulations, and the sum of squared residuals in units of noise."""

    processor_s: float
    simulations: int
    chi_square: float


def by_hand(study: Study, record: Record, sigma: float, random: np.random.Generator) -> Timed:
    """Fit with scipy, as one would type it; the sign of dry friction is a steep tanh."""
    truth = study.levels.to_ours(study.truth)
    start = np.array([truth[name] for name in NAMES]) * ROUGH ** random.uniform(-1.0, 1.0, len(NAMES))
    voltage, speed = record.inputs[:, 0].tolist(), record.outputs[:, 0]
    last, evaluations = len(voltage) - 1, 0

    def rhs(x: Any, t: float, J: float, K: float, L: float, R: float, *friction: float) -> Any:
        c, level, stribeck, width, quadratic, cubic = friction
        w, i = x
        u = voltage[min(int(t / PERIOD + 1e-9), last)]
        size = abs(w)
        dry = (level + stribeck * exp(-min(size / width, 50.0))) * tanh(w / 1e-3)
        drag = dry + c * w + quadratic * w * size + cubic * w**3
        return (K * i - drag) / J, (u - R * i - K * w) / L

    def residuals(p: Any) -> Any:
        nonlocal evaluations
        evaluations += 1
        with np.errstate(all="ignore"):
            y = odeint(rhs, p[len(NAMES) :], record.t, args=tuple(p[: len(NAMES)]), hmax=motor.DWELL)[:, 0]
        return np.clip(np.nan_to_num((y - speed) / sigma, nan=1e4), -1e4, 1e4)

    lower = np.r_[np.full(len(NAMES), 1e-6), -np.inf, -np.inf]
    lower[NAMES.index("stribeck_friction.level")] = -np.inf
    began = time.process_time()
    solution = least_squares(
        residuals, np.r_[start, 0.0, 0.0], bounds=(lower, np.inf), x_scale=np.r_[np.abs(start), 0.1, 0.1]
    )
    return Timed(time.process_time() - began, evaluations, float(2.0 * solution.cost))


def by_labhil(study: Study, record: Record, options: Options) -> Timed:
    """Fit with labhil."""
    began = time.process_time()
    with cores.linear_algebra_in_one_thread():
        found = fit(study.model(record), record, study.terms, options=options)
    spent = time.process_time() - began
    return Timed(spent, found.evaluations, found.fitted.solution.cost)


def measure(study: Study, seed: int) -> dict[str, Timed]:
    """Fit one recording in every way."""
    data = study.simulate(seed)
    sigma, random = float(data.sigma[0]), np.random.default_rng(seed)
    ways: dict[str, Callable[[], Timed]] = {
        "scipy on odeint": lambda: by_hand(study, data.record, sigma, random),
        "nlse, Wald": lambda: by_labhil(
            study, data.record, Options(estimator="nlse", intervals=Intervals.WALD)
        ),
        "default": lambda: by_labhil(study, data.record, Options()),
    }
    timed = {name: way() for name, way in ways.items()}
    print(seed, timed, flush=True)
    return timed


def summarise(runs: list[dict[str, Timed]]) -> dict[str, Any]:
    """Medians of each way, and of scipy's seconds over its seconds."""
    summary = {}
    for name in runs[0]:
        seconds = [run[name].processor_s for run in runs]
        ratios = [run["scipy on odeint"].processor_s / run[name].processor_s for run in runs]
        summary[name] = {
            "processor_s": [round(s, 2) for s in seconds],
            "simulations": [run[name].simulations for run in runs],
            "chi_square": [round(run[name].chi_square, 1) for run in runs],
            "times_faster_than_scipy": round(statistics.median(ratios), 2),
        }
    return summary


def main() -> None:
    """Read the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("-o", "--out", type=Path)
    given = parser.parse_args()
    motor.PERIOD, motor.DURATION = PERIOD, DURATION
    cores.share_cores(cores.cores())
    study = motor.MOTOR[0]
    warm = study.simulate(0).record.part(0, 2000)
    by_labhil(study, warm, Options(estimator="nlse", intervals=Intervals.WALD))
    runs = [measure(study, seed) for seed in range(1, given.seeds + 1)]
    tell({"schema": "labhil.fit_speed/1", "ways": summarise(runs)}, given.out)


if __name__ == "__main__":
    main()
