"""Run a bench's firmware in simavr for some minutes and print what docs/firmware.md says of it.

    python tests/firmware/measure.py BUILT_HARNESS BUILT_FIRMWARE.elf RIG SECONDS

Every 0.1 s the command changes; the answer is the first sample that shows it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

import numpy as np

from labhil.plugins import load_driver

LEVELS = {
    "ball_beam": ("servo_angle", (0.1, -0.1), 1),
    "solenoid": ("coil_current_command", (0.0, 1.0), -1),  # with breaks: an output without ends after 120 s
    "dc_motor": ("voltage", (3.0, -3.0), -1),
}
CHANGE_EVERY = 0.1


def measure(harness: str, elf: str, rig: str, seconds: float) -> dict[str, object]:
    """Drive the board for so long; gives what was lost and how long things took (s)."""
    name, levels, column = LEVELS[rig]
    process = subprocess.Popen([harness, elf, rig], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None
    assert process.stdout is not None

    def tell(command: str) -> str:
        process.stdin.write(command + "\n")
        process.stdin.flush()
        return process.stdout.readline()

    address = process.stdout.readline().strip()
    arrivals, answers, samples, turn = [], [], 0, 0
    with load_driver(rig)(address) as driver:
        driver.connect()
        tell("forget")
        began = time.monotonic()
        changed, waiting = began, False
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
        counters = driver.counters
        report = json.loads(tell("report"))
    process.stdin.close()
    process.wait(10)
    acquired, device = np.array(arrivals, dtype=float).T * 1e-9
    late = (acquired - acquired[0]) - (device - device[0])
    late -= np.minimum.accumulate(late[::-1])[::-1]
    return {
        "seconds": seconds,
        "samples": samples,
        "frames": counters.frames,
        "lost": counters.lost,
        "crc_errors": counters.crc_errors,
        "resyncs": counters.resyncs,
        "answer": [float(np.quantile(answers, q)) for q in (0.5, 0.99, 1.0)],
        "late": [float(np.quantile(late, q)) for q in (0.5, 0.99, 1.0)],
        "worst_turn_cycles": report["worst_turn"],
        "worst_interrupt_cycles": report["worst_interrupt"],
        "paused": report["paused"],
        "worst_lag": report["worst_lag"],
        "load": os.getloadavg()[0],
    }


if __name__ == "__main__":
    print(json.dumps(measure(*sys.argv[1:4], float(sys.argv[4]))))
