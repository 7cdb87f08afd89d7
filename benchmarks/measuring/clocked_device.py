"""A device with a clock that nothing else of the machine moves: the bench's firmware on a port of ours."""

from __future__ import annotations

import contextlib
import os
import threading
import time
import tty

import numpy as np

from labhil.host_clock import unix_ns
from labhil.link import ChannelScale, MessageType
from labhil.serial_twin.firmware import Firmware
from labhil_sim_ball_beam.rig import make_board

RATE = 100.0
STEP = 1e-4
"""m; a count of the position, which here is the number of the sample."""

MODULUS = 1000


class PatientFirmware(Firmware):
    """A firmware whose samples may be taken by the hour."""

    def take(self, count: int) -> None:
        """Take so many samples that nobody receives."""
        self._n_samples += count
        self._sent[MessageType.STATE] += count


class ClockedDevice:
    """Takes sample k at ``k / (rate (1 + drift))`` s after its boot, and shows ``clock_start + k / rate``.

    Each sample's position is its number, so that whoever reads it knows which one it is. ``pass_by`` lets
    time pass in which nobody is there to take what it sends.
    """

    def __init__(self, drift: float = 0.0, clock_start: float = 0.0) -> None:
        self.taken: dict[int, int] = {}
        """When each sample was taken, Unix ns, with all the time that passed at once."""
        self._firmware = PatientFirmware(make_board(ChannelScale(STEP, 0.0), 1.0, clock_start, 1e-7))
        self._period_ns = 1e9 / RATE / (1.0 + drift)
        self._lock, self._over = threading.RLock(), threading.Event()
        self._port, theirs = os.openpty()
        tty.setraw(theirs)
        os.set_blocking(self._port, False)
        self.address = os.ttyname(theirs)
        self._theirs = theirs
        self._firmware.boot(time.monotonic())
        self._origin_ns, self._number, self._passed_ns = unix_ns(), 0, 0
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        """End it."""
        self._over.set()
        self._thread.join()
        os.close(self._port)
        os.close(self._theirs)

    def pass_by(self, seconds: float) -> int:
        """Let so much time pass at once; the ns that did, whole samples."""
        count = round(seconds * 1e9 / self._period_ns)
        with self._lock:
            self._firmware.watch(time.monotonic() + 1e6)
            self._firmware.take(count)
            self._number += count
            ns = round(count * self._period_ns)
            self._origin_ns -= ns
            self._passed_ns += ns
        return ns

    def freeze(self, seconds: float) -> None:
        """Let it stand still, clock and all."""
        with self._lock:
            time.sleep(seconds)
            self._origin_ns += round(seconds * 1e9)

    def _rows(self, count: int) -> np.ndarray:
        numbers = (self._number + np.arange(count)) % MODULUS
        self._number += count
        output = self._firmware.output
        return np.column_stack([numbers, np.full(count, output)]).astype(np.uint16)

    def _run(self) -> None:
        while not self._over.is_set():
            with self._lock:
                now, now_ns = time.monotonic(), unix_ns()
                with contextlib.suppress(OSError):
                    answer = self._firmware.receive(os.read(self._port, 4096), now)
                    self._write(answer)
                self._firmware.watch(now)
                while (due_ns := self._origin_ns + round(self._number * self._period_ns)) <= now_ns:
                    self.taken[self._number] = due_ns + self._passed_ns
                    for message in self._firmware.samples(self._rows(1)):
                        self._write(message)
            self._over.wait(max((due_ns - unix_ns()) * 1e-9, 0.0005))

    def _write(self, data: bytes) -> None:
        if data:
            with contextlib.suppress(OSError):
                os.write(self._port, data)
