"""A host's side of the emergency stop: pressed by a question or by the file, released only by a question."""

from __future__ import annotations

import contextlib
import threading
import time

from labhil.bus import latch
from labhil.bus.latch import Latch
from labhil.errors import BusError

LOOK_EVERY = 0.05
"""How often the file is looked at, s."""


class HostLatch:
    """Whether the emergency stop stands for this host. May be pressed from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._standing = latch.read_latch()
        self._looked_at = 0.0

    def press(self, by: str, reason: str) -> None:
        """Latch the stop, and leave word for hosts that start later."""
        with self._lock:
            self._standing = self._standing or Latch(by, reason, time.time())
        # a directory that fails must not keep a device from stopping
        with contextlib.suppress(OSError, BusError):
            latch.press(by, reason)

    def release(self) -> None:
        """Let go of the stop; raises BusError or OSError where the file cannot be removed."""
        latch.release()
        with self._lock:
            self._standing = None

    def look(self, now: float) -> None:
        """Look whether somebody has pressed the stop without asking us; ``now`` on the monotonic clock, s."""
        if now - self._looked_at < LOOK_EVERY:
            return
        self._looked_at = now
        with contextlib.suppress(OSError, BusError):
            pressed = latch.read_latch()
            with self._lock:
                self._standing = self._standing or pressed

    @property
    def standing(self) -> Latch | None:
        """What stands, None when nothing does."""
        return self._standing
