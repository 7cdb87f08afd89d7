"""How long a diagnosis of a long recording takes, beside another labhil. A command, no test:

    python benchmarks/measuring/measure_speed.py --trials 3 --seed 60 --against OTHER/bin/python -o FILE.json

Draws recordings of 60 s (of an arm 40 s) with one concealed effect of each rig and diagnoses each from the
command line, by this labhil and by that of another interpreter in turn: seconds of the clock and of the
processor, the start of Python included, and whether both name the same. A figure is a median.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from labhil.campaign.trials.folder import recording_path
from labhil.campaign.trials.make import TrialSetOptions, make_trials
from measure_ablation import read_answer
from measured import tell

SECONDS = {"ball_beam": 60.0, "dc_motor": 60.0, "axis": 60.0, "solenoid": 60.0, "ur5": 40.0}
LONGEST = 1200.0
"""s that one diagnosis may take."""


@dataclass(frozen=True, slots=True)
class Timed:
    """One diagnosis: seconds of the clock and of the processor, and what it named."""

    clock_s: float
    processor_s: float
    named: tuple[str, ...]


def diagnose(python: str, folder: Path, name: str, baseline: tuple[str, ...], out: Path) -> Timed:
    """Diagnose one trial in a process of its own."""
    searched, tested = (str(recording_path(folder, name, part)) for part in ("search", "test"))
    command = [python, "-P", "-m", "labhil", "diagnose", searched, "--test", tested, "--json", str(out)]
    if baseline:
        command += ["--baseline", ",".join(baseline)]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run(command, check=True, capture_output=True, timeout=LONGEST)
    clock, after = time.monotonic() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    missing = json.loads(out.read_text(encoding="utf-8"))["missing"]
    return Timed(clock, processor, tuple(sorted(claim["term"] for claim in missing)))


def measure_rig(rig: str, trials: int, seed: int, pythons: list[str]) -> dict[str, Any]:
    """Every trial of a rig by every interpreter."""
    with tempfile.TemporaryDirectory() as kept:
        folder, answers = Path(kept) / "trials", Path(kept) / "answers"
        make_trials(
            TrialSetOptions(rig, trials, "1", folder, answers, seed, seconds=SECONDS[rig]),
            1,
            lambda text: None,
        )
        rows = []
        for path in sorted(answers.glob("*.json")):
            answer = read_answer(path)
            timed = [diagnose(p, folder, path.stem, answer.baseline, Path(kept) / "d.json") for p in pythons]
            rows.append(
                {"there": [effect.key for effect in answer.effects], "runs": list(map(asdict, timed))}
            )
            print(rig, rows[-1], flush=True)
    return {"seconds_recorded": SECONDS[rig], "trials": rows, **summarise(rows, len(pythons))}


def summarise(rows: list[dict[str, Any]], labhils: int) -> dict[str, Any]:
    """Medians by each labhil, and of the ratio of the first to the last."""
    clock, processor = (
        [[row["runs"][k][key] for row in rows] for k in range(labhils)] for key in ("clock_s", "processor_s")
    )
    summary: dict[str, Any] = {
        "clock_s": [round(statistics.median(of), 1) for of in clock],
        "processor_s": [round(statistics.median(of), 1) for of in processor],
    }
    if labhils > 1:
        ratios = [ours / theirs for ours, theirs in zip(processor[0], processor[-1], strict=True)]
        summary["processor_ratio"] = round(statistics.median(ratios), 2)
    return summary


def main() -> None:
    """Read the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", nargs="+", default=list(SECONDS), choices=list(SECONDS))
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--against", help="the interpreter of another labhil")
    parser.add_argument("-o", "--out", type=Path)
    given = parser.parse_args()
    pythons = [sys.executable, *([given.against] if given.against else [])]
    rigs: dict[str, Any] = {}
    for rig in given.rigs:  # figures are printed at once: a rig may take an hour
        rigs[rig] = measure_rig(rig, given.trials, given.seed, pythons)
        tell({"schema": "labhil.speed/1", "seed": given.seed, "rigs": rigs}, given.out)


if __name__ == "__main__":
    main()
