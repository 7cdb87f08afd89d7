"""A publisher that writes down what it publishes, before it does:

    python benchmarks/measuring/logged_publisher.py ENDPOINT DEVICE RATE LOG

``RATE`` samples a second, in pieces of 10 ms, until its standard input ends. LOG is payload after payload.
"""

from __future__ import annotations

import select
import sys
import time
from pathlib import Path

import numpy as np

from labhil.bus.publish import StreamPublisher
from labhil.bus.session import open_bus
from labhil.codec import Codec
from labhil.host_clock import unix_ns
from labhil.signals import Batch, Direction, Signal, Stream

EVERY = 0.01


def stream_at(rate: float) -> Stream:
    """What is published: a command and a noisy position."""
    signals = (
        Signal("coil_current", "A", Direction.INPUT),
        Signal("plunger_position", "m", Direction.OUTPUT),
    )
    return Stream("state", signals, rate)


def main() -> None:
    endpoint, device, rate, log = sys.argv[1], sys.argv[2], float(sys.argv[3]), Path(sys.argv[4])
    stream, count = stream_at(rate), round(rate * EVERY)
    codec, chance = Codec(stream), np.random.default_rng()
    with open_bus(endpoint) as bus, StreamPublisher(bus, device, stream) as publisher, log.open("wb") as file:
        first, due = 0, time.monotonic()
        while not select.select([sys.stdin], [], [], max(0.0, due - time.monotonic()))[0]:
            seq = np.arange(first, first + count, dtype=np.int64)
            now = unix_ns() - ((count - 1 - np.arange(count)) * 1e9 / rate).astype(np.int64)
            batch = Batch(seq, now, (seq * 1e9 / rate).astype(np.int64), chance.normal(size=(count, 2)))
            file.write(b"".join(codec.encode(batch)))
            file.flush()
            publisher.put(batch)
            first, due = first + count, due + EVERY


if __name__ == "__main__":
    main()
