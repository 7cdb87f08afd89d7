"""The bus between real processes."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest

from labhil.bus import StreamPublisher, ask, live_devices, open_bus, serve, subscribe
from labhil.bus.keys import ALL_STREAMS, command_key, schema_key, split_key, stream_key
from labhil.codec import Codec, stamps_of, stream_from_json
from labhil.errors import BusError, CommandRefusedError

sys.path.insert(0, str(Path(__file__).parent))
from bus_peer import STREAM, batch

PEER = Path(__file__).with_name("bus_peer.py")


def start(bus, *words):
    return subprocess.Popen(
        [sys.executable, str(PEER), bus.endpoint, *map(str, words)], stdout=subprocess.PIPE, text=True
    )


@pytest.fixture
def bus():
    with open_bus() as opened:
        yield opened


@pytest.fixture
def bench(bus):
    """A process that publishes and answers until it is killed, and that our end of the bus knows of."""
    with start(bus, "stand", "bench") as process:
        assert process.stdout.readline() == "ready\n"
        ask(bus, command_key("bench", "set"), patience=20.0)
        yield process
        process.kill()


def wait_until(condition, seconds=20.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "gave up waiting"
        time.sleep(0.005)


def test_every_sample_of_another_process_arrives_from_the_first_on(bus):
    got = {}

    def keep(key, payloads):
        got.setdefault(key, []).extend(payloads)

    count = 5000
    with subscribe(bus, ALL_STREAMS, keep):
        with start(bus, "publish", "bench", count) as process:
            assert process.stdout.read() == "0\n"
        wait_until(lambda: len(got.get("lab/bench/state", [])) == count)
    assert got["lab/bench/state"] == Codec(STREAM).encode(batch(0, count))
    assert b"half way" in got["lab/bench/event"][0]
    assert split_key("lab/bench/state") == ("bench", "state")


def test_the_declaration_is_answered_and_hidden_from_wildcards(bus, bench):
    reply = ask(bus, schema_key("bench", "state"), timeout=60.0)
    assert stream_from_json(reply["stream"]) == STREAM
    assert reply["schema_name"] == "labhil.State"


def test_questions_are_answered_and_errors_come_back(bus, bench):
    key = command_key("bench", "set")
    assert ask(bus, key, {"value": 0.5}) == {"heard": {"value": 0.5}}
    with pytest.raises(CommandRefusedError, match="at most 1"):
        ask(bus, key, {"value": 2.0})
    with pytest.raises(BusError, match="ZeroDivisionError"):
        ask(bus, key, {"divisor": 0})
    assert ask(bus, key) == {"heard": {}}


def test_nobody_there_is_said_at_once(bus):
    with pytest.raises(BusError, match="lab/nobody/cmd/set: nobody answers"):
        ask(bus, command_key("nobody", "set"), timeout=30.0)


def test_a_silent_answerer_is_named(bus):
    release = threading.Event()
    with (
        serve(bus, command_key("slow", "set"), lambda _: {"late": release.wait(10.0)}),
        pytest.raises(BusError, match="lab/slow/cmd/set"),
    ):
        try:
            ask(bus, command_key("slow", "set"), timeout=0.2)
        finally:
            release.set()


def test_liveliness_ends_with_the_process(bus, bench):
    wait_until(lambda: live_devices(bus) == ("bench",))
    bench.kill()
    wait_until(lambda: live_devices(bus) == ())


def test_two_children_of_one_process_hear_each_other(bus, bench):
    with start(bus, "question", "bench") as process:
        assert process.stdout.read() == "{'n': 1}\n"


def test_nothing_listens_but_on_loopback(bus):
    listening = [c.laddr for c in psutil.Process().net_connections("inet") if c.status == psutil.CONN_LISTEN]
    assert bus.endpoint in {f"tcp/127.0.0.1:{address.port}" for address in listening}
    assert {address.ip for address in listening} == {"127.0.0.1"}
    udp = [c.laddr.ip for c in psutil.Process().net_connections("udp")]
    assert set(udp) <= {"127.0.0.1"}


def test_an_absent_endpoint_is_an_error_that_names_it(monkeypatch):
    monkeypatch.setattr("labhil.bus.session.CONNECT_TIMEOUT_MS", 200)
    with pytest.raises(BusError, match=r"expected a labhil process at tcp/127\.0\.0\.1:1"):
        open_bus("tcp/127.0.0.1:1")


def test_put_never_blocks_and_what_did_not_fit_is_counted(bus):
    """A reader that does not read: the publisher's thread is held up, the caller is not."""
    stall = threading.Event()
    arrived = []

    def keep(_key, payloads):
        stall.wait()
        arrived.extend(payloads)

    with open_bus(bus.endpoint) as near, subscribe(bus, stream_key("bench", "state"), keep):
        with StreamPublisher(near, "bench", STREAM, depth=4) as publisher:
            first = 0
            while publisher.overflows == 0:
                publisher.put(batch(first, 5000))
                first += 5000
            stall.set()
        wait_until(lambda: len(arrived) + publisher.overflows == first)
    seen = stamps_of(arrived)[:, 0]
    assert (seen[1:] > seen[:-1]).all()


def test_what_is_gathered_is_delivered_together_and_at_the_latest_when_it_ends(bus):
    deliveries = []
    with subscribe(
        bus, stream_key("a", "state"), lambda _, payloads: deliveries.append(payloads), gather=3600
    ):
        with StreamPublisher(bus, "a", STREAM) as publisher:
            for first in range(0, 50, 10):
                publisher.put(batch(first, 10))
        assert deliveries == []
    assert deliveries == [Codec(STREAM).encode(batch(0, 50))]


def test_nothing_is_left_behind(bus):
    before = set(threading.enumerate())
    with open_bus(bus.endpoint) as other:
        subscription = subscribe(other, ALL_STREAMS, lambda key, payloads: None)
        answering = serve(other, command_key("a", "b"), lambda question: question)
        publisher = StreamPublisher(other, "a", STREAM)
        publisher.put(batch(0, 3))
        for thing in (publisher, answering, subscription) * 2:
            thing.close()
    other.close()
    assert set(threading.enumerate()) == before


def test_an_error_in_the_callback_is_kept_and_publishers_go_on(bus):
    def fail(_key, _payloads):
        raise RuntimeError("full")

    with subscribe(bus, ALL_STREAMS, fail) as subscription, StreamPublisher(bus, "a", STREAM) as publisher:
        publisher.put(batch(0, 1000))
        wait_until(lambda: subscription.error is not None)
    assert publisher.overflows == 0
