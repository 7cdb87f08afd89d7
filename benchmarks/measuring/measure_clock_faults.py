"""What becomes of times where clocks are set, wrap, run fast or stand still. A command, no test:

    python benchmarks/measuring/measure_clock_faults.py --repeat 5 -o benchmarks/results/clock_faults.json

A `labhil run` records a device of ours, whose samples carry their number and which knows when it took each.
The processes of the run see clocks that are set as asked (``set_clock.c``, by LD_PRELOAD; it needs a C
compiler): the wall clock by an hour; for a suspend, the run stands still (SIGSTOP) while the wall clock,
CLOCK_BOOTTIME and the device go on, and the monotonic clock does not. No clock of the machine is set.
"""

from __future__ import annotations

import argparse
import os
import platform
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from clocked_device import MODULUS, RATE, STEP, ClockedDevice
from cut_wires import NOTICED
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording
from measured import tell
from victims import endpoint_of

LABHIL = (sys.executable, "-P", "-m", "labhil")
"""The command whose runs are measured; a test takes one whose hosts wait longer for commands."""

HOUR = 3600.0
BEFORE = 2.0
"""s of the run before something happens to a clock."""

PATIENCE = 60.0
WRAP = 2.0**32 * 1e-6
EXPERIMENT = """
[experiment]
name = "clock"
[devices.bench]
plugin = "ball_beam"
address = "ADDRESS"
reconnect = true
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "hold"
level = 0.05
duration = SECONDS
"""


class SetClocks:
    """The clocks that the processes of a run see."""

    def __init__(self, folder: Path) -> None:
        self.library, self._file = folder / "set_clock.so", folder / "clocks"
        source = Path(__file__).with_name("set_clock.c")
        compiler = ["cc", "-O2", "-shared", "-fPIC", "-o", str(self.library), str(source), "-ldl"]
        subprocess.run(compiler, check=True)
        self._wall_ns = self._steady_ns = 0
        self._file.write_bytes(bytes(16))

    def environment(self) -> dict[str, str]:
        """What a process needs to see them."""
        return {**os.environ, "LD_PRELOAD": str(self.library), "LABHIL_SET_CLOCK": str(self._file)}

    def set_wall(self, seconds: float) -> None:
        """Set the wall clock ahead, or back."""
        self._wall_ns += round(seconds * 1e9)
        self._write()

    def pass_by(self, ns: int) -> None:
        """Let so much time pass for which the monotonic clock stands still."""
        self._wall_ns += ns
        self._steady_ns += ns
        self._write()

    def _write(self) -> None:
        with self._file.open("r+b") as file:  # in place: it is mapped
            file.write(struct.pack("=qq", self._wall_ns, self._steady_ns))


@dataclass(frozen=True, slots=True)
class Scene:
    """A run, its device, and its clocks."""

    run: subprocess.Popen[bytes]
    device: ClockedDevice
    clocks: SetClocks

    def stop_all(self, number: int) -> None:
        """Send a signal to all processes of the run."""
        for member in [psutil.Process(self.run.pid), *psutil.Process(self.run.pid).children(recursive=True)]:
            with suppress(psutil.NoSuchProcess):
                os.kill(member.pid, number)

    def host(self) -> int:
        """The process id of the device's host."""
        children = psutil.Process(self.run.pid).children(recursive=True)
        return next(child.pid for child in children if "labhil.service.host" in child.cmdline())


def nothing(_scene: Scene) -> None:
    """Only what the device does by itself."""


def set_ahead(scene: Scene) -> None:
    scene.clocks.set_wall(HOUR)


def set_back(scene: Scene) -> None:
    scene.clocks.set_wall(-HOUR)


def set_to_and_fro(scene: Scene) -> None:
    for seconds in (HOUR, -2 * HOUR, HOUR):
        scene.clocks.set_wall(seconds)
        time.sleep(1.2)


def suspended(seconds: float) -> Callable[[Scene], None]:
    """The machine is suspended, and the device is not."""

    def suspend(scene: Scene) -> None:
        scene.stop_all(signal.SIGSTOP)
        time.sleep(NOTICED)
        scene.clocks.pass_by(scene.device.pass_by(seconds))
        scene.stop_all(signal.SIGCONT)

    return suspend


def host_stands_still(scene: Scene) -> None:
    pid = scene.host()
    os.kill(pid, signal.SIGSTOP)
    time.sleep(2.0)
    os.kill(pid, signal.SIGCONT)


def run_stands_still(scene: Scene) -> None:
    scene.stop_all(signal.SIGSTOP)
    time.sleep(3.0)
    scene.stop_all(signal.SIGCONT)


def device_stands_still(scene: Scene) -> None:
    scene.device.freeze(3.0)


@dataclass(frozen=True, slots=True)
class Case:
    """What happens, to which device, and the kinds of events that have to say so (one of them)."""

    act: Callable[[Scene], None]
    expected: tuple[str, ...] = ()
    drift: float = 0.0
    clock_start: float = 0.0
    seconds: float = 6.0


STOOD_STILL = ("lost", "quiet", "unheard")
CASES: Mapping[str, Case] = {
    "wall clock set ahead by 1 h": Case(set_ahead, ("clock_set",)),
    "wall clock set back by 1 h": Case(set_back, ("clock_set",)),
    "wall clock set by 1, -2, 1 h": Case(set_to_and_fro, ("clock_set",), seconds=8.0),
    "machine suspended for 20 s": Case(suspended(20.0), ("suspended",)),
    "machine suspended for 20 min": Case(suspended(1200.0), ("suspended",)),
    "machine suspended for 2 h": Case(suspended(7200.0), ("suspended",)),
    "host stopped for 2 s": Case(host_stands_still, STOOD_STILL),
    "run stopped for 3 s": Case(run_stands_still, STOOD_STILL),
    "device stands still for 3 s": Case(device_stands_still, ("lost",)),
    "micros() wraps": Case(nothing, clock_start=WRAP - 4.0),
    "micros() wraps while suspended": Case(suspended(20.0), ("suspended",), clock_start=WRAP - 15.0),
    "device 200 ppm fast": Case(nothing, drift=200e-6, seconds=20.0),
    "device 200 ppm slow": Case(nothing, drift=-200e-6, seconds=20.0),
}


def measure(case: Case, folder: Path) -> dict[str, Any]:
    """Make one run, and read what its recording says of times."""
    clocks = SetClocks(folder)
    with ExitStack() as stack:
        device = ClockedDevice(case.drift, case.clock_start)
        stack.callback(device.close)
        text = EXPERIMENT.replace("ADDRESS", device.address).replace("SECONDS", repr(case.seconds))
        (folder / "e.toml").write_text(text)
        log = stack.enter_context((folder / "said.txt").open("wb"))
        run = subprocess.Popen(
            [*LABHIL, "run", "e.toml"],
            cwd=folder, env=clocks.environment(), stdin=subprocess.DEVNULL, stdout=log, stderr=log,
        )  # fmt: skip
        stack.callback(run.kill)
        endpoint_of(run, "run")
        wait_for_recording(run, folder)
        time.sleep(BEFORE)
        case.act(Scene(run, device, clocks))
        run.wait(PATIENCE + case.seconds)
        taken = dict(device.taken)
    (path,) = folder.glob("*.mcap")
    return judge(read_recording(path), run.returncode, taken, case) | {
        "load_average": round(os.getloadavg()[0], 1)
    }


def wait_for_recording(run: subprocess.Popen[bytes], folder: Path) -> None:
    """Wait until samples are written."""
    deadline = time.monotonic() + PATIENCE
    while run.poll() is None and time.monotonic() < deadline:
        if any(path.stat().st_size > 4096 for path in folder.glob("*.mcap.part")):
            return
        time.sleep(0.02)
    raise ValueError(f"the run did not begin: {(folder / 'said.txt').read_text()[-300:]}")


def judge(recording: Recording, status: int, taken: Mapping[int, int], case: Case) -> dict[str, Any]:
    """Hold the recording's times against when the device took its samples."""
    stream = recording.stream_with("ball_position")
    shown = np.rint(stream["ball_position"] / STEP).astype(np.int64)
    numbers, unknown = identify(shown, stream.t_acq_ns, taken)
    own = numbers / RATE
    world = np.array([taken.get(number, 0) for number in numbers.tolist()], dtype=np.int64)
    known = world > 0
    holes = np.diff(stream.seq)[known[1:] & known[:-1]]
    skipped = np.diff(numbers)[known[1:] & known[:-1]]
    said = [(e.body.get("kind"), e.body.get("message", "")) for e in recording.events if e.topic != "status"]
    flags = [message for kind, message in said if kind in case.expected]
    clock = recording.clocks.get("bench")
    spacing, common = stream.t - own, (stream.t_common - world * 1e-9)[known]
    result: dict[str, Any] = {
        "exit_status": status,
        "end": recording.metadata.get("end", {}).get("reason", "no end"),
        "samples": len(shown),
        "not_ours": unknown,
        "out_of_order": int(
            sum(np.count_nonzero(np.diff(x) <= 0) for x in (stream.seq, stream.t_hw_ns, stream.t))
            + np.count_nonzero(np.diff(stream.t_acq_ns) < 0)
            + np.count_nonzero(np.diff(numbers) <= 0)
        ),
        "missing": int(np.sum(skipped - 1)),
        "missing_by_seq": int(np.sum(holes - 1)),
        "spacing_error_ms": round(1e3 * float(np.ptp(spacing)), 3),
        "unix_time_error_ms": spread_of((stream.t_acq_ns - world)[known] * 1e-6),
        "alignment_error_ms": round(1e3 * float(np.max(np.abs(common - np.median(common)))), 3),
        "flagged": bool(flags) or not case.expected,
        "flags": sorted(set(flags))[:4],
        "warnings": [fault.statement for fault in stream.clock_faults],
    }
    if clock is not None:
        result["drift_ppm"] = round(1e6 * clock.drift, 2)
        result["stated_drift_error_ppm"] = round(1e6 * clock.drift_error, 2)
    return result


def identify(shown: np.ndarray, t_acq_ns: np.ndarray, taken: Mapping[int, int]) -> tuple[np.ndarray, int]:
    """The number of each sample, which shows only its last digits; and how many show other ones."""
    taken_numbers = np.array(sorted(taken), dtype=np.int64)
    first = [n for n in taken_numbers.tolist() if n % MODULUS == shown[0]]
    start = min(first, key=lambda n: abs(taken[n] - int(t_acq_ns[0])))
    steps = np.diff(shown) % MODULUS
    numbers = start + np.concatenate([[0], np.cumsum(steps)])
    # after a gap the device may have gone round more than once: the next ones that were taken tell
    for row in np.flatnonzero(np.diff(t_acq_ns) > 2_000_000_000) + 1:
        after = [n for n in taken_numbers.tolist() if n % MODULUS == shown[row] and n > numbers[row - 1]]
        if after:
            numbers[row:] += after[0] - numbers[row]
    return numbers, int(np.count_nonzero(~np.isin(numbers, taken_numbers)))


def spread_of(values: Sequence[float] | np.ndarray) -> dict[str, float]:
    """The smallest, the median and the largest."""
    low, middle, high = np.quantile(np.asarray(values, dtype=float), [0.0, 0.5, 1.0])
    return {
        "smallest": round(float(low), 2),
        "median": round(float(middle), 2),
        "largest": round(float(high), 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--only", help="part of a case's name")
    parser.add_argument("--keep", type=Path, help="a folder for the recordings")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    result: dict[str, Any] = {"schema": "labhil.clock_faults/1", "cases": {}}
    for name, case in CASES.items():
        if options.only and options.only not in name:
            continue
        runs: list[dict[str, Any]] = []
        for repeat in range(options.repeat):
            with ExitStack() as stack:
                folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
                if options.keep is not None:
                    folder = options.keep / f"{len(result['cases'])}-{repeat}"
                    folder.mkdir(parents=True)
                os.environ["XDG_RUNTIME_DIR"] = str(folder)
                try:
                    runs.append(measure(case, folder))
                except (ValueError, subprocess.TimeoutExpired) as error:
                    runs.append({"not_set_up": str(error)})
            print(name, runs[-1], file=sys.stderr, flush=True)
        result["cases"][name] = runs
    result["machine"] = {"cores": os.cpu_count(), "python": platform.python_version()}
    tell(result, options.out)


if __name__ == "__main__":
    main()
