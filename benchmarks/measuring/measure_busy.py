"""What a busy machine makes of recordings, and what the diagnosis makes of those. A command, no test:

    python benchmarks/measuring/measure_busy.py --repeat 9 --busy 8 --keep FOLDER -o FILE.json

Each run records several rigs at once beside ``--busy`` processes that only compute: twins whose terms are
exactly the baseline. Then the machine is left alone, and what each device sent is diagnosed with that
baseline: whatever is named is an invention of stamps and load. ``--recordings FOLDER``
diagnoses what an earlier call has kept.
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

from labhil.analysis.dataset import load_dataset
from labhil.analysis.study import diagnose_study
from labhil.errors import LabhilError
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.run import run_experiment
from labhil.recording.contents import recording_status
from labhil.recording.reader import read_recording
from measured import tell

TERMS = ("viscous_friction", "coulomb_friction")
LONGEST = 180
"""s after which a busy process ends by itself, should nobody be left to end it."""

STEPS = {
    "ball_beam": """
signal = "servo_angle"
excitation = "two_sine"
frequencies = [0.23, 0.31]
amplitude = 0.5
stabilise = { on = "ball_position", kp = 7.0, kd = 3.0 }
""",
    "dc_motor": """
signal = "voltage"
excitation = "multisine"
frequencies = [0.11, 0.23, 0.57, 1.3]
amplitude = 2.0
""",
    "solenoid": """
signal = "coil_current_command"
excitation = "multisine"
frequencies = [3.1, 7.3, 13.7, 22.9]
amplitude = 0.13
offset = 0.85
""",
}
"""What moves each rig."""

KNOWN = {
    "ball_beam": "ball_mass = 0.261\nball_radius = 0.02\ncrank_radius = 0.08\nbeam_length = 0.40",
    "dc_motor": "inertia = 0.1",
    "solenoid": "moving_mass = 0.064\nstop_low = 0.0\nstop_high = 0.005",
}
"""What is known of each, as in the examples."""


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


def experiment(seed: int, options: argparse.Namespace) -> str:
    """An experiment that moves all rigs at once; the device of a rig bears its name."""
    lines = ['[experiment]\nname = "busy"']
    for place, rig in enumerate(options.rigs):
        terms = ", ".join(f'"{term}"' for term in TERMS)
        lines.append(
            f'[devices.{rig}]\nplugin = "{rig}"\naddress = "twin"\nrig = "{rig}.toml"\nreconnect = true\n'
            f"twin = {{ speed = {options.speed}, seed = {10 * seed + place}, terms = [{terms}] }}"
        )
    lines += [
        f'[[steps]]\ndevice = "{rig}"{STEPS[rig]}at = 0.0\nduration = {options.seconds}'
        for rig in options.rigs
    ]
    return "\n".join(lines)


def record(seed: int, options: argparse.Namespace, folder: Path) -> None:
    """Record one run beside busy processes, or as much of it as the machine allows."""
    for rig in options.rigs:
        text = f'[rig]\nkind = "{rig}"\n[known]\n{KNOWN[rig]}\n'
        (folder / f"{rig}.toml").write_text(text, encoding="utf-8")
    with busy(options.busy):
        time.sleep(0.5)
        result = run_experiment(parse_experiment(experiment(seed, options), folder / "e.toml"), folder)
    if result.exit_status != 0:
        print(f"seed {seed}: the run failed: {result.reason}", file=sys.stderr, flush=True)


def examine(path: Path, device: str) -> dict[str, Any]:
    """Say what the clocks of one device's samples show, and what a diagnosis names."""
    recording = read_recording(path)
    data = next(
        candidate
        for candidate in recording.streams
        if candidate.device == device and candidate.stream.name == "state"
    )
    clock = data.clock
    figures: dict[str, Any] = {
        "recording": path.name,
        "run": recording_status(recording),
        "rig": device,
        "step_ms": round(1e3 * float(np.median(np.diff(data.t))), 6),
        "drift_ppm": round(1e6 * clock.drift, 1),
        "told_drift_error_ppm": None if clock.drift_error is None else round(1e6 * clock.drift_error, 1),
        "steps": len(clock.steps),
        "jitter_ms": round(1e3 * clock.jitter, 3),
        "clock_faults": [fault.kind.value for fault in data.clock_faults],
        "seconds": round(float(data.t[-1]), 2),
    }
    try:
        dataset = load_dataset(path, device=device)
    except LabhilError as error:  # the run ended before there was enough to learn from
        return {**figures, "refused": str(error)}
    began = time.monotonic()
    result = diagnose_study(dataset, baseline=TERMS).json
    return {
        **figures,
        "verdict": result["verdict"],
        "missing": [item["term"] for item in result["missing"]],
        "p_value": result["p_value"],
        "took_s": round(time.monotonic() - began, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeat", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--busy", type=int, default=8)
    parser.add_argument("--rigs", nargs="+", default=list(STEPS), choices=list(STEPS))
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--recordings", type=Path)
    parser.add_argument("--record-only", action="store_true")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    runs: list[dict[str, Any]] = []
    refused: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as directory:
        folder = options.recordings or options.keep or Path(directory)
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["XDG_RUNTIME_DIR"] = directory
        for seed in range(options.first, options.first + (0 if options.recordings else options.repeat)):
            record(seed, options, folder)
        for path in sorted(folder.glob("*.mcap")) if not options.record_only else ():
            for device in dict.fromkeys(entry.device for entry in read_recording(path).streams):
                if device in STEPS:
                    figures = examine(path, device)
                    print(figures, file=sys.stderr, flush=True)
                    (refused if "refused" in figures else runs).append(figures)
    result = {
        "schema": "labhil.busy/3",
        "busy": options.busy,
        "seeds": [options.first, options.first + options.repeat - 1],
        "speed": options.speed,
        "runs_ended_early": len(
            {entry["recording"] for entry in (*runs, *refused) if entry["run"] != "done"}
        ),
        "diagnosed": len(runs),
        "named_something": sum(bool(run["missing"]) for run in runs),
        "verdicts": sorted(run["verdict"] for run in runs),
        "runs": runs,
        "too_short": refused,
    }
    tell(result, options.out)


if __name__ == "__main__":
    main()
