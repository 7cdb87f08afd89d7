"""What a process without the session's key can do to a run, key by key. A command, no test:

    python benchmarks/measuring/measure_intruders.py -o benchmarks/results/intruders.json

A run drives a twin behind a relay that sees when the device is safe (as in ``measure_safety.py``). An
intruder in a process of its own sends malformed, forged and replayed messages to one key, and 5000 of all of
them a second; the device has to stay active and the run to go on. Then it sends as many as it can; in the
middle of that a second operator presses the emergency stop over the bus, and the time until the device is
safe counts, unless the host's watchdog has made it safe before. The latch's file is not used.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from labhil.bus import latch
from labhil.bus.ask import ask
from labhil.bus.keys import ARRIVED, command_key, event_key, schema_key, setpoint_key, stream_key
from labhil.bus.register import registered_processes
from labhil.bus.session import open_bus
from labhil.errors import BusError, LabhilError
from labhil.recording.reader import read_recording
from measure_safety import EXPERIMENT, Relay, twin_behind_a_relay
from measured import tell

ATTACKS = {"malformed": 200.0, "forged": 200.0, "replayed": 200.0, "flood": 5000.0}
"""What an intruder sends, and how many of it a second, at most."""

FLOOD = 3.0
PRESSED_AFTER = 1.2
PUBLISHED = (
    setpoint_key("bench"),
    event_key("bench"),
    stream_key("bench", "state"),
    stream_key("bench", "command"),
    schema_key("bench", "state"),
    event_key("run"),
    "lab/nobody/state",
    "lab/nobody/event",
)
ASKED = (
    *(command_key("bench", name) for name in ("status", "set", "safe", "lease", "estop", "shutdown")),
    *(command_key("@run", name) for name in ("status", "pause", "resume", "stop", "abort", "mark")),
    schema_key("bench", "state"),
    ARRIVED,
)
NOBODY = ("nobody", "")
"""Runs that nobody attacks, for as long: a machine that is busy otherwise may end these, too."""

KEYS = (*[NOBODY] * 4, *(("put", key) for key in PUBLISHED), *(("ask", key) for key in ASKED))


def intrusion(
    endpoint: str, key: str, how: str, attack: str, seconds: float, rate: float
) -> subprocess.Popen[str]:
    script = str(Path(__file__).with_name("intruder.py"))
    process = subprocess.Popen(
        [sys.executable, script, endpoint, key, how, attack, str(seconds), str(rate)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.readline()
    return process


def count_of(process: subprocess.Popen[str]) -> int:
    assert process.stdout is not None
    sent = process.stdout.read().strip()
    process.wait(30)
    return int(sent or 0)


class Attacked:
    """A run of its own, its bus, and the messages that it reports as refused."""

    def __init__(self, relay: Relay, directory: Path, stack: ExitStack) -> None:
        (directory / "e.toml").write_text(EXPERIMENT.replace("ADDRESS", relay.address))
        self._directory = directory
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "labhil", "run", "e.toml"],
            cwd=directory,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        stack.callback(self._end)
        relay.wait(safe=False)
        (entry,) = [one for one in registered_processes() if one.kind == "run"]
        self.endpoint = entry.endpoint
        self.bus = stack.enter_context(open_bus(entry.endpoint))
        time.sleep(0.5)

    def status(self) -> dict[str, Any]:
        return ask(self.bus, command_key("bench", "status"), {}, 3.0)

    def _end(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
        self.process.wait(30)

    def finish(self) -> int:
        self.process.communicate(timeout=30)
        return self.process.returncode

    def read_outcome(self) -> dict[str, Any]:
        """Why it ended, and what its recording lists as refused, by its first words."""
        (path,) = self._directory.glob("*.mcap")
        recording = read_recording(path)
        rejections = Counter(
            str(event.body.get("message")).split(" (")[0][:140]
            for event in recording.events
            if event.body.get("kind") == "rejected"
        )
        return {
            "reason": recording.metadata["end"].get("reason"),
            "reported": dict(rejections.most_common(8)),
        }


def attack_key(relay: Relay, key: str, how: str) -> dict[str, Any]:
    """Attack one key of a new run, and return the outcome."""
    outcome: dict[str, Any] = {"sent": {}, "moved_by": []}
    with ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        run = Attacked(relay, directory, stack)
        for attack, rate in ATTACKS.items():
            if how == "nobody":
                time.sleep(2.5)
            else:
                process = intrusion(run.endpoint, key, how, attack, 1.5, rate)
                outcome["sent"][f"{attack}, {rate:g}/s"] = count_of(process)
            if relay.safe or run.process.poll() is not None:
                outcome["moved_by"].append(f"{attack}, {rate:g}/s")
                break
        else:
            outcome["refused"] = run.status()["refused"]
            outcome |= press_in_a_flood(relay, run, key, how) if how != "nobody" else stop(run)
        outcome["exit_status"] = run.finish()
        outcome |= run.read_outcome()
    outcome["load_average"] = round(os.getloadavg()[0], 1)
    return outcome


def stop(run: Attacked) -> dict[str, Any]:
    ask(run.bus, command_key("@run", "stop"), {"reason": "enough"}, 10.0, patience=10.0)
    return {}


def press_in_a_flood(relay: Relay, run: Attacked, key: str, how: str) -> dict[str, Any]:
    """Press the emergency stop while as many messages come as an intruder can send."""
    process = intrusion(run.endpoint, key, how, "flood", FLOOD, 0.0)
    time.sleep(PRESSED_AFTER)
    outcome: dict[str, Any] = {"safe_before_the_stop": relay.safe}
    began = time.monotonic()
    try:
        ask(run.bus, command_key("bench", "estop"), {"by": "a second operator"}, 3.0)
    except BusError as error:
        outcome["answer"] = str(error)
    if not outcome["safe_before_the_stop"]:
        outcome["safe_after_ms"] = round(1e3 * (relay.wait(safe=True, after=began) - began), 1)
    outcome["flood"] = count_of(process)
    return outcome


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--only", help="parts of keys: a,b,…")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    result: dict[str, Any] = {"schema": "labhil.intruders/1", "keys": {}}
    with twin_behind_a_relay() as relay:
        for how, key in KEYS:
            if options.only and not any(part in f"{how} {key}" for part in options.only.split(",")):
                continue
            trials = result["keys"].setdefault(f"{how} {key}".strip(), [])
            for _ in range(options.repeat):
                try:
                    trials.append(attack_key(relay, key, how))
                except (LabhilError, TimeoutError, ValueError) as error:
                    trials.append({"not_set_up": str(error)})
                latch.release()
            print(f"{how} {key}: {trials[-1]}", file=sys.stderr, flush=True)
    stops = [t["safe_after_ms"] for ts in result["keys"].values() for t in ts if "safe_after_ms" in t]
    result["largest_ms"] = max(stops, default=None)
    trials = [t for ts in result["keys"].values() for t in ts]
    result["made_safe_by_the_flood"] = sum(t.get("safe_before_the_stop", False) for t in trials)
    result["moved"] = {
        key: [t["reason"] for t in ts if t.get("moved_by")]
        for key, ts in result["keys"].items()
        if any(t.get("moved_by") for t in ts)
    }
    result["machine"] = {"cores": os.cpu_count(), "python": platform.python_version()}
    tell(result, options.out)


if __name__ == "__main__":
    main()
