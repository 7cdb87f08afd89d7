"""What a busy machine makes of a recording, and what the diagnosis makes of that. A command, no test:

    python benchmarks/measuring/measure_busy.py --repeat 24 --busy 8 --keep FOLDER -o FILE.json

Each run records a ball and beam's twin whose terms are exactly the baseline, beside ``--busy`` processes that
only compute. Then the machine is left alone, and each recording is diagnosed with that baseline: whatever is
named is an invention of stamps and load. ``--recordings FOLDER`` diagnoses what an earlier call has kept.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from labhil.analysis.material import load_material
from labhil.analysis.study import diagnose_study
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.run import run_experiment
from labhil.recording.reader import read_recording
from measured import tell

TERMS = ("viscous_friction", "coulomb_friction")
LONGEST = 120
"""s after which a busy process ends by itself, should nobody be left to end it."""

EXPERIMENT = """
[experiment]
name = "busy"
[devices.bench]
plugin = "ball_beam"
address = "twin"
rig = "rig.toml"
[devices.bench.twin]
speed = SPEED
seed = SEED
terms = ["viscous_friction", "coulomb_friction"]
set = { viscous_friction.coefficient = 0.26, coulomb_friction.level = 0.09 }
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "two_sine"
frequencies = [0.23, 0.31]
amplitude = 0.6
stabilise = { on = "ball_position", kp = 7.0, kd = 3.0 }
duration = SECONDS
"""
RIG = """
[rig]
kind = "ball_beam"
[known]
ball_mass = 0.261
ball_radius = 0.02
crank_radius = 0.08
beam_length = 0.40
"""


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep ``count`` processes computing."""
    command = ["timeout", str(LONGEST), "yes"]
    children = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for _ in range(count)]
    try:
        yield
    finally:
        for child in children:
            child.terminate()
        for child in children:
            child.wait()


def record(seed: int, options: argparse.Namespace, folder: Path) -> Path | None:
    """Record one run beside busy processes; None where it could not follow its steps."""
    text = EXPERIMENT.replace("SEED", str(seed)).replace("SPEED", repr(options.speed))
    text = text.replace("SECONDS", repr(options.seconds))
    (folder / "rig.toml").write_text(RIG, encoding="utf-8")
    with busy(options.busy):
        time.sleep(0.5)
        result = run_experiment(parse_experiment(text, folder / "e.toml"), folder)
    if result.exit_status != 0:
        print(f"seed {seed}: the run failed: {result.reason}", file=sys.stderr, flush=True)
        return None
    return result.path


def examine(path: Path) -> dict[str, Any]:
    """Say what the clocks of a recording show, and what its diagnosis names."""
    recording = read_recording(path)
    data = recording.stream_with("ball_position")
    clock = data.clock
    found = diagnose_study(load_material(path), baseline=TERMS).json
    return {
        "step_ms": round(1e3 * float(np.median(np.diff(data.t))), 6),
        "drift_ppm": round(1e6 * clock.drift, 1),
        "told_drift_error_ppm": None if clock.drift_error is None else round(1e6 * clock.drift_error, 1),
        "steps": len(clock.steps),
        "jitter_ms": round(1e3 * clock.jitter, 3),
        "clock_faults": [fault.kind.value for fault in data.clock_faults],
        "verdict": found["verdict"],
        "missing": [one["term"] for one in found["missing"]],
        "seconds": round(float(data.t[-1]), 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeat", type=int, default=24)
    parser.add_argument("--busy", type=int, default=8)
    parser.add_argument("--speed", type=float, default=2.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--recordings", type=Path)
    parser.add_argument("--record-only", action="store_true")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    runs: list[dict[str, Any]] = []
    failed = 0
    with tempfile.TemporaryDirectory() as directory:
        folder = options.recordings or options.keep or Path(directory)
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["XDG_RUNTIME_DIR"] = directory
        for seed in range(0 if options.recordings else options.repeat):
            failed += record(seed, options, folder) is None
        for path in sorted(folder.glob("*.mcap")) if not options.record_only else ():
            found = examine(path)
            print(path.name, found, file=sys.stderr, flush=True)
            runs.append(found)
    named = sum(bool(run["missing"]) or run["verdict"] == "missing_physics" for run in runs)
    result = {
        "schema": "labhil.busy/1",
        "busy": options.busy,
        "speed": options.speed,
        "failed_runs": failed,
        "named_something": named,
        "runs": runs,
    }
    tell(result, options.out)


if __name__ == "__main__":
    main()
