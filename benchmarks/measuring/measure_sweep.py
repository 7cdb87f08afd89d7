"""Whether a campaign that is killed at random moments loses or repeats a finished run. A command, no test:

    python benchmarks/measuring/measure_sweep.py --runs 20 --kills 6 -o benchmarks/results/sweep.json

A sweep over a twin of the DC motor is started and killed with SIGKILL after a random time, again and again,
then left alone. After each kill the recordings that carry their end are noted with their SHA-256: at the end
each of them has to be there unchanged, and every run of the sweep has to have one recording with its own
value.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from labhil.experiment.campaign import load_campaign
from labhil.recording.reader import read_recording
from measured import tell

RIG = '[rig]\nkind = "dc_motor"\n[limits]\nvoltage = { min = -6.0, max = 6.0 }\n'
EXPERIMENT = """
[experiment]
name = "sweep"
[devices.bench]
plugin = "dc_motor"
address = "twin"
rig = "rig.toml"
twin = { speed = 5.0, seed = 3 }
[[steps]]
device = "bench"
signal = "voltage"
excitation = "hold"
level = 1.0
duration = 2.0
[sweep.over]
"steps.0.level" = LEVELS
"""


def main() -> None:
    """Measure, and write what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--kills", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--out", type=Path, required=True)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        tell(measure(Path(folder), chosen.runs, chosen.kills, chosen.seed), chosen.out)


def measure(folder: Path, runs: int, kills: int, seed: int) -> dict[str, Any]:
    """Kill and resume a sweep; return what was lost or made twice."""
    levels = np.linspace(1.0, 5.0, runs).round(3).tolist()
    (folder / "rig.toml").write_text(RIG)
    (folder / "sweep.toml").write_text(EXPERIMENT.replace("LEVELS", repr(levels)))
    command = [sys.executable, "-P", "-m", "labhil", "run", "sweep.toml", "--out", "out"]
    moments, finished, killed = random.Random(seed), dict[str, str](), []
    began = time.monotonic()
    for _ in range(kills):
        with subprocess.Popen(
            command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as process:
            after = moments.uniform(4.0, 12.0)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(after)
            process.kill()  # SIGKILL; nothing where it has just ended
        finished |= finished_recordings(folder / "out")
        killed.append({"after_s": round(after, 2), "finished": len(finished)})
    last = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    file = load_campaign(folder / "out" / "sweep.campaign.json")
    complete = finished_recordings(folder / "out")
    recorded_levels = [level_of(folder / "out" / str(run.path)) for run in file.runs]
    return {
        "runs": runs,
        "kills": killed,
        "exit_status_of_the_last_start": last.returncode,
        "done": sum(run.status == "done" for run in file.runs),
        "recordings_with_an_end": len(complete),
        "finished_runs_lost_or_changed": sum(complete.get(name) != sha for name, sha in finished.items()),
        "finished_runs_made_again": len(complete) - len({run.path for run in file.runs}),
        "runs_with_the_value_of_another": sum(a != b for a, b in zip(recorded_levels, levels, strict=True)),
        "attempts_that_were_cut_off": sum(len(run.earlier) for run in file.runs),
        "seconds": round(time.monotonic() - began, 1),
    }


def finished_recordings(folder: Path) -> dict[str, str]:
    """The recordings that carry their end, with exit status 0, by name with their SHA-256."""
    hashes = {}
    for path in sorted(folder.glob("*.mcap")):
        if read_recording(path).metadata.get("end", {}).get("exit_status") == "0":
            hashes[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return hashes


def level_of(path: Path) -> float:
    """The level that the run of a recording commanded; what the device applies has steps of its own."""
    return float(read_recording(path).stream_with("voltage_requested")["voltage_requested"].max())


if __name__ == "__main__":
    main()
