"""Threads of the bus that die: their owner learns at once with what, and closing does not wait for them."""

from __future__ import annotations

import time

import pytest

from labhil.bus.ask import Responder, ask, serve
from labhil.bus.keys import ALL_STREAMS, command_key, guest_key
from labhil.bus.publish import StreamPublisher, publish_event
from labhil.bus.session import Bus, open_bus
from labhil.bus.subscribe import Subscription, subscribe
from labhil.errors import BusError
from labhil.experiment.devices import run_concurrently
from labhil.plugins import load_driver
from labhil.security.roles import Role
from labhil.service.child import Child
from labhil.service.gateway import Gateway
from labhil.service.reconnect import Search
from labhil.signals import Direction, Signal, Stream
from labhil.supervised import SupervisedThread

STREAM = Stream("state", (Signal("x", "m", Direction.OUTPUT),), 100.0)


def dies(*_: object) -> None:
    raise SystemExit("struck")


def wait_for_failure(bus: Bus) -> str:
    deadline = time.monotonic() + 90.0
    while not (why := bus.failure()):
        assert time.monotonic() < deadline, "nobody noticed"
        time.sleep(0.01)
    return why


def test_a_thread_tells_what_ended_it_and_where() -> None:
    thread = SupervisedThread(dies, "worker")
    assert thread.failure() == ""
    thread.start()
    thread.join()
    assert "'worker' has died: SystemExit('struck') at test_dead_threads.py" in thread.failure()
    returned = SupervisedThread(lambda: None, "short")
    returned.start()
    returned.join()
    assert "has ended, though nobody told it to" in returned.failure()
    returned.end()
    assert returned.failure() == ""


def test_one_that_listens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Subscription, "_deliver", dies)
    with open_bus() as bus, subscribe(bus, ALL_STREAMS, dies):
        publish_event(bus, "a", "something")
        assert "SystemExit('struck')" in wait_for_failure(bus)


def test_one_that_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Responder, "_answer", dies)
    key = command_key("a", "estop")
    with open_bus() as bus:
        answering = serve(bus, key, lambda _: {})
        with pytest.raises(BusError):
            ask(bus, key, timeout=1.0)
        assert "SystemExit('struck')" in wait_for_failure(bus)
        answering.close()
        assert bus.failure() == ""
        with pytest.raises(BusError, match="nobody answers there"):
            ask(bus, key, timeout=1.0)


def test_one_that_publishes_keeps_nobody_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StreamPublisher, "_wait_for_a_listener", dies)
    with open_bus() as bus:
        publisher = StreamPublisher(bus, "a", STREAM, depth=1)
        assert "SystemExit('struck')" in wait_for_failure(bus)
        publisher._queue.put([])  # full, and nobody takes from it
        publisher.close()


def test_one_that_reads_what_a_child_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Child, "_take_line", dies)
    with Child("the child", ["sh", "-c", "echo ready; cat"]) as child:
        assert child.line(20.0) is None
        assert "SystemExit('struck')" in child.reader_failure()


def test_one_that_looks_for_a_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Search, "_search", dies)
    search = Search(load_driver("ball_beam")("/dev/not-there"))
    with pytest.raises(BusError, match="struck"):
        search.result(20.0)


def test_one_that_stops_a_device_keeps_no_other_from_it() -> None:
    stopped: list[str] = []
    failed, well = run_concurrently([dies, lambda: stopped.append("other")])
    assert "SystemExit('struck')" in str(failed) and well is None and stopped == ["other"]


def test_one_that_answers_guests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Gateway, "_answer", dies)
    with open_bus() as door, Gateway(door, {"ada": Role.ADMIN}, lambda _: None) as gateway:
        with open_bus(door.endpoint) as guest, pytest.raises(BusError):
            ask(guest, guest_key(command_key("a", "status"), "ada"), {}, 1.0)
        assert "SystemExit('struck')" in wait_for_failure(door)
        with pytest.raises(BusError, match=r"guests are not heard any more: .*struck"):
            gateway.poll()
