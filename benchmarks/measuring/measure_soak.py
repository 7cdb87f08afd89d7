"""What a lab at work costs: three rigs, recorder, worker and screen, for two hours. A command, no test:

    python benchmarks/measuring/measure_soak.py --minutes 120 -o benchmarks/results/soak.json

``labhil serve`` keeps twins of ball and beam, DC motor and solenoid up, begins a new recording every few
minutes, and its worker fits and diagnoses each rig in each of them. ``labhil tui`` shows charts in a terminal
of 160 x 50 characters (a pseudo-terminal that is read all the time). This program moves the rigs on sines
over the bus. Every two seconds it notes what each process has used, and how long each host takes to answer.
CPU is in per cent of one core; memory is what is resident; handles are open files and sockets.

What should stay flat is stated as a slope per hour, and for six equal parts of the time.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import platform
import re
import statistics
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from lab_at_work import open_screen, serving
from labhil.bus.ask import ask
from labhil.bus.keys import command_key, setpoint_key
from labhil.bus.publish import publish_command
from labhil.bus.session import Bus, open_bus
from labhil.errors import CommandRefusedError
from labhil.recording.reader import read_recording
from labhil.recording.recording import StreamData
from labhil.service.messages import Setpoint
from labhil.signals import FloatArray
from measured import tell
from soak_rigs import RIGS

LAB = """
[lab]
name = "soak"
roll = ROLL
"""
DEVICE = """
[devices.KIND]
plugin = "KIND"
address = "twin"
rig = "KIND.toml"
twin = { seed = 1 }
reconnect = true
"""
COMMANDS_EVERY = 0.02
HOLDER = "soak"
LOOK_EVERY = 2.0
SETTLED = 60.0
"""Memory is compared with what it was after so many s, once buffers are filled."""
PATIENCE = 60.0
PARTS = 6
"""Equal parts of the time that are compared."""
ROLES = (
    ("labhil.service.host", "host"),
    ("labhil.campaign.studies.study", "study"),
    ("labhil twin", "twin"),
    ("labhil serve", "serve (recorder, worker)"),
    ("labhil tui", "tui"),
)


@dataclass
class Usage:
    """What the processes of one role used: one entry per look, and the total."""

    at: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)
    handles: list[int] = field(default_factory=list)
    threads: list[int] = field(default_factory=list)
    seconds: float = 0.0


class Meter:
    """Looks at processes and their descendants; CPU seconds of those that ended in between are lost."""

    def __init__(self, roots: list[int]) -> None:
        self._roots = [psutil.Process(pid) for pid in roots]
        self._before: dict[tuple[int, float], float] = {}
        self.usage: dict[str, Usage] = defaultdict(Usage)
        self.began = self._looked = time.monotonic()
        self._first = True

    def look(self) -> None:
        now = time.monotonic()
        cpu: dict[str, float] = defaultdict(float)
        memory: dict[str, float] = defaultdict(float)
        handles: dict[str, int] = defaultdict(int)
        threads: dict[str, int] = defaultdict(int)
        for process in self._all():
            with contextlib.suppress(psutil.Error):
                role = role_of(" ".join(process.cmdline()))
                key = (process.pid, process.create_time())
                times = process.cpu_times()
                spent = times.user + times.system
                cpu[role] += spent - self._before.get(key, spent if self._first else 0.0)
                memory[role] += process.memory_info().rss / 1e6
                handles[role] += process.num_fds()
                threads[role] += process.num_threads()
                self._before[key] = spent
        for role, spent in cpu.items() if not self._first else ():
            usage = self.usage[role]
            usage.at.append(now - self.began)
            usage.cpu.append(100 * spent / (now - self._looked))
            usage.memory.append(memory[role])
            usage.handles.append(handles[role])
            usage.threads.append(threads[role])
            usage.seconds += spent
        self._looked, self._first = now, False

    def _all(self) -> Iterator[psutil.Process]:
        for root in self._roots:
            with contextlib.suppress(psutil.Error):
                yield root
                yield from root.children(recursive=True)


def role_of(command: str) -> str:
    return next((role for sign, role in ROLES if sign in command), "other")


@contextmanager
def screen(
    folder: Path, endpoint: str, size: tuple[int, int], tab: str, output: list[bytes]
) -> Iterator[int]:
    """``labhil tui`` in a terminal of that many columns and rows; what it draws is read and counted."""
    process, ours = open_screen(folder, endpoint, size)
    reader = threading.Thread(target=drain, args=(ours, output))
    reader.start()
    try:
        deadline = time.monotonic() + PATIENCE
        while len(re.findall(rb"of \d+ signals", b"".join(output[-50:]))) == 0 and tab == "2":
            if time.monotonic() > deadline:
                raise TimeoutError("the screen shows no charts")
            os.write(ours, tab.encode())
            time.sleep(1.0)
        os.write(ours, tab.encode())
        yield process.pid
        os.write(ours, b"q")
        process.wait(PATIENCE)
    finally:
        process.kill()
        process.wait()
        reader.join()
        os.close(ours)


def drain(terminal: int, output: list[bytes]) -> None:
    """Read until the other side is closed; only lengths are kept of what is old."""
    while True:
        try:
            data = os.read(terminal, 1 << 16)
        except OSError:
            return
        if not data:
            return
        output.append(data)
        if len(output) > 200:
            output[:100] = [b"".join(output[:100])[-1:]]


@contextmanager
def lab(folder: Path, roll: float) -> Iterator[tuple[int, str]]:
    """``labhil serve`` with its process id and the endpoint of its bus."""
    devices = [DEVICE.replace("KIND", rig.kind) for rig in RIGS]
    (folder / "lab.toml").write_text("".join([LAB.replace("ROLL", repr(roll)), *devices]), encoding="utf-8")
    for rig in RIGS:
        (folder / f"{rig.kind}.toml").write_text(rig.file, encoding="utf-8")
    with serving(folder, "said.txt", PATIENCE) as running:
        yield running


class Mover:
    """Moves the rigs on their sines; setpoints go out fifty times a second."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._over = threading.Event()
        self._tokens: dict[str, str] = {}
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        self.taken = dict.fromkeys((rig.kind for rig in RIGS), 0)
        self.refused = dict.fromkeys((rig.kind for rig in RIGS), 0)
        for rig in RIGS:  # each moves from then on: a lease that is not used runs out
            self.take(rig.kind)

    def take(self, device: str) -> None:
        """Take the lease of a device: it ran out where a busy machine held up this program for too long.

        A refusal is counted: a device that stood still is looked for again, and has no leases meanwhile.
        """
        request = {"action": "take", "holder": HOLDER}
        try:
            answer = ask(self._bus, command_key(device, "lease"), request, patience=PATIENCE)
        except CommandRefusedError:
            self.refused[device] += 1
            return
        self._tokens[device] = str(answer["token"])
        self.taken[device] += 1

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        for rig in RIGS:
            with contextlib.suppress(CommandRefusedError):  # a device that is away is safe by its watchdog
                ask(self._bus, command_key(rig.kind, "safe"), {"reason": "the soak is over"})

    def _run(self) -> None:
        began = time.monotonic()
        while not self._over.wait(COMMANDS_EVERY):
            t = time.monotonic() - began
            for rig in [rig for rig in RIGS if rig.kind in self._tokens]:
                setpoint = Setpoint(self._tokens[rig.kind], time.time_ns(), {rig.signal: rig.setpoint(t)})
                publish_command(self._bus, setpoint_key(rig.kind), setpoint.to_bytes())


def time_answers(bus: Bus, mover: Mover) -> list[float]:
    """How long each host takes to answer the question for its state, s; a lost lease is taken again."""
    took = []
    for rig in RIGS:
        asked = time.perf_counter()
        status = ask(bus, command_key(rig.kind, "status"))
        took.append(time.perf_counter() - asked)
        if status["holder"] != HOLDER:
            mover.take(rig.kind)
    return took


def soak(seconds: float, roll: float, size: tuple[int, int], tab: str, folder: Path) -> dict[str, Any]:
    """Let all of it run; returns what it used and what was recorded."""
    output: list[bytes] = []
    load, answers = [], []
    with ExitStack() as stack:
        service, endpoint = stack.enter_context(lab(folder, roll))
        wait_for(folder, "is up")
        bus = stack.enter_context(open_bus(endpoint))
        mover = Mover(bus)
        stack.callback(mover.close)
        looks = stack.enter_context(screen(folder, endpoint, size, tab, output))
        meter = Meter([service, looks])
        meter.look()
        while time.monotonic() - meter.began < seconds:
            time.sleep(LOOK_EVERY)
            meter.look()
            answers.append(time_answers(bus, mover))
            load.append(os.getloadavg()[0])
        # numbers of processes that are gone would be missing, so results are counted while all is up
    return {
        "processes": {role: summarise_usage(usage, seconds) for role, usage in sorted(meter.usage.items())},
        "leases_taken": mover.taken,
        "leases_refused": mover.refused,
        "answers_of_hosts_ms": in_parts(np.array(answers)),
        "recordings": {rig.kind: summarise_recordings(folder, rig.kind) for rig in RIGS},
        "results": {kind: len(list(folder.glob(f"*.{kind}.json"))) for kind in ("fit", "diagnosis")},
        "load_average": {"median": round(statistics.median(load), 1), "largest": round(max(load), 1)},
    }


def wait_for(folder: Path, words: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while words not in (folder / "said.txt").read_text(encoding="utf-8"):
        if time.monotonic() > deadline:
            raise TimeoutError((folder / "said.txt").read_text(encoding="utf-8"))
        time.sleep(0.1)


def summarise_usage(usage: Usage, seconds: float) -> dict[str, Any]:
    """What one role used: shares of a core in per cent, memory in MB, its slope once settled in MB/h."""
    at, memory = np.array(usage.at), np.array(usage.memory)
    later = at >= min(SETTLED, at[-1] / 2)
    slope = float(np.polyfit(at[later], memory[later], 1)[0]) * 3600 if later.sum() > 2 else None
    return {
        "cpu_percent": {
            "mean": round(100 * usage.seconds / seconds, 1),
            "median": round(statistics.median(usage.cpu), 1),
            "largest": round(max(usage.cpu), 1),
        },
        "memory_mb": {
            "start": round(float(memory[0]), 1),
            "after_1_min": round(float(memory[later][0]), 1),
            "end": round(float(memory[-1]), 1),
            "largest": round(float(memory.max()), 1),
        },
        "slope_mb_per_hour": None if slope is None else round(slope, 1),
        "memory_mb_in_parts": [
            round(float(np.median(part)), 1) for part in np.array_split(memory, PARTS) if len(part)
        ],
        "handles": {"start": usage.handles[0], "end": usage.handles[-1], "largest": max(usage.handles)},
        "threads": {"start": usage.threads[0], "end": usage.threads[-1], "largest": max(usage.threads)},
        "looks": len(at),
    }


def in_parts(seconds: FloatArray) -> dict[str, Any]:
    """Times in ms: of all, and of each equal part of the time in turn."""
    parts = np.array_split(1e3 * seconds, PARTS)
    return {
        "median": round(1e3 * float(np.median(seconds)), 3),
        "p99_9": round(1e3 * float(np.percentile(seconds, 99.9)), 3),
        "largest": round(1e3 * float(seconds.max()), 3),
        "median_in_parts": [round(float(np.median(part)), 3) for part in parts if part.size],
        "p99_9_in_parts": [round(float(np.percentile(part, 99.9)), 3) for part in parts if part.size],
        "largest_in_parts": [round(float(part.max()), 3) for part in parts if part.size],
    }


def summarise_recordings(folder: Path, device: str) -> dict[str, Any]:
    """What the recordings say of a rig: each by itself, and all of them as one row of samples."""
    streams: list[StreamData] = []
    gaps = commands = 0
    for path in sorted(folder.glob("*.mcap")):
        recording = read_recording(path)
        if not recording.complete:
            raise SystemExit(f"{path}: {recording.damage}")
        mine = [data for data in recording.streams if data.device == device]
        streams += [data for data in mine if data.stream.name == "state"]
        commands += sum(len(data) for data in mine if data.stream.name == "command")
        gaps += sum(data.lost for data in mine)
    seq, first = np.unique(np.concatenate([data.seq for data in streams]), return_index=True)
    t = np.concatenate([data.t_acq_ns for data in streams])[first] * 1e-9
    return {
        "files": len(streams),
        "samples": len(seq),
        "gaps_within_files": gaps,
        "missing_over_all_files": int(seq[-1] - seq[0] + 1 - len(seq)),
        "samples_in_two_files": int(sum(len(data) for data in streams) - len(seq)),
        "rate_hz": round((len(seq) - 1) / float(t[-1] - t[0]), 3),
        "commands": commands,
        "step_ms": in_parts(np.diff(t)),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=120.0)
    parser.add_argument("--roll", type=float, default=300.0, help="s; length of a recording")
    parser.add_argument("--size", default="160x50", help="of the terminal")
    parser.add_argument("--tab", default="2", help="the tab that is in front")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    columns, rows = (int(part) for part in options.size.split("x"))
    with tempfile.TemporaryDirectory() as directory:
        os.environ["XDG_RUNTIME_DIR"] = directory
        folder = Path(directory) / "lab"
        folder.mkdir()
        try:
            figures = soak(60 * options.minutes, options.roll, (columns, rows), options.tab, folder)
        except BaseException:
            print((folder / "said.txt").read_text(encoding="utf-8")[-20_000:], file=sys.stderr)
            raise
    result = {
        "schema": "labhil.soak/2",
        "minutes": options.minutes,
        "rigs": [rig.kind for rig in RIGS],
        "roll_s": options.roll,
        "terminal": options.size,
        "machine": {"cores": os.cpu_count(), "python": platform.python_version()},
        **figures,
    }
    tell(result, options.out)


if __name__ == "__main__":
    main()
