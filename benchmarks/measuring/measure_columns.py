"""Columns of simulated output: what a diagnosis names of a difference that is known. A command, no test:

    python benchmarks/measuring/measure_columns.py --trials 60 -o benchmarks/results/columns.json

Each trial draws a simulated column of a few tones and what is measured of it: the same with noise (nothing to
name), behind one effect that leaves 3 to 30 times the noise, or of a pendulum whose simulation lacks dry
friction or has a wrong mass or stiffness (nothing that lies between output and output: no name is right).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

import labhil as lh
from labhil.campaign.proportion import Proportion
from labhil.diagnose.remainder import MAX_NOISE_FLOORS
from labhil.signals import FloatArray

PERIOD, SAMPLES = 0.01, 3000
T = PERIOD * np.arange(SAMPLES)
NOTHING, EFFECT, INSIDE = KINDS = ("nothing", "an effect", "inside the mechanism")


def tones(random: np.random.Generator) -> FloatArray:
    """Four sines of up to 2 Hz, about 1 in size."""
    f, phase = random.uniform(0.1, 2.0, 4), random.uniform(0.0, 6.28, 4)
    size = random.uniform(0.3, 1.0, 4) / (1.0 + f)
    return np.asarray((size[:, None] * np.sin(2.0 * np.pi * f[:, None] * T + phase[:, None])).sum(axis=0))


def lagged(x: FloatArray, time_constant: float) -> FloatArray:
    """A column behind a first-order lag, which it has followed as on its first slope before."""
    ratio = PERIOD / time_constant
    decay, y = np.exp(-ratio), np.empty_like(x)
    mean = -np.expm1(-ratio) / ratio
    y[0] = x[0] - time_constant * (x[1] - x[0]) / PERIOD
    for k in range(len(x) - 1):
        y[k + 1] = decay * y[k] + (mean - decay) * x[k] + (1.0 - mean) * x[k + 1]
    return y


def played(x: FloatArray, gap: float) -> FloatArray:
    """A column behind a play of this width."""
    y, at = np.empty_like(x), float(x[0])
    for k, value in enumerate(x.tolist()):
        at = min(max(at, value - 0.5 * gap), value + 0.5 * gap)
        y[k] = at
    return y


def behind(term: str, x: FloatArray, size: float, side: float) -> FloatArray:
    """A column behind one effect; at size 0 it is the column, and the difference grows with it."""
    span = float(np.abs(x).max())
    if term == "clock_offset":
        return np.interp(T - side * size, T, x)
    if term == "sensor_gain":
        return x * (1.0 + side * size)
    if term == "sensor_nonlinearity":
        return np.asarray(x + side * size * x**3)
    if term == "sensor_offset":
        return x + side * size
    if term == "sensor_lag":
        return lagged(x, size) if size else x
    if term == "backlash":
        return played(x, size)
    if term == "dead_zone":
        return np.sign(x) * np.maximum(np.abs(x) - size, 0.0)
    return np.clip(x, -span / (1.0 + size), span / (1.0 + size))


TERMS = (
    "clock_offset", "sensor_gain", "sensor_nonlinearity", "sensor_offset", "sensor_lag", "backlash",
    "dead_zone", "saturation",
)  # fmt: skip


def pendulum(
    u: FloatArray, friction: float = 0.0, stiffness: float = 4.0, inertia: float = 0.2
) -> FloatArray:
    """The angle of a pendulum under a torque, by twenty Euler steps a sample."""
    x = v = 0.0
    angle = np.empty(SAMPLES)
    for k in range(SAMPLES):
        angle[k] = x
        for _ in range(20):
            v += (
                PERIOD
                / 20
                * (u[k] - stiffness * np.sin(x) - 0.15 * v - friction * np.tanh(v / 1e-3))
                / inertia
            )
            x += PERIOD / 20 * v
    return angle


def draw(kind: str, random: np.random.Generator) -> tuple[FloatArray, FloatArray, float, str]:
    """Simulated column, what is measured but for the noise, the noise, and what was put in."""
    x = tones(random)
    if kind == INSIDE:
        lacking = str(random.choice(["dry friction", "stiffness", "inertia"]))
        u, x = 0.8 * x, pendulum(0.8 * x)
        others = {"dry friction": (0.15, 4.0, 0.2), "stiffness": (0.0, 4.8, 0.2), "inertia": (0.0, 4.0, 0.25)}
        y = pendulum(u, *others[lacking])
        return x, y, float(np.std(y - x)) / random.uniform(10.0, 40.0), lacking
    noise = 0.002 * float(np.std(x))
    if kind == NOTHING:
        return x, x, noise, ""
    term, side = str(random.choice(TERMS)), float(random.choice([-1.0, 1.0]))
    wanted = noise * float(np.exp(random.uniform(np.log(3.0), np.log(30.0))))

    def excess(size: float) -> float:
        return float(
            np.std(behind(term, x, size, side) - x) + abs(np.mean(behind(term, x, size, side) - x)) - wanted
        )

    return x, behind(term, x, float(brentq(excess, 0.0, 1.0)), side), noise, term


def trial(kind: str, seed: int) -> dict[str, Any]:
    """Draw one, diagnose it, and say what came."""
    random = np.random.default_rng([seed, KINDS.index(kind)])
    x, y, noise, term = draw(kind, random)
    rig = lh.simulated_output("angle", "rad")
    rec = lh.recording(T, {"simulated_angle": x}, {"angle": y + random.normal(0.0, noise, SAMPLES)}, rig=rig)
    began = time.process_time()
    diagnosis = lh.diagnose(rec)
    better = diagnosis.improvement
    return {
        "kind": kind, "seed": seed, "put_in": term, "verdict": str(diagnosis.verdict),
        "named": sorted(effect.term for effect in diagnosis.missing),
        "rivals": sorted(rival.term for rival in diagnosis.rivals),
        "remains": None if better is None else round(better.rmse_after / better.noise_floor, 2),
        "seconds": round(time.process_time() - began, 2),
    }  # fmt: skip


def _effects(each: dict[str, Any]) -> set[str]:
    """Effects between the columns that were named; a curve is none."""
    return set(each["named"]) - {"unmodelled_force"}


def summary(trials: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts of what was right."""
    by_kind = {kind: [t for t in trials if t["kind"] == kind] for kind in KINDS}
    exact = Counter(t["put_in"] for t in by_kind[EFFECT] if t["named"] == [t["put_in"]])
    return {
        "nothing: no mismatch": Proportion(
            sum(t["verdict"] == "no_mismatch" for t in by_kind[NOTHING]), len(by_kind[NOTHING])
        ).to_json(),
        "an effect: named, and nothing beside it": Proportion(exact.total(), len(by_kind[EFFECT])).to_json(),
        "by effect": {
            term: Proportion(exact[term], sum(t["put_in"] == term for t in by_kind[EFFECT])).to_json()
            for term in TERMS
        },
        "an effect: named, or given as a rival": Proportion(
            sum(t["put_in"] in (*t["named"], *t["rivals"]) for t in by_kind[EFFECT]), len(by_kind[EFFECT])
        ).to_json(),
        "inside the mechanism: no effect named": Proportion(
            sum(not _effects(t) for t in by_kind[INSIDE]), len(by_kind[INSIDE])
        ).to_json(),
        "inside the mechanism: none named, or said that more than noise remains": Proportion(
            sum(not _effects(t) or t["remains"] > MAX_NOISE_FLOORS for t in by_kind[INSIDE]),
            len(by_kind[INSIDE]),
        ).to_json(),
        "processor seconds, median": {
            kind: float(np.median([t["seconds"] for t in ts])) for kind, ts in by_kind.items() if ts
        },
    }


def main() -> None:
    """Measure, and write as trials come."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=60, help="of each kind")
    parser.add_argument("--seed", type=int, default=26112701)
    parser.add_argument("-o", "--output", type=Path, default=Path("columns.json"))
    options = parser.parse_args()
    trials: list[dict[str, Any]] = []
    for number in range(options.trials):
        for kind in KINDS:
            trials.append(trial(kind, options.seed + number))
            print(trials[-1], file=sys.stderr, flush=True)
        result = {"seed": options.seed, "summary": summary(trials), "trials": trials}
        options.output.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
