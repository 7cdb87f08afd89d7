"""A device that was lost, looked for again: attempts in a thread of their own, and what carries on after.

Nothing is assumed of what comes back: the driver sends the whole configuration again, and a device that is
another one, or another firmware, is an error.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

from labhil.driver import DeviceInfo, Driver
from labhil.errors import BusError, DeviceError, LabhilError, ProtocolError
from labhil.signals import Batch
from labhil.supervised import SupervisedThread

FIRST_WAIT = 0.1
LONGEST_WAIT = 0.5
"""s between two attempts: doubled each time, up to this. A device is to be back within 2 s of its return, and
the talk that comes before its first sample takes up to a second."""

GIVE_UP = 60.0
"""How long a lost device is looked for, s."""

LATE_NS, UNSURE = 250_000_000, 0.01
"""A gap by the device's clock and one by the host's agree within what stamps are late by, and this share:
more than an oscillator is off."""

WRAP_NS = (1 << 32) * 1000
"""Where a counter of µs of 32 bits begins anew, as ``micros()`` does; a longer gap has several."""


class Search:
    """Connects again and again, until it works or ``give_up`` s have passed. One use each."""

    def __init__(self, driver: Driver, give_up: float = GIVE_UP) -> None:
        self._driver, self._give_up = driver, give_up
        self._info: DeviceInfo | None = None
        self._error: LabhilError | None = None
        self._over = threading.Event()
        self._cancelled = threading.Event()
        # a driver that hangs while it connects must not keep its host from ending
        self._thread = SupervisedThread(self._run, "reconnect", daemon=True, on_failure=self._over.set)
        self._thread.start()

    def result(self, timeout: float) -> DeviceInfo | None:
        """Wait up to ``timeout`` s for the device; raises what the last attempt did, once it was the last."""
        if not self._over.wait(timeout):
            return None
        if self._error is not None:
            raise self._error
        if died := self._thread.failure():
            raise BusError(f"the search failed: {died}")
        return self._info

    def cancel(self) -> None:
        """Stop looking after the present attempt."""
        self._cancelled.set()

    def _run(self) -> None:
        try:
            self._look()
        except LabhilError as error:
            self._error = error
        self._thread.end()
        self._over.set()

    def _look(self) -> None:
        deadline, wait = time.monotonic() + self._give_up, FIRST_WAIT
        self._driver.close()
        while not self._cancelled.wait(wait):
            try:
                self._info = self._driver.connect()
                break
            except DeviceError as error:
                if time.monotonic() + wait > deadline:
                    self._error = error
                    break
            wait = min(2 * wait, LONGEST_WAIT)


def refuse_another(address: str, before: DeviceInfo, now: DeviceInfo) -> None:
    """Raise ProtocolError unless the device that came back is the one that was lost, but for its boot."""
    for what in ("serial", "firmware", "speed", "calibration"):
        expected, actual = getattr(before, what), getattr(now, what)
        if expected != actual:
            raise ProtocolError(
                f"{address}: another device came back: expected {what} {expected!r}, found {actual!r}"
            )


@dataclass(slots=True)
class Continuation:
    """Sequence numbers and the device's clock, carried on across connections.

    After a gap both begin anew at the device. A clock that went on in the same boot tells how long the gap
    was; else the host's does, and the time across it is as sure as the host's stamps. The hole in ``seq`` is
    as large as samples are missing at ``rate`` (per s of the host).
    """

    rate: float
    speed: float
    _seq: int = 0
    _t_hw_ns: int = 0
    _last: tuple[int, int, int] | None = None
    _torn: bool = False
    _same_boot: bool = False

    def tear(self, *, same_boot: bool = False) -> None:
        """The next batch is the first of another connection."""
        self._torn = self._last is not None
        self._same_boot = same_boot

    def carry_on(self, batch: Batch) -> Batch:
        """Return the batch (not empty) as the continuation of what came before."""
        if self._torn and self._last is not None:
            self._tie(batch, *self._last)
        if self._seq or self._t_hw_ns:
            batch = Batch(batch.seq + self._seq, batch.t_acq_ns, batch.t_hw_ns + self._t_hw_ns, batch.values)
        self._last = (int(batch.seq[-1]), int(batch.t_acq_ns[-1]), int(batch.t_hw_ns[-1]))
        return batch

    def _tie(self, batch: Batch, seq: int, t_acq_ns: int, t_hw_ns: int) -> None:
        gap_ns = max(int(batch.t_acq_ns[-1]) - t_acq_ns, 1)
        # the device's own clock, where it went on: what it shows now less what it showed last
        by_device_ns = int(batch.t_hw_ns[-1]) + self._t_hw_ns - t_hw_ns
        by_device_ns += max(round((gap_ns * self.speed - by_device_ns) / WRAP_NS), 0) * WRAP_NS
        by_device_ns = round(by_device_ns / self.speed)
        within = int(batch.t_hw_ns[-1] - batch.t_hw_ns[0])
        if self._same_boot and abs(by_device_ns - gap_ns) < LATE_NS + UNSURE * gap_ns:
            gap_ns = max(by_device_ns, 1)
        missing = max(round(gap_ns * 1e-9 * self.rate), len(batch))
        self._seq = seq + missing - int(batch.seq[-1])
        self._t_hw_ns = t_hw_ns + max(round(gap_ns * self.speed), within + 1) - int(batch.t_hw_ns[-1])
        self._torn = False
