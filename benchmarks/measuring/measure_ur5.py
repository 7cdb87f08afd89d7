"""What of a UR5's samples gets into the file at 500 Hz, and what the client's getters would lose. A command:

    python benchmarks/measuring/measure_ur5.py record --seconds 600 -o benchmarks/results/ur5_record.json
    python benchmarks/measuring/measure_ur5.py record --listen    # nobody commands the arm
    python benchmarks/measuring/measure_ur5.py getters --seconds 60 -o benchmarks/results/ur5_getters.json

Both use the simulated arm. ``record`` is a whole `labhil run` of a Fourier path on all six joints (whole
periods of 20 s): the timestamps, which go up by one period each, show what the controller sent. The simulated
controller counts the samples that it had no time to send and reports them at its end; these are subtracted,
the rest is ours. ``getters`` polls ur_rtde as its examples do, beside this project's reader on the same
controller, first on the machine as it is, then with as many busy loops as it has cores. A sample that the
reader got and no poll saw is lost. The controller would be a machine of its own: where that is allowed, the
simulated one gets real-time priority, and nothing else does.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from labhil.experiment.experiment import parse_experiment
from labhil.experiment.result import RunResult
from labhil.experiment.run import run_experiment
from labhil.recording.reader import read_recording
from listening import ListeningResult, record_listening
from measured import tell

HOST = "127.77.0.1"
RATE = 500.0
EXAMPLE = Path(__file__).parents[2] / "labhil/experiment/examples/ur5_identify.toml"
HERE = str(Path(__file__).resolve())
DEVICE = """
[devices.arm]
plugin = "ur5"
address = "HOST"
"""
BUSY = "while True: pass"
TOO_SLOW = re.compile(r"too slow: (\d+) ticks left out, (\d+) too late")


@contextmanager
def twin(log: Path) -> Iterator[str]:
    """A simulated controller of the e-Series; its messages go to a file."""
    with log.open("w") as errors:
        command = [sys.executable, "-P", "-m", "labhil", "twin", "ur5", "--host", HOST, "--seed", "1"]
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
        )
        assert process.stdin is not None and process.stdout is not None
        try:
            if process.stdout.readline().strip() != HOST:
                raise SystemExit(f"the twin did not start: {log.read_text()}")
            with contextlib.suppress(PermissionError):
                os.sched_setscheduler(process.pid, os.SCHED_FIFO, os.sched_param(1))
            yield HOST
        finally:
            process.stdin.close()
            process.wait(10)
            process.stdout.close()


def not_sent(log: Path) -> tuple[int, int]:
    """Cycles that the simulated controller left out of its clock, and those that it ran but did not send."""
    match = TOO_SLOW.search(log.read_text())
    return (int(match[1]), int(match[2])) if match else (0, 0)


def percentiles(values: np.ndarray) -> dict[str, float]:
    p50, p99, p999 = np.percentile(values, [50, 99, 99.9])
    return {
        "p50": round(float(p50), 3),
        "p99": round(float(p99), 3),
        "p99_9": round(float(p999), 3),
        "largest": round(float(values.max()), 3),
    }


def record(seconds: float, *, listen: bool = False) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        directory, log = Path(folder), Path(folder) / "said"
        text = EXAMPLE.read_text().replace("duration = 60.0", f"duration = {seconds!r}")
        text = re.sub(r"^twin = .*\n", "", text, flags=re.MULTILINE)
        text = text.replace('address = "twin"', f'address = "{HOST}"')
        text = text.replace('rig = "ur5.toml"\n', "")
        load, began = [round(x, 1) for x in os.getloadavg()], psutil.cpu_times()
        with twin(log) as address:
            assert address in text
            result: RunResult | ListeningResult
            if listen:
                result = record_listening(DEVICE.replace("HOST", address), seconds, directory)
            else:
                result = run_experiment(parse_experiment(text, directory / "e.toml"), directory)
        ended = psutil.cpu_times()
        if result.path is None:
            raise SystemExit(f"the run failed: {result.reason}")
        recording = read_recording(result.path)
        stream = recording.stream_with("actual_q")
        figures = arrivals(stream.seq, stream.t_hw_ns, stream.t_acq_ns)
        left_out, untold = not_sent(log)
        return {
            "schema": "labhil.ur5_record/1",
            "seconds": seconds,
            "commanded": not listen,
            "exit_status": result.exit_status,
            "reason": result.reason,
            "columns": int(stream.values.shape[1]),
            **figures,
            "not_sent_by_the_twin": untold,
            "cycles_the_twin_left_out": left_out,
            "lost_on_the_way": figures["missed_by_timestamp"] - untold,
            "file_megabytes": round(result.path.stat().st_size / 1e6, 1),
            "machine_idle_share": round((ended.idle - began.idle) / (sum(ended) - sum(began)), 3),
            "load_average": [load[0], round(os.getloadavg()[0], 1), round(os.getloadavg()[1], 1)],
        }


def arrivals(seq: np.ndarray, t_hw_ns: np.ndarray, t_acq_ns: np.ndarray) -> dict[str, Any]:
    """What came, by the controller's clock, and how evenly, by this machine's."""
    period_ms = 1e3 / RATE
    steps = np.rint(np.diff(t_hw_ns) * 1e-6 / period_ms).astype(int)
    between_ms = np.diff(t_acq_ns) * 1e-6
    together = np.where(steps > 0, between_ms - steps * period_ms, 0.0)
    delay_ms = (t_acq_ns - t_acq_ns[0]) * 1e-6 - (t_hw_ns - t_hw_ns[0]) * 1e-6
    return {
        "samples": len(seq),
        "rate_hz": round((len(seq) - 1) / ((t_acq_ns[-1] - t_acq_ns[0]) * 1e-9), 3),
        "missed_by_timestamp": int((steps - 1).clip(0).sum()),
        "holes": int((steps > 1).sum()),
        "longest_hole_cycles": int(steps.max() - 1),
        "missing_in_seq": int((np.diff(seq) - 1).sum()),
        "stale_or_backwards": int((steps < 1).sum()),
        "arrival_less_period_ms": percentiles(np.abs(together)),
        "delay_over_fastest_ms": percentiles(delay_ms - delay_ms.min()),
    }


def getters(seconds: float) -> dict[str, Any]:
    runs = []
    for busy in (0, os.cpu_count() or 1):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(side_by_side(seconds, busy, Path(folder)))
        print(runs[-1], file=sys.stderr, flush=True)
    return {"schema": "labhil.ur5_getters/1", "seconds": seconds, "runs": runs}


def side_by_side(seconds: float, busy: int, folder: Path) -> dict[str, Any]:
    """The reader and two ways of polling at the same controller, beside ``busy`` busy loops."""
    ways = ("reader", "wait_period", "half_millisecond")
    with twin(folder / "said") as host:
        burners = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(busy)]
        try:
            watchers = {
                way: subprocess.Popen(
                    [sys.executable, HERE, "watch", way, host, repr(seconds), str(folder / way)]
                )
                for way in ways
            }
            for process in watchers.values():
                process.wait(seconds + 60.0)
        finally:
            for burner in burners:
                burner.kill()
                burner.wait()
    seen = {way: np.load(folder / f"{way}.npy", allow_pickle=False) for way in ways}
    first = max(stamps[0] for stamps in seen.values())
    last = min(stamps[-1] for stamps in seen.values())
    within = {way: stamps[(stamps >= first) & (stamps <= last)] for way, stamps in seen.items()}
    came = np.unique(within["reader"])
    expected = int(last - first) + 1
    result: dict[str, Any] = {
        "busy_loops": busy,
        "load_average": round(os.getloadavg()[0], 1),
        "cycles": expected,
        "not_sent_by_the_twin": not_sent(folder / "said")[1],
        "reader": {"missed": expected - len(came), "share": round(1.0 - len(came) / expected, 6)},
    }
    for way in ways[1:]:
        polled = np.unique(within[way])
        lost = len(np.setdiff1d(came, polled))
        result[way] = {
            "polls": len(within[way]),
            "seen_twice": len(within[way]) - len(polled),
            "lost": lost,
            "share": round(lost / len(came), 6),
        }
    return result


def watch(way: str, host: str, seconds: float, out: str) -> None:
    """Write the numbers of the cycles that one way of reading sees (by the controller's timestamp)."""
    stamps = read_all(host, seconds) if way == "reader" else poll(way, host, seconds)
    np.save(out, np.rint(np.array(stamps) * RATE).astype(np.int64))


def read_all(host: str, seconds: float) -> list[float]:
    from labhil_ur5 import Ur5Driver

    stamps: list[float] = []
    with Ur5Driver(host) as driver:
        driver.connect()
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            stamps += (driver.read(0.1).t_hw_ns * 1e-9).tolist()
    return stamps


def poll(way: str, host: str, seconds: float) -> list[float]:
    import rtde_receive

    receive = rtde_receive.RTDEReceiveInterface(host, RATE)
    stamps: list[float] = []
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        begun = receive.initPeriod()
        stamps.append(receive.getTimestamp())
        receive.getActualQ(), receive.getActualQd(), receive.getActualCurrent(), receive.getTargetQ()
        if way == "wait_period":
            receive.waitPeriod(begun)
        else:
            time.sleep(0.0005)
    receive.disconnect()
    return stamps


def main() -> None:
    parser = argparse.ArgumentParser()
    ways = parser.add_subparsers(dest="what", required=True)
    for what, seconds in (("record", 600.0), ("getters", 60.0)):
        way = ways.add_parser(what)
        way.add_argument("--seconds", type=float, default=seconds)
        way.add_argument("-o", "--out", type=Path)
        if what == "record":
            way.add_argument("--listen", action="store_true", help="without commands, as labhil serve")
    way = ways.add_parser("watch")
    for name, kind in (("way", str), ("host", str), ("seconds", float), ("out", str)):
        way.add_argument(name, type=kind)
    options = parser.parse_args()
    if options.what == "watch":
        watch(options.way, options.host, options.seconds, options.out)
        return
    if options.what == "record":
        figures = record(options.seconds, listen=options.listen)
    else:
        figures = getters(options.seconds)
    tell(figures, options.out)


if __name__ == "__main__":
    main()
