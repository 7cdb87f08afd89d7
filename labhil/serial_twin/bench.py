"""The simulated bench: a simulated rig and its firmware on a wire, in real time."""

from __future__ import annotations

import time
from collections import deque
from typing import Protocol

import numpy as np

from labhil.ending import Ending
from labhil.serial_twin.firmware import Board, Firmware, Raw
from labhil.serial_twin.settings import TwinSettings
from labhil.serial_twin.wires import Wire

IDLE_INTERVAL = 0.02
"""How often a twin without a client checks for one, s."""
GARBAGE_BYTES = 300
"""Random bytes of the fault "garbage"."""


class SimulatedRig(Protocol):
    """A plant with its sensors and its actuator, in raw numbers."""

    board: Board

    def begin(self) -> None:
        """Put the plant into its initial state: a client has opened the wire."""
        ...

    def rest(self, output: int, count: int) -> Raw:
        """Return samples (count, fitted channels) of the plant at rest, before the first command."""
        ...

    def samples(self, output: int, count: int) -> Raw:
        """Simulate ``count`` sample periods under a command; return the samples (count, channels)."""
        ...


class Bench:
    """A simulated rig with its microcontroller.

    Sample k of the device's clock is taken k/(rate·speed) s after the client connected, by the monotonic
    clock. Small delays are caught up, since a pause would bend the device's clock; a long delay is skipped,
    since the plant must not run on without its controller.
    """

    def __init__(self, settings: TwinSettings, rig: SimulatedRig) -> None:
        self._wire_settings = settings.wire
        board = rig.board
        self._pace = 1.0 / board.sample_rate / (1.0 + 1e-6 * settings.wire.clock_drift) / settings.speed
        self._speed = settings.speed
        self._rig, self._firmware = rig, Firmware(board)
        self._per_turn = max(board.per_frame, 1)
        self._random = np.random.default_rng([settings.seed, 1])
        self._in_transit: deque[tuple[float, bytes]] = deque()
        self._pending_faults = {"reset", "garbage", "silence"}

    def serve(self, wire: Wire, ending: Ending) -> None:
        """Serve one client after the other until an end is due."""
        served = 0
        while not ending.due:
            client = wire.client()
            if client == 0:
                ending.wait(IDLE_INTERVAL)
                continue
            if client != served:
                served = client
                self._begin(time.monotonic())
            if ending.wait(self._next_event() - time.monotonic(), wire.fileno()):
                self._listen(wire)
            self._advance(wire)

    def _begin(self, now: float) -> None:
        """Boot the device and put the plant into its initial state: a client has opened the wire."""
        self._rig.begin()
        self._held = True
        self._silent = False
        self._samples_since_release = 0
        self._due = now
        self._in_transit.clear()
        self._send(self._firmware.boot(now), now)

    def _next_event(self) -> float:
        frame = self._due + (self._per_turn - 1) * self._pace
        return min(frame, self._in_transit[0][0]) if self._in_transit else frame

    def _listen(self, wire: Wire) -> None:
        now = time.monotonic()
        self._skip_delay(now)
        # samples that were due before the command came are taken without it, except the newest
        self._take_samples(now - self._pace, now)
        self._send(self._firmware.receive(wire.read(), now), now)

    def _advance(self, wire: Wire) -> None:
        now = time.monotonic()
        self._firmware.watch(now)
        self._skip_delay(now)
        if now >= self._due + (self._per_turn - 1) * self._pace:
            self._take_samples(now, now)
        while self._in_transit and self._in_transit[0][0] <= now:
            wire.write(self._in_transit.popleft()[1])

    def _skip_delay(self, now: float) -> None:
        """Skip a delay that is too long to catch up: the simulated time has stood still."""
        if now - self._due > self._firmware.board.patience + (self._per_turn - 1) * self._pace:
            self._due = now

    def _take_samples(self, until: float, now: float) -> None:
        """Take the samples that are due by ``until``."""
        count = int((until - self._due) / self._pace) + 1 if until >= self._due else 0
        while count > 0:
            # the sample at which the first command takes effect is still one at rest
            released = self._held and self._firmware.was_set
            taken = self._sample(1 if released else min(count, self._per_turn), now)
            self._due += taken * self._pace
            count -= taken

    def _sample(self, count: int, now: float) -> int:
        if self._held:
            rows = self._rig.rest(self._firmware.output, count)
            self._held = not self._firmware.was_set
        else:
            rows = self._rig.samples(self._firmware.output, count)
            self._samples_since_release += count
        for message in self._firmware.samples(rows):
            if self._random.random() >= self._wire_settings.drop_rate:
                self._send(message, now)
        self._inject_faults(now)
        return count

    def _inject_faults(self, now: float) -> None:
        if self._is_due("reset", self._wire_settings.fault_reset_at):
            self._send(self._firmware.boot(now), now)
        if self._is_due("garbage", self._wire_settings.fault_garbage_at):
            self._send(self._random.bytes(GARBAGE_BYTES), now)
        if self._is_due("silence", self._wire_settings.fault_silence_at):
            self._silent = True

    def _is_due(self, fault: str, at: float) -> bool:
        """Return whether a fault is due, once, and mark it as done."""
        due = at * self._firmware.board.sample_rate
        if at <= 0.0 or fault not in self._pending_faults or self._samples_since_release < due:
            return False
        self._pending_faults.discard(fault)
        return True

    def _send(self, message: bytes, now: float) -> None:
        """Send a message, which arrives after the latency and in order."""
        if self._silent or not message:
            return
        wire = self._wire_settings
        latency = max(wire.latency + wire.latency_jitter * self._random.standard_normal(), 0.0)
        earliest = self._in_transit[-1][0] if self._in_transit else 0.0
        self._in_transit.append((max(now + latency / self._speed, earliest), message))
