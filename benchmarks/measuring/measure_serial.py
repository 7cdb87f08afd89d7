"""What comes over the solenoid's serial line, and how late it is in the file. A command, no test:

    python benchmarks/measuring/measure_serial.py --seconds 600 -o benchmarks/results/serial.json
    python benchmarks/measuring/measure_serial.py --seconds 600 --listen    # nobody commands the coil

A run as `labhil run` makes it, once at 1 kHz and once at 10 kHz: the twin on a pseudo terminal, the driver in
its host, zenoh, the recorder, the file. The coil is switched at random (a PRBS of 20 ms). A frame is late by
how much older it is, when the driver has it, than the promptest one within 2 s. A sample has come when the
recorder has put it into its file, counted from the host's stamp. When that is forced to the disk is another
matter: every 0.2 s.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from scipy.ndimage import minimum_filter1d

from labhil.codec import stamps_of
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.result import RunResult
from labhil.experiment.run import run_experiment
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording, StreamData
from labhil.recording.writer import RecordingWriter
from labhil.service import recorder
from labhil.signals import Batch, FloatArray
from listening import ListeningResult, record_listening
from measured import tell

PER_FRAME = {1000: 5, 10_000: 20}
NEIGHBOURHOOD = 2.0
QUANTILES = {"median": 0.5, "p99": 0.99, "p99_99": 0.9999, "largest": 1.0}
LATE_MS = (10, 50, 100)
DEVICE = """
[devices.coil]
plugin = "solenoid"
address = "twin"
twin = { seed = 1, set = { sample_rate = RATE, samples_per_frame = FRAME } }
"""
EXPERIMENT = f"""
[experiment]
name = "serial"
{DEVICE}
[[steps]]
device = "coil"
signal = "coil_current_command"
excitation = "prbs"
low = 0.0
high = 1.5
dwell = 0.02
duration = SECONDS
"""


class TimedWriter(RecordingWriter):
    """The recorder's writer, with a note of how old each sample was when it had been written."""

    ages: list[FloatArray]

    def write(self, channel: int, samples: Batch | Sequence[bytes]) -> None:
        super().write(channel, samples)
        if not isinstance(samples, Batch) and len(self._codecs[channel].stream.signals) > 2:
            self.ages.append((time.time_ns() - stamps_of(samples)[:, 1]) * 1e-9)


class Meter(threading.Thread):
    """Processor time of this process and its children (s), and the load of the machine, once a second."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.over = threading.Event()
        self.seconds: dict[str, float] = {}
        self.loads: list[float] = []

    def run(self) -> None:
        me = psutil.Process()
        before: dict[str, float] = {}
        while not self.over.wait(1.0):
            if not TimedWriter.ages:
                continue  # what it takes to begin is no part of it
            self.loads.append(os.getloadavg()[0])
            for process in (me, *me.children()):
                try:
                    part = _part(process, me)
                    used = _cpu(process)
                except psutil.Error:
                    continue
                self.seconds[part] = used - before.setdefault(part, used)


def _part(process: psutil.Process, me: psutil.Process) -> str:
    if process == me:
        return "recorder and runner"
    return "twin" if "twin" in process.cmdline() else "host with driver"


def _cpu(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def measure(rate: int, seconds: float, folder: Path, *, listen: bool) -> dict[str, Any]:
    """One run at ``rate`` (Hz) of so many seconds of the device's clock, or as long without commands."""
    text = (DEVICE if listen else EXPERIMENT).replace("RATE", f"{rate}.0")
    text = text.replace("FRAME", f"{PER_FRAME[rate]}.0").replace("SECONDS", f"{seconds}")
    TimedWriter.ages = []
    meter = Meter()
    meter.start()
    result: RunResult | ListeningResult
    if listen:
        result = record_listening(text, seconds, folder)
    else:
        result = run_experiment(parse_experiment(text, folder / "e.toml"), folder)
    meter.over.set()
    meter.join()
    if result.path is None:
        raise SystemExit(f"the run failed: {result.reason}")
    size = result.path.stat().st_size
    recording = read_recording(result.path)
    state = next(data for data in recording.streams if data.stream.name == "state")
    lasted = float(state.t_acq_ns[-1] - state.t_acq_ns[0]) * 1e-9
    late, paused = lateness(state)
    late_ms, counters = 1e3 * late, counters_of(recording)
    return {
        "rate": rate,
        "samples_per_frame": PER_FRAME[rate],
        "commanded": not listen,
        "exit_status": result.exit_status,
        "ended": result.reason,
        "seconds": round(lasted, 1),
        "samples": len(state),
        "frames": counters["frames"],
        "samples_lost": int(state.lost),
        "crc_errors": counters["crc_errors"],
        "resyncs": counters["resyncs"],
        "world_paused_s": round(paused, 3),
        "frames_late_ms": _quantiles(late_ms),
        "frames_later_than": {f"{limit} ms": int(np.sum(late_ms > limit)) for limit in LATE_MS},
        "acquisition_to_recorder_ms": _quantiles(1e3 * np.concatenate(TimedWriter.ages)),
        "cpu_share_of_a_core": {name: round(s / lasted, 3) for name, s in meter.seconds.items()},
        "file_bytes_per_sample": round(size / len(state), 1),
        "load_average": [round(min(meter.loads), 1), round(max(meter.loads), 1)],
    }


def lateness(state: StreamData) -> tuple[FloatArray, float]:
    """How late each frame was (s), and for how long the twin's world stood still (s)."""
    last = np.flatnonzero(np.diff(state.t_acq_ns, append=state.t_acq_ns[-1] + 1))
    age = (state.t_acq_ns[last] - state.t_hw_ns[last]) * 1e-9
    near = max(1, round(NEIGHBOURHOOD / np.median(np.diff(state.t_hw_ns[last])) * 1e9))
    promptest = minimum_filter1d(age, near)
    # a clock that has stood still is behind for good; its own drift is far less
    steps = np.diff(promptest[::near])
    return age - promptest, float(steps[steps > 0.005].sum())


def counters_of(recording: Recording) -> dict[str, int]:
    """What the driver had counted when its host ended."""
    counters = [event.body["counters"] for event in recording.events if "counters" in event.body]
    return dict(counters[-1])


def _quantiles(values: FloatArray) -> dict[str, float]:
    return {name: round(float(np.quantile(values, q)), 2) for name, q in QUANTILES.items()}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--rate", type=int, nargs="+", choices=PER_FRAME, default=list(PER_FRAME))
    parser.add_argument("--listen", action="store_true", help="without commands, as labhil serve")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    recorder.RecordingWriter = TimedWriter  # type: ignore[misc]
    runs = []
    for rate in options.rate:
        with tempfile.TemporaryDirectory() as directory:
            os.environ["XDG_RUNTIME_DIR"] = directory
            runs.append(measure(rate, options.seconds, Path(directory), listen=options.listen))
        print(runs[-1], file=sys.stderr, flush=True)
    machine = {"cores": os.cpu_count(), "python": platform.python_version()}
    tell({"schema": "labhil.serial/1", "machine": machine, "runs": runs}, options.out)


if __name__ == "__main__":
    main()
