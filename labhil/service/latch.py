"""The emergency stop in a host: pressed by a request or by the latch file, released only by a request."""

from __future__ import annotations

import contextlib
import threading
import time

from labhil.bus import latch
from labhil.bus.latch import Latch
from labhil.errors import BusError

POLL_INTERVAL = 0.05
"""How often the file is read, s."""


class HostLatch:
    """The state of the emergency stop in this host; it may be pressed from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._standing = latch.read_latch()
        self._polled_at = 0.0

    def press(self, by: str, reason: str) -> None:
        """Latch the stop, and write the file for hosts that start later.

        Args:
            by: Who pressed it.
            reason: Why.
        """
        with self._lock:
            self._standing = self._standing or Latch(by, reason, time.time())
        # an error of the directory must not keep a device from stopping
        with contextlib.suppress(OSError, BusError):
            latch.press(by, reason)

    def release(self) -> None:
        """Release the stop; BusError or OSError where the file cannot be removed."""
        latch.release()
        with self._lock:
            self._standing = None

    def poll(self, now: float) -> None:
        """Read the file where that is due; ``now`` is s of the monotonic clock."""
        if now - self._polled_at < POLL_INTERVAL:
            return
        self._polled_at = now
        with contextlib.suppress(OSError, BusError):
            pressed = latch.read_latch()
            with self._lock:
                self._standing = self._standing or pressed

    @property
    def standing(self) -> Latch | None:
        """The emergency stop that is pressed; None where none is."""
        return self._standing
