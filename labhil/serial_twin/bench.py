"""The bench as a whole: a simulated rig and its firmware on a wire, paced against the clock."""

from __future__ import annotations

import time
from collections import deque
from typing import Protocol

import numpy as np

from labhil.ending import Ending
from labhil.serial_twin.firmware import Board, Firmware, Raw
from labhil.serial_twin.settings import TwinSettings
from labhil.serial_twin.wires import Wire

IDLE = 0.02
"""How often (s) an unattended twin looks for a client."""
GARBAGE = 300


class SimulatedRig(Protocol):
    """A plant with its sensors and its actuator, in raw numbers."""

    board: Board

    def begin(self) -> None:
        """Put the plant where it begins: a client has opened the wire."""
        ...

    def rest(self, output: int, count: int) -> Raw:
        """What is sampled (count, fitted channels) before anything was commanded."""
        ...

    def samples(self, output: int, count: int) -> Raw:
        """Let ``count`` sample periods pass under that command; what is sampled (count, channels)."""
        ...


class Bench:
    """A simulated rig with its microcontroller.

    Sample k of the device's clock happens k/(rate·speed) seconds after the client came, by the
    monotonic clock. Small delays are caught up, for a world that paused would bend the device's
    clock; after a long one it has paused, rather than run on without its controller.
    """

    def __init__(self, settings: TwinSettings, rig: SimulatedRig) -> None:
        self._wire_settings = settings.wire
        board = rig.board
        self._pace = 1.0 / board.sample_rate / (1.0 + 1e-6 * settings.wire.clock_drift) / settings.speed
        self._speed = settings.speed
        self._rig, self._firmware = rig, Firmware(board)
        self._per_turn = max(board.per_frame, 1)
        self._random = np.random.default_rng([settings.seed, 1])
        self._on_the_way: deque[tuple[float, bytes]] = deque()
        self._faults_left = {"reset", "garbage", "silence"}

    def serve(self, wire: Wire, ending: Ending) -> None:
        """Serve one client after the other until the end is due."""
        served = 0
        while not ending.due:
            client = wire.client()
            if client == 0:
                ending.wait(IDLE)
                continue
            if client != served:
                served = client
                self._begin(time.monotonic())
            if ending.wait(self._next_event() - time.monotonic(), wire.fileno()):
                self._listen(wire)
            self._go_on(wire)

    def _begin(self, now: float) -> None:
        """A client has opened the wire: the device boots, the rig is put where it begins."""
        self._rig.begin()
        self._held = True
        self._silent = False
        self._samples_since_release = 0
        self._due = now
        self._on_the_way.clear()
        self._send(self._firmware.boot(now), now)

    def _next_event(self) -> float:
        frame = self._due + (self._per_turn - 1) * self._pace
        return min(frame, self._on_the_way[0][0]) if self._on_the_way else frame

    def _listen(self, wire: Wire) -> None:
        now = time.monotonic()
        self._pause_where_late(now)
        # samples that were due before a command came are taken without it, but for the newest
        self._take_samples(now - self._pace, now)
        self._send(self._firmware.receive(wire.read(), now), now)

    def _go_on(self, wire: Wire) -> None:
        now = time.monotonic()
        self._firmware.watch(now)
        self._pause_where_late(now)
        if now >= self._due + (self._per_turn - 1) * self._pace:
            self._take_samples(now, now)
        while self._on_the_way and self._on_the_way[0][0] <= now:
            wire.write(self._on_the_way.popleft()[1])

    def _pause_where_late(self, now: float) -> None:
        """What cannot be caught up has not happened: the world has stood still."""
        if now - self._due > self._firmware.board.patience + (self._per_turn - 1) * self._pace:
            self._due = now

    def _take_samples(self, until: float, now: float) -> None:
        """Take the samples that are due by ``until``."""
        count = int((until - self._due) / self._pace) + 1 if until >= self._due else 0
        while count > 0:
            # the sample at which the first command is taken over is still one at rest
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
        self._misbehave(now)
        return count

    def _misbehave(self, now: float) -> None:
        if self._strikes("reset", self._wire_settings.fault_reset_at):
            self._send(self._firmware.boot(now), now)
        if self._strikes("garbage", self._wire_settings.fault_garbage_at):
            self._send(self._random.bytes(GARBAGE), now)
        if self._strikes("silence", self._wire_settings.fault_silence_at):
            self._silent = True

    def _strikes(self, fault: str, at: float) -> bool:
        """Tell whether it is time for a fault that has not happened yet."""
        due = at * self._firmware.board.sample_rate
        if at <= 0.0 or fault not in self._faults_left or self._samples_since_release < due:
            return False
        self._faults_left.discard(fault)
        return True

    def _send(self, message: bytes, now: float) -> None:
        """Put a message on its way; it arrives after the latency, and in order."""
        if self._silent or not message:
            return
        wire = self._wire_settings
        latency = max(wire.latency + wire.latency_jitter * self._random.standard_normal(), 0.0)
        earliest = self._on_the_way[-1][0] if self._on_the_way else 0.0
        self._on_the_way.append((max(now + latency / self._speed, earliest), message))
