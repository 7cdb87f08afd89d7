"""How long a key of the terminal UI takes with three rigs streaming. A command, no test:

    python benchmarks/measuring/measure_keys.py --keys 100 -o benchmarks/results/keys.json

``labhil serve`` keeps twins of ball and beam, DC motor and solenoid up and records them; ``labhil tui`` shows
charts of them in a terminal of 160 x 50 characters. This program presses the keys of two panes in turn and
waits until the pane's words are drawn: with all cores for all, with the screen on a core on which another
process computes all the time, and with everything (twins, hosts, recorder, screen) on one core.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from lab_at_work import open_screen, serving
from labhil.signals import FloatArray
from measured import tell

RIGS = ("ball_beam", "dc_motor", "solenoid")
PANES = {"2": rb"of \d+ signals", "4": rb"duration"}
"""Keys, and words that only the pane behind each draws."""
FREE, BUSY, ONE = ("all cores", "the screen on a busy core", "everything on one core")
ESCAPES = re.compile(rb"\x1b\[[0-9;?]*[a-zA-Z]")
PATIENCE = 90.0
PAUSE = 0.4
SETTLE = 8.0


class Screen:
    """A terminal in which ``labhil tui`` runs as process ``pid``."""

    def __init__(self, terminal: int, pid: int) -> None:
        self._terminal = terminal
        self._schedule = Path(f"/proc/{pid}/task/{pid}/schedstat")

    def press(self, key: str, words: bytes) -> tuple[float, float, float]:
        """Press a key, and wait until the words are drawn.

        Returns how long it took, the processor time of the screen's thread until then, and how long that
        thread waited for a core, all in s.
        """
        self.drain(0.0)
        (spent, waited), text, pressed = self._times(), b"", time.perf_counter()
        os.write(self._terminal, key.encode())
        while not re.search(words, ESCAPES.sub(b"", text)):
            if time.perf_counter() - pressed > PATIENCE:
                raise TimeoutError(f"key {key}: {words!r} was not drawn within {PATIENCE:g} s")
            text += self._read(0.1)
        took, (spent_then, waited_then) = time.perf_counter() - pressed, self._times()
        return took, spent_then - spent, waited_then - waited

    def _times(self) -> tuple[float, float]:
        """Processor time of the thread so far, and the time it has waited for a core, s."""
        spent, waited, _ = self._schedule.read_text(encoding="ascii").split()
        return int(spent) * 1e-9, int(waited) * 1e-9

    def drain(self, seconds: float) -> None:
        """Read what is drawn for so long."""
        until = time.perf_counter() + seconds
        while self._read(max(0.0, until - time.perf_counter())) or time.perf_counter() < until:
            pass

    def _read(self, patience: float) -> bytes:
        ready, _, _ = select.select([self._terminal], [], [], patience)
        return os.read(self._terminal, 1 << 16) if ready else b""


@contextmanager
def lab(folder: Path) -> Iterator[tuple[psutil.Process, str]]:
    """``labhil serve`` with three twins, and the endpoint of its bus."""
    devices = [
        f'[devices.{rig}]\nplugin = "{rig}"\naddress = "twin"\ntwin = {{ seed = 1 }}\n' for rig in RIGS
    ]
    (folder / "lab.toml").write_text('[lab]\nname = "keys"\n' + "".join(devices), encoding="utf-8")
    with serving(folder, "serve.txt", PATIENCE) as (pid, endpoint):
        yield psutil.Process(pid), endpoint


@contextmanager
def screen(folder: Path, endpoint: str, size: tuple[int, int]) -> Iterator[tuple[psutil.Process, Screen]]:
    """``labhil tui`` in a terminal of so many columns and rows."""
    process, ours = open_screen(folder, endpoint, size)
    try:
        yield psutil.Process(process.pid), Screen(ours, process.pid)
    finally:
        process.kill()
        process.wait()
        os.close(ours)


@contextmanager
def computing(cores: list[int]) -> Iterator[None]:
    """A process beside that computes all the time."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    psutil.Process(process.pid).cpu_affinity(cores)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def all_of(roots: list[psutil.Process]) -> list[psutil.Process]:
    return [process for root in roots for process in (root, *root.children(recursive=True))]


def processor_seconds(processes: list[psutil.Process]) -> float:
    return sum(sum(process.cpu_times()[:2]) for process in processes if process.is_running())


def pin(processes: list[psutil.Process], cores: list[int]) -> None:
    """Keep every thread of these processes to some cores."""
    for process in processes:
        for thread in process.threads():
            os.sched_setaffinity(thread.id, cores)


def measure(keys: int, size: tuple[int, int], where: str, folder: Path) -> dict[str, Any]:
    """Press keys in turn; how long each took, and what share of a core all of it used."""
    last = [max(os.sched_getaffinity(0))]
    with ExitStack() as stack:
        service, endpoint = stack.enter_context(lab(folder))
        shown, terminal = stack.enter_context(screen(folder, endpoint, size))
        terminal.drain(SETTLE)
        for key, words in PANES.items():
            terminal.press(key, words)
        everything = all_of([service, shown])
        if where == BUSY:
            stack.enter_context(computing(last))
            pin([shown], last)
        elif where == ONE:
            pin(everything, last)
        terminal.drain(SETTLE)
        spent, began = processor_seconds(everything), time.perf_counter()
        pressed = []
        for k in range(keys):
            key = list(PANES)[k % len(PANES)]
            pressed.append(terminal.press(key, PANES[key]))
            terminal.drain(PAUSE)
        share = (processor_seconds(everything) - spent) / (time.perf_counter() - began)
    took, processor, waited = 1e3 * np.array(pressed).T
    return {
        "keys": keys,
        "milliseconds": quantiles(took),
        "processor_milliseconds": quantiles(processor),
        "milliseconds_waited_for_a_core": quantiles(waited),
        "within_100_ms": int(np.sum(took <= 100.0)),
        "cores_used": round(share, 2),
    }


def quantiles(values: FloatArray) -> dict[str, float]:
    """Median, 95th percentile and the largest."""
    figures = zip(("median", "p95", "largest"), np.percentile(values, (50, 95, 100)), strict=True)
    return {name: round(float(value), 1) for name, value in figures}


def main() -> None:
    """Measure in all three ways."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--keys", type=int, default=100)
    parser.add_argument("--size", default="160x50", help="of the terminal")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    columns, rows = (int(part) for part in options.size.split("x"))
    measured, load_before = {}, os.getloadavg()[0]
    for where in (FREE, BUSY, ONE):
        with tempfile.TemporaryDirectory() as directory:
            os.environ["XDG_RUNTIME_DIR"] = directory
            folder = Path(directory) / "lab"
            folder.mkdir()
            measured[where] = measure(options.keys, (columns, rows), where, folder)
    tell(
        {
            "schema": "labhil.keys/1",
            "terminal": options.size,
            "rigs": RIGS,
            "machine": {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()},
            "load": [round(value, 1) for value in (load_before, os.getloadavg()[0])],
            "results": measured,
        },
        options.out,
    )


if __name__ == "__main__":
    main()
