"""Reconnecting to a lost device: attempts in a thread of their own, and continuous numbers and times after.

Nothing is assumed of the device that comes back: the driver sends its whole configuration again, and another
device or another firmware is an error.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

from labhil.driver import DeviceInfo, Driver
from labhil.errors import BusError, DeviceError, LabhilError, ProtocolError
from labhil.signals import Batch
from labhil.supervised import SupervisedThread

SEARCH_TIMEOUT = 60.0
"""How long a host searches for a lost device, s."""

MAX_STAMP_DELAY_NS = 250_000_000
MAX_CLOCK_ERROR = 0.01
"""A gap by the device's clock and one by the host's agree within the delays of stamps (ns) and this share of
it: more than the error of an oscillator."""

WRAP_NS = (1 << 32) * 1000
"""Period of a counter of µs of 32 bits, as of ``micros()``; a longer gap has several."""


class Search:
    """Tries to connect until it succeeds or the time is over. An object serves one search.

    Args:
        driver: The driver.
        timeout: How long it tries, s.
        first_wait: Time before the first attempt, s; doubled after each.
        max_wait: Longest time between two attempts, s. A device is to be back within 2 s of its return, and
            what precedes its first sample takes up to a second.
    """

    def __init__(
        self,
        driver: Driver,
        timeout: float = SEARCH_TIMEOUT,
        *,
        first_wait: float = 0.1,
        max_wait: float = 0.5,
    ) -> None:
        self._driver, self._timeout = driver, timeout
        self._first_wait, self._max_wait = first_wait, max_wait
        self._info: DeviceInfo | None = None
        self._error: LabhilError | None = None
        self._over = threading.Event()
        self._cancelled = threading.Event()
        # a driver that hangs while it connects must not keep its host from ending
        self._thread = SupervisedThread(self._run, "reconnect", daemon=True, on_failure=self._over.set)
        self._thread.start()

    def result(self, timeout: float) -> DeviceInfo | None:
        """Wait up to ``timeout`` s for the device; raises the last error once the search is over."""
        if not self._over.wait(timeout):
            return None
        if self._error is not None:
            raise self._error
        if fault := self._thread.failure():
            raise BusError(f"the search failed: {fault}")
        return self._info

    def cancel(self) -> None:
        """Stop after the present attempt."""
        self._cancelled.set()

    def _run(self) -> None:
        try:
            self._search()
        except LabhilError as error:
            self._error = error
        self._thread.end()
        self._over.set()

    def _search(self) -> None:
        deadline, wait = time.monotonic() + self._timeout, self._first_wait
        self._driver.close()
        while not self._cancelled.wait(wait):
            try:
                self._info = self._driver.connect()
                break
            except DeviceError as error:
                if time.monotonic() + wait > deadline:
                    self._error = error
                    break
            wait = min(2 * wait, self._max_wait)


def refuse_another(address: str, lost: DeviceInfo, connected: DeviceInfo) -> None:
    """Raise ProtocolError unless the connected device is the one that was lost, but for its boot."""
    for field in ("serial", "firmware", "speed", "calibration"):
        expected, actual = getattr(lost, field), getattr(connected, field)
        if expected != actual:
            raise ProtocolError(
                f"{address}: another device came back: expected {field} {expected!r}, found {actual!r}"
            )


@dataclass(slots=True)
class Continuation:
    """Keeps sequence numbers and the device's clock continuous across connections.

    In a new connection both begin again at the device. Their offsets are set so that the clock advances by
    the length of the gap, and the gap in ``seq`` has as many numbers as samples are missing in it. The
    device's clock measures the gap if it kept running in the same boot; else the host's does, and the time
    across the gap is as uncertain as the host's stamps.

    Attributes:
        rate: Sample rate, per s of the host.
        speed: Seconds of the device's clock per second of the host.
    """

    rate: float
    speed: float
    _seq_offset: int = 0
    _t_hw_offset_ns: int = 0
    _last: tuple[int, int, int] | None = None
    _is_new_connection: bool = False
    _is_same_boot: bool = False

    def note_new_connection(self, *, same_boot: bool = False) -> None:
        """Note that the next batch is the first of another connection."""
        self._is_new_connection = self._last is not None
        self._is_same_boot = same_boot

    def apply(self, batch: Batch) -> Batch:
        """Return the batch (not empty) with numbers and times that continue those before."""
        if self._is_new_connection and self._last is not None:
            self._set_offsets(batch, *self._last)
        if self._seq_offset or self._t_hw_offset_ns:
            seq, t_hw_ns = batch.seq + self._seq_offset, batch.t_hw_ns + self._t_hw_offset_ns
            batch = Batch(seq, batch.t_acq_ns, t_hw_ns, batch.values)
        self._last = (int(batch.seq[-1]), int(batch.t_acq_ns[-1]), int(batch.t_hw_ns[-1]))
        return batch

    def _set_offsets(self, batch: Batch, seq: int, t_acq_ns: int, t_hw_ns: int) -> None:
        gap_ns = max(int(batch.t_acq_ns[-1]) - t_acq_ns, 1)
        span_ns = int(batch.t_hw_ns[-1] - batch.t_hw_ns[0])
        # the gap by the device's own clock, up to whole turns of its counter
        device_ns = int(batch.t_hw_ns[-1]) + self._t_hw_offset_ns - t_hw_ns
        device_ns += max(round((gap_ns * self.speed - device_ns) / WRAP_NS), 0) * WRAP_NS
        device_gap_ns = round(device_ns / self.speed)
        tolerance_ns = MAX_STAMP_DELAY_NS + MAX_CLOCK_ERROR * gap_ns
        if self._is_same_boot and abs(device_gap_ns - gap_ns) < tolerance_ns:
            gap_ns = max(device_gap_ns, 1)
        missing = max(round(gap_ns * 1e-9 * self.rate), len(batch))
        self._seq_offset = seq + missing - int(batch.seq[-1])
        self._t_hw_offset_ns = t_hw_ns + max(round(gap_ns * self.speed), span_ns + 1) - int(batch.t_hw_ns[-1])
        self._is_new_connection = False
