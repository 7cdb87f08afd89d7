"""The other process of the bus tests: joins the bus at argv[1] and does what argv[2] says."""

import sys
import time

import numpy as np

from labhil.bus import StreamPublisher, announce, ask, open_bus, publish_event, serve
from labhil.bus.keys import command_key
from labhil.errors import CommandRefusedError
from labhil.signals import Batch, Direction, Signal, Stream

STREAM = Stream(
    "state",
    (Signal("servo_angle", "rad", Direction.INPUT), Signal("ball_position", "m", Direction.OUTPUT)),
    100.0,
)


def batch(first, count, start_ns=1_700_000_000_000_000_000, step_ns=10_000_000):
    seq = np.arange(first, first + count, dtype=np.int64)
    values = np.column_stack([np.sin(seq / 10), np.cos(seq / 7)])
    return Batch(seq, start_ns + seq * step_ns, seq * step_ns, values)


def publish(bus, device, count):
    """Publish at once, without waiting for anybody: the first samples must arrive all the same."""
    with StreamPublisher(bus, device, STREAM, {"serial": "A1"}) as publisher:
        for first in range(0, count, 50):
            publisher.put(batch(first, min(50, count - first)))
        publish_event(bus, device, "half way")
    print(publisher.overflows, flush=True)


def stand(bus, device):
    """Publish ten samples a time until killed, and answer questions."""

    def answer(question):
        if question.get("value", 0.0) > 1.0:
            raise CommandRefusedError("value must be at most 1")
        if "divisor" in question:
            return {"quotient": 1 / question["divisor"]}
        return {"heard": question}

    with (
        announce(bus, device),
        StreamPublisher(bus, device, STREAM) as publisher,
        serve(bus, command_key(device, "set"), answer),
    ):
        print("ready", flush=True)
        first = 0
        while True:
            publisher.put(batch(first, 10))
            first += 10
            time.sleep(0.01)


def question(bus, device):
    print(ask(bus, command_key(device, "set"), {"n": 1}, timeout=60.0)["heard"], flush=True)


if __name__ == "__main__":
    with open_bus(sys.argv[1]) as joined:
        {"publish": publish, "stand": stand, "question": question}[sys.argv[2]](
            joined, sys.argv[3], *map(int, sys.argv[4:])
        )
