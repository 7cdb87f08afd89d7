"""Signals, at any moment: a wait with an end still ends (that of queue.SimpleQueue would not)."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator

import pytest

from labhil.errors import BusError
from labhil.service.child import Child

PERIOD = 0.0007


@pytest.fixture
def many_signals() -> Iterator[None]:
    """Send signals to this thread all the time."""
    before = signal.signal(signal.SIGUSR1, lambda *_: None)
    done, here = threading.Event(), threading.get_ident()

    def send() -> None:
        while not done.wait(PERIOD):
            signal.pthread_kill(here, signal.SIGUSR1)

    sender = threading.Thread(target=send)
    sender.start()
    yield
    done.set()
    sender.join()
    signal.signal(signal.SIGUSR1, before)


@pytest.mark.extended
@pytest.mark.usefixtures("many_signals")
def test_a_child_that_says_nothing_is_not_waited_for_longer_than_asked() -> None:
    child = Child("a silent child", [sys.executable, "-c", "input()"])
    try:
        for _ in range(5):
            with pytest.raises(BusError, match=r"said nothing for 0\.3 s"):
                child.line(0.3)
    finally:
        child.stop()
