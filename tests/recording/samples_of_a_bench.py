"""Samples as a bench sends them, for the tests of this folder; and a writer to be killed (argv: path)."""

import sys
import time
from pathlib import Path

import numpy as np

from labhil.recording import RecordingWriter
from labhil.signals import Batch, Direction, Signal, Stream

STATE = Stream(
    "state",
    (
        Signal("servo_angle", "rad", Direction.INPUT),
        Signal("ball_position", "m", Direction.OUTPUT),
        Signal("joints", "rad", Direction.STATUS, width=3),
    ),
    100.0,
)
START_NS = 1_700_000_000_000_000_000
STEP_NS = 10_000_000
RIG = '[rig]\nkind = "ball_beam"\n'


def batch(first, count, latency_ns=0):
    seq = np.arange(first, first + count, dtype=np.int64)
    values = np.column_stack([np.sin(seq / 10), np.cos(seq / 7), seq, seq / 3, -seq])
    return Batch(seq, START_NS + seq * STEP_NS + latency_ns, 5_000 + seq * STEP_NS, values)


if __name__ == "__main__":
    writer = RecordingWriter(Path(sys.argv[1]))
    writer.attach("rig.toml", "application/toml", RIG.encode())
    channel = writer.add_stream("bench", STATE)
    written = 0
    while True:
        writer.write(channel, batch(written, 20))
        written += 20
        if written == 2000:
            writer.flush()
            print(written, flush=True)
        time.sleep(0.0005)
