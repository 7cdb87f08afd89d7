"""The emergency stop in every state of a run, pressed in every way. A command, no test:

    PYTHONPATH=benchmarks python benchmarks/measuring/measure_estop.py --repeat 3 -o FILE.json

A run drives a twin behind a relay that sees when the device is safe (as in ``measure_safety.py``). The stop
is pressed while the run starts, runs, is paused, or ends; and while it runs on a machine with twice as many
busy processes as cores, with a full disk (a small one of its own in memory, which root may mount; a limit on
the size of files for others), or with the host's connection to the bus cut. It is pressed by its file, by a
question on the bus, by ``labhil estop``, and by the key in a terminal UI. Each time the stop has to stand
afterwards, the device has to be safe, and the run's exit status (1) and its recording have to report an
emergency stop; on a full disk, which may hold no more, what the run prints.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import pty
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil

from kill_trials import read_all
from labhil.bus import latch
from labhil.bus.ask import ask, ask_all
from labhil.bus.keys import RUN, command_key
from labhil.bus.session import Bus, open_bus
from labhil.errors import BusError, CommandRefusedError, LabhilError
from labhil.recording.reader import read_recording
from measure_safety import EXPERIMENT, Relay, twin_behind_a_relay
from measured import tell
from victims import endpoint_of, family_of, process, wait_until

LABHIL = [sys.executable, "-P", "-m", "labhil"]
STATES = (
    "starting",
    "running",
    "paused",
    "stopping",
    "running, busy machine",
    "running, disk full",
    "running, bus cut",
)
DISK_MB = 64
"""MB of the disk that is filled; a recording needs 16 of them free."""

STOP_KEY = b"\x1b[24~"
"""F12, as a terminal sends it."""


class Run:
    """A run of its own, and its bus."""

    def __init__(self, relay: Relay, folder: Path, stack: ExitStack) -> None:
        (folder / "e.toml").write_text(EXPERIMENT.replace("ADDRESS", relay.address))
        self.folder, self.relay = folder, relay
        elsewhere = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        self.said = elsewhere / "said.txt"
        command = [*LABHIL, "run", str(folder / "e.toml"), "--out", str(folder)]
        self.process = stack.enter_context(process(command, elsewhere))
        self.endpoint = endpoint_of(self.process, "run")
        self.bus: Bus = stack.enter_context(open_bus(self.endpoint))

    def control(self, what: str) -> None:
        ask(self.bus, command_key(RUN, what), {"reason": "measured"}, 5.0, patience=10.0)

    def bring_to(self, state: str, stack: ExitStack) -> None:
        """Let the run be in this state; it may be over before anything is pressed while it stops."""
        if state == "starting":
            return
        self.relay.wait(safe=False)
        time.sleep(0.5)
        if state == "paused":
            self.control("pause")
        elif state == "stopping":
            threading.Thread(target=self._stop_in_the_background).start()
        elif state == "running, busy machine":
            for _ in range(2 * (os.cpu_count() or 1)):
                stack.enter_context(busy())
            time.sleep(0.5)
        elif state == "running, disk full":
            self._fill_disk()
        elif state == "running, bus cut":
            self._cut_bus()

    def _fill_disk(self) -> None:
        (part,) = self.folder.glob("*.part")
        if os.path.ismount(self.folder):
            with (self.folder / "filler").open("wb") as filler, suppress(OSError):
                while filler.write(bytes(1 << 20)):
                    filler.flush()
        else:
            resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (part.stat().st_size,) * 2)

    def _cut_bus(self) -> None:
        """Close the connections between the run's bus and the host; the run hears of no device any more."""
        hosts = [
            child.pid for child in family_of(self.process.pid) if "labhil.service.host" in child.cmdline()
        ]
        if not hosts:
            raise ValueError("the run has no host")
        for pid in hosts:
            for connection in psutil.Process(pid).net_connections(kind="tcp"):
                if connection.status == psutil.CONN_ESTABLISHED and self.relay.port != connection.raddr.port:
                    cut(connection.laddr.port)

    def _stop_in_the_background(self) -> None:
        with suppress(LabhilError):
            self.control("stop")


def cut(port: int) -> None:
    """Close the connection that this port of the machine is an end of."""
    subprocess.run(["ss", "-K", "-t", "sport", "=", f":{port}"], check=True, capture_output=True)


@contextmanager
def small_disk(folder: Path) -> Iterator[None]:
    """Let a folder be a disk of its own in memory, if one may be mounted."""
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(folder)]
    mounted = subprocess.run(mount, check=False, capture_output=True).returncode == 0
    try:
        yield
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)


@contextmanager
def busy() -> Iterator[None]:
    """A process that counts."""
    counting = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        counting.kill()
        counting.wait()


def by_file(_run: Run) -> None:
    latch.press("the meter", "measured")


def by_bus(run: Run) -> None:
    """Ask every host that is there until one has answered; while a run starts there is none yet."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        payload = {"action": "press", "by": "the meter", "reason": "measured"}
        answers = ask_all(run.bus, command_key("*", "estop"), payload, 1.0)
        if any(not isinstance(answer, (BusError, CommandRefusedError)) for answer in answers.values()):
            return
        if run.process.poll() is not None:
            return
        time.sleep(0.05)


def by_command(run: Run) -> None:
    done = subprocess.run(
        [*LABHIL, "estop", "--reason", "measured"],
        cwd=run.folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if not latch.read_latch():
        raise ValueError(f"labhil estop: exit {done.returncode}: {done.stderr}")


def by_key(run: Run) -> None:
    """Press the key in a terminal UI beside the run, as soon as it draws something."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm-256color"}
    command = [*LABHIL, "tui", "--connect", run.endpoint]
    screen = subprocess.Popen(
        command, cwd=run.folder, stdin=theirs, stdout=theirs, stderr=theirs, env=environment,
        start_new_session=True,
    )  # fmt: skip
    os.close(theirs)
    reader = threading.Thread(target=read_all, args=(ours,))
    reader.start()
    try:
        deadline = time.monotonic() + 30.0
        while latch.read_latch() is None and time.monotonic() < deadline:
            time.sleep(0.5)
            with suppress(OSError):
                os.write(ours, STOP_KEY)
    finally:
        screen.kill()
        screen.wait()
        reader.join()


WAYS: dict[str, Callable[[Run], None]] = {
    "file": by_file,
    "bus": by_bus,
    "command": by_command,
    "key": by_key,
}


TOO_LATE = {
    "starting": ("key",),
    "stopping": ("command", "key"),
    "running, disk full": ("command", "key"),
    "running, bus cut": ("bus", "command", "key"),
}
"""Ways that take seconds themselves: the run is in another state by then, or at its end. A bus that is cut
hands nothing on."""


def press(relay: Relay, state: str, way: str) -> dict[str, Any]:
    """Press the stop once, and return the outcome."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        if state == "running, disk full":
            stack.enter_context(small_disk(folder))
        run = Run(relay, folder, stack)
        run.bring_to(state, stack)
        if run.process.poll() is not None:
            raise ValueError("the run had ended before")
        was_active, began = not relay.safe, time.monotonic()
        WAYS[way](run)
        run.process.wait(60)
        outcome: dict[str, Any] = {"exit_status": run.process.returncode}
        outcome["latched"] = latch.read_latch() is not None
        outcome["device_safe"] = relay.safe
        if was_active and way in ("file", "bus") and relay.safe:
            outcome["safe_after_ms"] = round(1e3 * (relay.safe_since - began), 1)
        # where the disk is full, what a run prints is in a file elsewhere
        outcome["said"] = run.said.read_text()[-300:]
        paths = list(folder.glob("*.mcap*"))
        recording = read_recording(paths[0]) if paths else None
        end = {} if recording is None else recording.metadata.get("end", {})
        outcome["recorded_reason"] = end.get("reason", "no end")
        reasons = outcome["recorded_reason"] + outcome["said"]
        if "commands stopped" in reasons and "emergency stop" not in reasons:
            raise ValueError("the machine was too busy: the watchdog had ended the run before")
        outcome["recorded"] = recording is not None and any(
            "emergency stop" in str(event.body.get("message", "")) for event in recording.events
        )
    return outcome


def is_right(trial: dict[str, Any]) -> bool:
    """Whether the stop stands, the device is safe, and exit status and recording state the reason."""
    is_reported = "emergency stop" in trial["recorded_reason"] + trial["said"] or trial["recorded"]
    return bool(trial["latched"] and trial["device_safe"] and trial["exit_status"] == 1 and is_reported)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--only", help="parts of names of states or ways: a,b,…")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    result: dict[str, Any] = {"schema": "labhil.estop-states/1", "cells": {}}
    if options.only and options.out is not None and options.out.exists():
        result["cells"] = json.loads(options.out.read_text())["cells"]  # the other cells stay
    with twin_behind_a_relay() as relay:
        for state in STATES:
            for way in WAYS:
                name = f"{state}, by {way}"
                if way in TOO_LATE.get(state, ()):
                    continue
                if options.only and not any(part in name for part in options.only.split(",")):
                    continue
                trials = []
                for _ in range(options.repeat):
                    try:
                        trials.append(press(relay, state, way))
                    except (LabhilError, TimeoutError, ValueError, subprocess.TimeoutExpired) as error:
                        trials.append({"not_set_up": str(error)})
                    latch.release()
                    wait_until(lambda: relay.safe, "the device is safe")
                    print(f"{name}: {trials[-1]}", file=sys.stderr, flush=True)
                valid = [trial for trial in trials if "not_set_up" not in trial]
                cell = {"pressed": len(valid), "right": sum(map(is_right, valid)), "trials": trials}
                result["cells"][name] = {**cell, "load_average": round(os.getloadavg()[0], 1)}
                if options.out is not None:
                    tell(result, options.out)
    cells = result["cells"].values()
    result["pressed"], result["right"] = (sum(cell[key] for cell in cells) for key in ("pressed", "right"))
    safe = [t["safe_after_ms"] for cell in cells for t in cell["trials"] if "safe_after_ms" in t]
    result["largest_ms"] = max(safe, default=None)
    result["machine"] = {"cores": os.cpu_count(), "python": platform.python_version()}
    tell(result, options.out)


if __name__ == "__main__":
    main()
