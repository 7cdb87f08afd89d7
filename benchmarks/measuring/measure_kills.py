"""What SIGKILL and a power failure leave behind, process by process, at random moments. A command, no test:

    python benchmarks/measuring/measure_kills.py --repeat 100 -o benchmarks/results/kills.json

A simulated solenoid sends 2,000 samples a second through a relay that sees when the device is safe (as in
``measure_safety.py``). One process is killed with SIGKILL at a random moment of the first seconds: the
recorder by itself, with two publishers of 1,000 samples a second that write down what they publish; a run
(controller and recorder); a host; a twin; a served lab (recorder and worker); a study of its worker; a
terminal UI. For each: what the file gives back, against what was published (for runs: what a listener on the
bus heard, gapless); how long until the device is safe; whether a process is left; how what goes on ends.

A power failure is imitated on the same file: what was forced to the disk (``fdatasync``) is kept; what was
written after that is cut off, or each of its pages is kept or is zeros, by chance.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import random
import statistics
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import kill_trials
from labhil.bus import latch
from labhil.errors import LabhilError
from measure_safety import twin_behind_a_relay
from measured import tell

RECOVERED = 0.6
"""s; what may be lost."""


def summarise(trials: list[dict[str, Any]]) -> dict[str, Any]:
    """Put the trials of one kind together."""
    valid = [trial for trial in trials if "not_set_up" not in trial]
    summary: dict[str, Any] = {"kills": len(valid), "not_set_up": len(trials) - len(valid)}
    reasons = Counter(trial["not_set_up"][:120] for trial in trials if "not_set_up" in trial)
    if reasons:
        summary["why_not_set_up"] = dict(reasons)
    moments = [trial["moment_s"] for trial in valid]
    summary["moments_s"] = [round(min(moments, default=0.0), 2), round(max(moments, default=0.0), 2)]
    summary["processes_left"] = sum(len(trial.get("processes_left", [])) for trial in valid)
    gone = [trial["all_gone_ms"] for trial in valid if trial.get("all_gone_ms") is not None]
    summary["all_gone_ms"] = describe(gone)
    summary["safe_ms"] = describe([trial["safe_ms"] for trial in valid if trial.get("safe_ms") is not None])
    summary["ends"] = dict(Counter(trial["end"] for trial in valid if "end" in trial).most_common(12))
    variants: dict[str, list[dict[str, Any]]] = {}
    for trial in valid:
        for file in trial.get("files", []):
            variants.setdefault(file["variant"], []).append(file)
    summary["files"] = {variant: summarise_files(files) for variant, files in variants.items()}
    return summary


def summarise_files(files: list[dict[str, Any]]) -> dict[str, Any]:
    """Put together what the files of one kind gave back."""
    lost = [file["lost"] for file in files if file["lost"] is not None]
    return {
        "files": len(files),
        "recovered": sum(not file["fault"] for file in files),
        "nothing_to_save": dict(Counter(file["fault"][:150] for file in files if file["fault"])),
        "samples_saved": sum(file["saved"] for file in files),
        "samples_wrong": sum(file["wrong"] for file in files),
        "samples_before_the_log": sum(file["unheard"] for file in files),
        "holes": sum(file["holes"] for file in files),
        "lost_s": describe(lost, digits=3),
        "lost_more_than_0.6_s": sum(time_lost > RECOVERED for time_lost in lost),
    }


def describe(values: list[float], digits: int = 1) -> dict[str, float] | None:
    """The median, and the largest."""
    if not values:
        return None
    return {
        "of": len(values),
        "median": round(statistics.median(values), digits),
        "largest": round(max(values), digits),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--repeat", type=int, default=20)
    parser.add_argument("--only", help=f"put only these into FILE: {','.join(kill_trials.KINDS)}")
    parser.add_argument("--seed", type=int, default=1, help="of the moments")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    chance = random.Random(options.seed)
    result: dict[str, Any] = {"schema": "labhil.kills/1", "samples_per_second": kill_trials.RATE, "kinds": {}}
    if options.only and options.out is not None and options.out.exists():
        result["kinds"] = json.loads(options.out.read_text())["kinds"]  # the other kinds stay
    result["machine"] = {"cores": os.cpu_count(), "python": platform.python_version()}
    wanted = options.only.split(",") if options.only else list(kill_trials.KINDS)
    with twin_behind_a_relay("solenoid", kill_trials.SAMPLING) as relay:
        for kind in wanted:
            trials: list[dict[str, Any]] = []
            loads = [os.getloadavg()[0]]
            while sum("not_set_up" not in one for one in trials) < options.repeat:
                with tempfile.TemporaryDirectory() as folder:
                    try:
                        trials.append(kill_trials.KINDS[kind](relay, Path(folder), chance))
                    except (LabhilError, TimeoutError, ValueError) as error:
                        trials.append({"not_set_up": str(error)})
                    finally:
                        latch.release()
                loads.append(os.getloadavg()[0])
                print(f"{kind} {len(trials)}: {trials[-1]}", file=sys.stderr, flush=True)
                if len(trials) > 2 * options.repeat + 5:
                    break
            load = [round(min(loads), 1), round(max(loads), 1)]
            result["kinds"][kind] = {**summarise(trials), "load_average": load}
            if options.out is not None:
                tell(result, options.out)
            time.sleep(0.5)
    tell(result, options.out)


if __name__ == "__main__":
    main()
