"""What a run does when something goes wrong with the arm, fault by fault. A command:

    python benchmarks/measuring/measure_ur5_faults.py --repeat 3 -o benchmarks/results/ur5_faults.json

Each time a `labhil run` moves the simulated arm along a path; the fault comes while the joint moves. What
happened then is read from the recording: by when the arm stood, the longest hole in the samples, when they
came again, and, where the experiment says ``reconnect = true``, when the arm went on along its path. Times
are s after the fault, by this machine's clock.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from labhil.recording.reader import read_recording
from labhil.service.child import Child
from labhil_ur5.rtde import Receiver

STEPS = 14.0
START = 90.0
STILL, MOVING = 1e-3, 0.15
"""rad/s of the joint that the path moves."""
AT_REST = 0.1
"""How long it must stand to be at rest, s."""
RATES = {"e": 500.0, "cb3": 125.0}
ON_THE_PATH = 4
"""``client_state`` of an arm that follows waypoints."""

RIG = """
[rig]
kind = "ur5"
[limits]
target_q = { min = -3.2, max = 3.2, rate = 2.0 }
"""
EXPERIMENT = """
[experiment]
name = "fault"
[devices.arm]
plugin = "PLUGIN"
address = "ADDRESS"
rig = "rig.toml"
reconnect = RECONNECT
[[steps]]
device = "arm"
signal = "target_q_5"
excitation = "multisine"
frequencies = [0.3]
amplitude = 0.5
fade = 1.0
duration = DURATION
"""


class NothingMovedError(RuntimeError):
    """The run ended, or came to nothing, before there was anything to disturb: the machine was too busy."""


class Scene:
    """A simulated controller, a run that moves its arm, and the means to disturb both."""

    def __init__(self, host: str, series: str) -> None:
        self.host, self.series = host, series
        self.twin = self._started()
        self.run: subprocess.Popen[str] | None = None

    def _started(self) -> Child:
        command = [sys.executable, "-P", "-m", "labhil", "twin", "ur5", "--host", self.host]
        twin = Child("the twin", [*command, "--series", self.series, "--set", "unlock_after=0.3"])
        if twin.line(START) != self.host:
            raise RuntimeError(f"the twin did not start{twin.last_error()}")
        # a controller is a machine of its own
        with suppress(PermissionError):
            os.sched_setscheduler(twin.pid, os.SCHED_FIFO, os.sched_param(1))
        return twin

    def restart(self) -> None:
        """Have the controller lose its power and boot again."""
        os.kill(self.twin.pid, signal.SIGKILL)
        self.twin.stop()
        self.twin = self._started()

    def client(self) -> psutil.Process:
        """The process that holds the client library."""
        assert self.run is not None
        children = psutil.Process(self.run.pid).children(recursive=True)
        return next(child for child in children if "labhil_ur5.client" in child.cmdline())

    def tell(self, line: str) -> None:
        """Order a fault of the twin."""
        self.twin.send(f"{line}\n")

    def wait_until_it_moves(self) -> None:
        """Watch the controller from outside until the path moves the joint."""
        receiver = Receiver(self.host)
        try:
            receiver.greet()
            recipe = receiver.start(["target_qd"], [], RATES[self.series])
            deadline = time.monotonic() + 150.0
            while time.monotonic() < deadline:
                packages = receiver.packages()
                if packages and abs(recipe.unpack(packages[-1])[5]) > MOVING:
                    return
                if self.run is not None and self.run.poll() is not None:
                    break
                time.sleep(0.01)
        finally:
            receiver.close()
        raise NothingMovedError


Fault = Callable[[Scene], None]

FAULTS: Mapping[str, Fault] = {
    "connections dropped": lambda scene: scene.tell("drop"),
    "package truncated": lambda scene: scene.tell("truncate"),
    "controller stalls 0.2 s": lambda scene: scene.tell("stall 0.2"),
    "controller stalls 2 s": lambda scene: scene.tell("stall 2"),
    "protective stop": lambda scene: scene.tell("protective stop"),
    "emergency stop": lambda scene: scene.tell("emergency stop"),
    "program stopped at the panel": lambda scene: scene.tell("end program"),
    "client process killed": lambda scene: scene.client().kill(),
    "client process hangs": lambda scene: scene.client().suspend(),
    "controller restarted": Scene.restart,
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one run; times in s after the fault, None for what did not happen."""

    exit_status: int
    reason: str
    at_rest: float | None
    longest_hole: float
    samples_after: float | None
    path_goes_on: float | None
    lost: int
    recorded_after: float


@contextmanager
def scene_at(host: str, series: str) -> Iterator[Scene]:
    scene = Scene(host, series)
    try:
        yield scene
    finally:
        if scene.run is not None and scene.run.poll() is None:
            scene.run.send_signal(signal.SIGINT)
            scene.run.wait(30)
        scene.twin.stop()


def suffer(fault: str, host: str, series: str, reconnect: bool, folder: Path) -> Outcome:
    """Run, disturb, and read what happened."""
    text = EXPERIMENT.replace("PLUGIN", "ur5" if series == "e" else "ur5_cb3").replace("ADDRESS", host)
    text = text.replace("RECONNECT", str(reconnect).lower()).replace("DURATION", repr(STEPS))
    (folder / "e.toml").write_text(text)
    (folder / "rig.toml").write_text(RIG)
    with scene_at(host, series) as scene:
        command = [sys.executable, "-P", "-m", "labhil", "run", "e.toml", "--json"]
        scene.run = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True,
        )  # fmt: skip
        scene.wait_until_it_moves()
        at_ns = time.time_ns()
        FAULTS[fault](scene)
        output, complaint = scene.run.communicate(timeout=180.0)
    try:
        result = json.loads(output)
    except ValueError:
        raise RuntimeError(f"the run said {output!r}, {complaint!r}") from None
    return read_outcome(
        folder / result["path"], result["exit_status"], result["reason"], at_ns, RATES[series]
    )


def read_outcome(path: Path, status: int, reason: str, at_ns: int, rate: float) -> Outcome:
    """Read from a recording what happened after a fault."""
    stream = read_recording(path).stream_with("actual_q")
    after = (stream.t_acq_ns - at_ns) * 1e-9
    last_before = int(np.searchsorted(after, 0.0)) - 1
    t = after[last_before:]
    holes = np.diff(t)
    longest = int(np.argmax(holes)) if len(holes) else 0
    hole = float(holes[longest]) if len(holes) else 0.0
    speed = np.abs(stream["target_qd"][last_before:]).max(axis=1)
    follows = stream["client_state"][last_before:] == ON_THE_PATH
    rest = first_rest(speed < STILL, round(AT_REST * rate))
    away = np.flatnonzero(~follows[: last_of(follows & (speed > MOVING))])
    again = None if rest is None else first(follows & (speed > STILL), int(away[-1]) if len(away) else rest)
    return Outcome(
        exit_status=status,
        reason=reason,
        at_rest=None if rest is None else round(max(float(t[rest]), 0.0), 3),
        longest_hole=round(hole, 3),
        samples_after=round(float(t[longest + 1]), 3) if hole > 5.0 / rate else None,
        path_goes_on=None if again is None else round(float(t[again]), 3),
        lost=int(np.diff(stream.seq[last_before:]).sum() - len(holes)),
        recorded_after=round(float(t[-1]), 3),
    )


def last_of(true: np.ndarray) -> int:
    """Where it is true for the last time, 0 for never."""
    indices = np.flatnonzero(true)
    return int(indices[-1]) if len(indices) else 0


def first_rest(still: np.ndarray, count: int) -> int | None:
    """Where it first stands for ``count`` samples on end: a path turns back without a rest."""
    run = np.convolve(still, np.ones(count), "valid") >= count
    return first(run, 0)


def first(true: np.ndarray, start: int) -> int | None:
    """Where it is true for the first time, from ``start`` on."""
    indices = np.flatnonzero(true[start:])
    return start + int(indices[0]) if len(indices) else None


def summarise(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """The middle of several runs, and each by itself."""
    numbers: dict[str, Any] = {}
    for name in ("at_rest", "longest_hole", "samples_after", "path_goes_on"):
        values = [getattr(outcome, name) for outcome in outcomes if getattr(outcome, name) is not None]
        numbers[f"median_{name}"] = round(statistics.median(values), 3) if values else None
    return {
        "exit_statuses": [outcome.exit_status for outcome in outcomes],
        **numbers,
        "runs": [asdict(outcome) for outcome in outcomes],
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--series", choices=RATES, default="e")
    parser.add_argument("--only", help="one fault by its name")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    report: dict[str, Any] = {"schema": "labhil.ur5_faults/1", "series": options.series, "faults": {}}
    for reconnect in (False, True):
        for fault in [options.only] if options.only else FAULTS:
            outcomes = []
            for _ in range(options.repeat):
                with tempfile.TemporaryDirectory() as folder, suppress(NothingMovedError):
                    os.environ["XDG_RUNTIME_DIR"] = folder
                    outcomes.append(suffer(fault, "127.77.0.2", options.series, reconnect, Path(folder)))
            name = f"{fault}, reconnect" if reconnect else fault
            result = summarise(outcomes) | {"load_average": round(os.getloadavg()[0], 1)}
            report["faults"][name] = result
            print(name, json.dumps(result), file=sys.stderr, flush=True)
            if options.out is not None:
                options.out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    if options.out is None:
        print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
