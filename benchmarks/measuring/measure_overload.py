"""What is lost where somebody cannot keep up, and whether it is counted. A command, no test:

    PYTHONPATH=benchmarks python benchmarks/measuring/measure_overload.py --repeat 10 -o FILE.json

Two publishers send 5,000 samples a second each and write down what they publish, before they do; a recorder
of its own records them. The recorder is frozen for 8 s (SIGSTOP), or another subscriber is, which takes
nothing in meanwhile. Then all goes on for some seconds, and the recording is held against what was published:
what is not in it has to be counted: holes between its samples and, in its last status, what its publishers
say that they published after the last of them.
"""

from __future__ import annotations

import argparse
import os
import platform
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from kill_trials import HERE, published_in
from labhil.errors import LabhilError
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording
from labhil_benchmarks.left_files import examine
from measured import tell
from victims import process, wait_until

DEVICES = ("one", "two")
EACH = 5000
"""Samples a second of each publisher."""

BEFORE, AFTER = (1.0, 2.0), 4.0
"""s before and after somebody is frozen."""


@contextmanager
def publishers(endpoint: str, folder: Path) -> Iterator[None]:
    """Both publishers, until the end of the context."""
    with ExitStack() as stack:
        started = []
        for name in DEVICES:
            script = str(HERE / "logged_publisher.py")
            command = [sys.executable, "-P", script, endpoint, name, str(EACH), f"{name}.log"]
            publisher = subprocess.Popen(command, cwd=folder, stdin=subprocess.PIPE)
            started.append(stack.enter_context(publisher))
        wait_until(lambda: all((folder / f"{name}.log").exists() for name in DEVICES), "publishers are up")
        yield
        for publisher in started:
            assert publisher.stdin is not None
            publisher.stdin.close()
        for publisher in started:
            publisher.wait(60)


def frozen(who: str, seconds: float, folder: Path, chance: random.Random) -> dict[str, Any]:
    """Freeze the recorder or another subscriber for so long, and return what became of the samples."""
    with ExitStack() as stack:
        command = [sys.executable, str(HERE / "recorder_alone.py"), "syncs.txt", "a.mcap"]
        recorder = stack.enter_context(process(command, folder))
        wait_until((folder / "endpoint.txt").exists, "the recorder is up")
        endpoint = (folder / "endpoint.txt").read_text()
        victim = recorder.pid
        if who == "another subscriber":
            script = [sys.executable, "-P", str(HERE / "slow_subscriber.py"), endpoint]
            (folder / "slow").mkdir()
            victim = stack.enter_context(process(script, folder / "slow")).pid
            time.sleep(2.0)
        with publishers(endpoint, folder):
            time.sleep(chance.uniform(*BEFORE))
            os.kill(victim, signal.SIGSTOP)
            time.sleep(seconds)
            os.kill(victim, signal.SIGCONT)
            time.sleep(AFTER)
        assert recorder.stdin is not None
        recorder.stdin.close()
        recorder.wait(60)
    return compare_with_log(folder)


def compare_with_log(folder: Path) -> dict[str, Any]:
    path = folder / "a.mcap"
    log = {f"/{name}/state": published_in(folder / f"{name}.log") for name in DEVICES}
    recording = read_recording(path)
    examined = examine("finished", path.read_bytes(), log, 0, 1 << 62, folder)
    published = sum(map(len, log.values()))
    return {
        "published": published,
        "recorded": examined.saved,
        "lost": published - examined.saved,
        "wrong": examined.wrong,
        "holes": examined.holes,
        "gaps_in_its_last_status": reported_gaps(recording),
        "complete": recording.complete,
    }


def reported_gaps(recording: Recording) -> int:
    """The gaps that the recorder's last status counts."""
    last = [event for event in recording.events if event.topic == "status"][-1]
    return sum(int(stream["gaps"]) for stream in last.body["streams"].values())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=8.0, help="how long somebody is frozen")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    chance = random.Random(1)
    result: dict[str, Any] = {"schema": "labhil.overload/1", "samples_per_second": EACH * len(DEVICES)}
    result["frozen_s"] = options.seconds
    for who in ("the recorder", "another subscriber"):
        trials, loads = [], [os.getloadavg()[0]]
        for _ in range(options.repeat):
            with tempfile.TemporaryDirectory() as folder:
                try:
                    trials.append(frozen(who, options.seconds, Path(folder), chance))
                except (LabhilError, ValueError) as error:
                    trials.append({"not_set_up": str(error)})
            loads.append(os.getloadavg()[0])
            print(f"{who}: {trials[-1]}", file=sys.stderr, flush=True)
        valid = [trial for trial in trials if "not_set_up" not in trial]
        result[who] = {
            "repeats": len(valid),
            **{key: sum(trial[key] for trial in valid) for key in ("published", "recorded", "lost", "wrong")},
            "lost_and_not_counted": sum(trial["lost"] - trial["gaps_in_its_last_status"] for trial in valid),
            "counted_at_the_end": sum(trial["gaps_in_its_last_status"] - trial["holes"] for trial in valid),
            "trials": trials,
            "load_average": [round(min(loads), 1), round(max(loads), 1)],
        }
    result["machine"] = {"cores": os.cpu_count(), "python": platform.python_version()}
    tell(result, options.out)


if __name__ == "__main__":
    main()
