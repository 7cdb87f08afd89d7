"""How well the clocks of two rigs are brought together, 200 ppm apart. A command, no test:

    python benchmarks/measuring/measure_clocks.py --seconds 60 --repeat 5 -o benchmarks/results/clocks.json

Two twins run in real time, each on a TCP wire, both into one recording; one clock is 200 ppm fast. A twin
takes sample k at a moment of this machine's monotonic clock that it alone knows; what comes closest to it
from outside is the lower envelope of the arrivals, for nothing arrives before it was sent. It is made of the
frames as a relay receives them, by a linear program, and shares neither stamps nor method with the estimate.
A twin that its machine keeps waiting for more than 50 ms lets its world pause: such a run shows no clock
and is counted apart, and so is one that ended before it showed enough, as a setpoint came too late.
"""

from __future__ import annotations

import argparse
import os
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linprog

from labhil.experiment.device_sections import TwinSection
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.run import run_experiment
from labhil.experiment.twins import start_twin
from labhil.link import Decoder, MessageType, Unwrapper
from labhil.recording.reader import read_recording
from measure_safety import _pass_on, _receive
from measured import tell

FAST_PPM = 200.0

SHORTEST = 10.0
"""s of a run that ended early and still tells of its clocks."""

DEVICE = """
[devices.NAME]
plugin = "ball_beam"
address = "ADDRESS"
reconnect = true
[[steps]]
device = "NAME"
signal = "servo_angle"
excitation = "hold"
level = 0.0
at = 0.0
duration = SECONDS
"""


class Tap:
    """Passes one connection on, and notes when each sample came by: Unix time and the device's clock, ns."""

    def __init__(self, twin: str) -> None:
        host, port = twin.removeprefix("socket://").split(":")
        self._twin_at = (host, int(port))
        self._door = socket.create_server(("127.0.0.1", 0))
        self.address = f"socket://127.0.0.1:{self._door.getsockname()[1]}"
        self.stamps: list[tuple[int, int]] = []
        self._threads = [threading.Thread(target=self._run, daemon=True)]
        self._threads[0].start()

    def _run(self) -> None:
        client = self._door.accept()[0]
        twin = socket.create_connection(self._twin_at)
        for end in (client, twin):
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        back = threading.Thread(target=self._back, args=(client, twin), daemon=True)
        back.start()
        decoder, clock = Decoder(), Unwrapper(32)
        while data := _receive(twin):
            now = time.time_ns()
            _pass_on(client, data)
            for frame in decoder.feed(data):
                if frame.type == MessageType.STATE:
                    self.stamps.append((now, clock.unwrap(frame.t_us) * 1000))
        client.close()

    @staticmethod
    def _back(client: socket.socket, twin: socket.socket) -> None:
        while data := _receive(client):
            _pass_on(twin, data)
        twin.close()


def envelope(stamps: list[tuple[int, int]], at_ns: int) -> float:
    """Seconds of the device's clock since its first stamp, by the line under all arrivals."""
    seen = np.array(stamps, dtype=np.int64)
    device = (seen[:, 1] - seen[0, 1]) * 1e-9
    delay = (seen[:, 0] - seen[0, 0]) * 1e-9 - device
    # the highest line level + slope·device that no arrival lies below
    solution = linprog(
        [-len(device), -device.sum()],
        A_ub=np.column_stack([np.ones(len(device)), device]),
        b_ub=delay,
        bounds=[(None, None), (None, None)],
    )
    level, slope = solution.x
    return float(((at_ns - seen[0, 0]) * 1e-9 - level) / (1 + slope))


def measure(seconds: float, fast_ppm: float, directory: Path) -> dict[str, float] | None:
    """Record two twins and compare both ways of telling their clocks; None where that was not possible."""
    with ExitStack() as stack:
        text, taps = '[experiment]\nname = "clocks"\n', {}
        for seed, (name, drift) in enumerate((("fast", fast_ppm), ("even", 0.0))):
            section = TwinSection(wire="tcp", seed=seed, set={"clock_drift": drift})
            answer = directory / f"{name}.json"
            twin, address = start_twin(name, "ball_beam", section, answer, lambda: False)
            stack.enter_context(twin)
            taps[name] = Tap(address)
            device = DEVICE.replace("NAME", name).replace("ADDRESS", taps[name].address)
            text += device.replace("SECONDS", repr(seconds))
        result = run_experiment(parse_experiment(text, directory / "e.toml"), directory)
    if result.exit_status != 0:
        print(f"the run ended early: {result.reason}", file=sys.stderr, flush=True)
    if result.path is None:
        return None
    recording = read_recording(result.path)
    if ("fast", "even") not in recording.clock_offsets or abs(recording.clocks["fast"].drift) > 1e-3:
        return None
    if recording.duration < SHORTEST or any(event.body.get("kind") == "lost" for event in recording.events):
        return None  # a clock that was looked for anew is not the one that the relays saw
    offset, clock = recording.clock_offsets["fast", "even"], recording.clocks["fast"]
    first = {name: tap.stamps[0][1] * 1e-9 for name, tap in taps.items()}
    true = {name: envelope(tap.stamps, offset.t_host_ns) + first[name] for name, tap in taps.items()}
    # the driver counts the clock from where the device does, so both are the same clock
    return {
        "alignment_error_us": round(1e6 * (offset.offset - (true["fast"] - true["even"])), 1),
        "told_error_us": round(1e6 * offset.error, 1),
        "told_bound_us": round(1e6 * offset.bound, 1),
        "drift_ppm": round(1e6 * clock.drift, 3),
        "told_drift_error_ppm": round(1e6 * clock.drift_error, 3),
        "jitter_us": round(1e6 * clock.jitter, 1),
        "stepped_ms": round(1e3 * max(clock.stepped, recording.clocks["even"].stepped), 1),
        "outliers": clock.outliers,
        "samples": clock.samples,
        "seconds": round(recording.duration, 1),
        "load_average": round(os.getloadavg()[0], 1),
    }


def covered(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """How often the true error lay within what is stated: twice the standard error, and the bound."""
    errors = [abs(run["alignment_error_us"]) for run in runs]
    drifts = [abs(run["drift_ppm"] - FAST_PPM) for run in runs]
    return {
        "runs": len(runs),
        "within_2_sigma": sum(e <= 2 * run["told_error_us"] for e, run in zip(errors, runs, strict=True)),
        "within_bound": sum(e <= run["told_bound_us"] for e, run in zip(errors, runs, strict=True)),
        "drift_within_2_sigma": sum(
            d <= 2 * run["told_drift_error_ppm"] for d, run in zip(drifts, runs, strict=True)
        ),
        "without_steps": sum(run["stepped_ms"] == 0.0 for run in runs),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    runs: list[dict[str, Any]] = []
    unusable = 0
    for _ in range(options.repeat):
        with tempfile.TemporaryDirectory() as directory:
            os.environ["XDG_RUNTIME_DIR"] = directory
            figures = measure(options.seconds, FAST_PPM, Path(directory))
        print(figures, file=sys.stderr, flush=True)
        if figures is None:
            unusable += 1
        else:
            runs.append(figures)
    result = {
        "schema": "labhil.clocks/1",
        "seconds": options.seconds,
        "drift_ppm": FAST_PPM,
        "unusable": unusable,
        "covered": covered(runs),
        "runs": runs,
    }
    tell(result, options.out)


if __name__ == "__main__":
    main()
