r"""How large the firmware is, and what it takes on a simulated board. A command, no test:

    python benchmarks/measuring/measure_firmware.py --seconds 60 -o benchmarks/results/firmware.json
    python benchmarks/measuring/measure_firmware.py --rig solenoid --define SAMPLE_RATE=2500 \
      --define LINE_BAUD_RATE=1000000

Each bench's firmware is built as its Makefile does and runs in simavr with a plant on its pins, driven
through the real driver on a pseudo terminal: every 0.1 s the command changes. ``--define`` takes the place of
a line of ``bench.h``. Turns of the main loop and interrupt handlers are counted in the board's own cycles, so
that they do not depend on this machine; what is late does.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from labhil.plugins import load_driver

sys.path.append(str(Path(__file__).parents[2] / "tests/firmware"))

from simulated_board import HERTZ, build_firmware, build_harness, sizes, started

LEVELS = {
    "ball_beam": ("servo_angle", (0.1, -0.1), 1),
    "solenoid": ("coil_current_command", (0.0, 1.0), -1),  # with breaks: an output without ends after 120 s
    "dc_motor": ("voltage", (3.0, -3.0), -1),
}
CHANGE_EVERY = 0.1
QUANTILES = {"median": 0.5, "p99": 0.99, "largest": 1.0}


def measure(rig: str, seconds: float, settings: Mapping[str, str], folder: Path) -> dict[str, Any]:
    """Build a bench's firmware and drive it for so long: its size, what was lost, how long things took."""
    elf = build_firmware(rig, folder / rig, settings)
    flash, memory = sizes(elf)
    name, levels, column = LEVELS[rig]
    arrivals, answers, samples, turn = [], [], 0, 0
    with started(folder / "harness", elf) as board, load_driver(rig)(board.address) as driver:
        board.tell("forget")
        driver.connect()
        connecting = board.report()["worst_turn"]
        board.tell("forget")
        began = changed = time.monotonic()
        waiting = False
        while (now := time.monotonic()) - began < seconds:
            if now - changed >= CHANGE_EVERY:
                turn += 1
                changed, waiting = now, True
                driver.command({name: levels[turn % 2]})
            batch = driver.read(0.02)
            samples += len(batch)
            if len(batch):
                arrivals.append((batch.t_acq_ns[-1], batch.t_hw_ns[-1]))
                if waiting and abs(batch.values[-1, column] - levels[turn % 2]) < 0.01:
                    answers.append(time.monotonic() - changed)
                    waiting = False
        counters, rate = driver.counters, driver.spec.stream.rate
        report, stack, losses = board.report(), board.deepest_stack(), board.line_losses()
    acquired, device = np.array(arrivals, dtype=float).T * 1e-9
    late = (acquired - acquired[0]) - (device - device[0])
    late -= np.minimum.accumulate(late[::-1])[::-1]
    return {
        "rig": rig,
        "settings": dict(settings),
        "flash_bytes": flash,
        "static_memory_bytes": memory,
        "deepest_stack_bytes": stack,
        "longest_turn_ms": _ms(report["worst_turn"]),
        "longest_turn_while_connecting_ms": _ms(connecting),
        "longest_interrupt_us": round(1e3 * _ms(report["worst_interrupt"]), 1),
        "sample_rate": rate,
        "seconds": seconds,
        "samples": samples,
        "frames": counters.frames,
        "lost": counters.lost,
        "crc_errors": counters.crc_errors,
        "resyncs": counters.resyncs,
        "line_overruns_framing_errors_unsent": losses,
        "reaction_ms": _quantiles(answers),
        "delay_ms": _quantiles(late),
        "paused_s": report["paused"],
        "load_average": round(os.getloadavg()[0], 1),
    }


def _ms(cycles: int) -> float:
    return round(1e3 * cycles / HERTZ, 4)


def _quantiles(values: Any) -> dict[str, float]:
    if not len(values):
        return {}
    return {name: round(1e3 * float(np.quantile(values, q)), 1) for name, q in QUANTILES.items()}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rig", nargs="+", choices=LEVELS, default=list(LEVELS))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--define", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    settings = dict(define.split("=", 1) for define in options.define)
    benches = []
    with tempfile.TemporaryDirectory() as directory:
        build_harness(Path(directory))
        for rig in options.rig:
            benches.append(measure(rig, options.seconds, settings, Path(directory)))
            print(benches[-1], file=sys.stderr, flush=True)
    text = json.dumps({"schema": "labhil.firmware/1", "benches": benches}, indent=1)
    if options.out is None:
        print(text)
    else:
        options.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
