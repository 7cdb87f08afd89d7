"""The bench as a whole: plant and firmware, sample by sample, on a wire."""

from __future__ import annotations

import time
from collections import deque

import numpy as np

from labhil.link import ChannelScale
from labhil.plants.ball_beam import BallBeamPlant
from labhil_sim_ball_beam.ending import Ending
from labhil_sim_ball_beam.firmware import LEVEL, SAMPLE_RATE, SERVO, Firmware
from labhil_sim_ball_beam.settings import TwinSettings
from labhil_sim_ball_beam.wires import Wire

IDLE = 0.02
"""How often (s) an unattended twin looks for a client."""
PATIENCE = 0.05
"""How far (s) a twin may fall behind and still catch up; beyond that its world has paused."""
GARBAGE = 300


class Bench:
    """A simulated rig with its microcontroller.

    Sample k of the device's clock happens k/(100·speed) seconds after the client came, by the
    monotonic clock. Small delays are caught up, for a world that paused would bend the device's
    clock; after a long one it has paused, rather than run on without its controller.
    """

    def __init__(self, settings: TwinSettings) -> None:
        self._wire_settings = settings.wire
        period = 1.0 / SAMPLE_RATE / (1.0 + 1e-6 * settings.wire.clock_drift)
        self._pace = period / settings.speed
        self._speed = settings.speed
        self._plant = BallBeamPlant(settings.plant, settings.terms, settings.seed, period)
        self._warm_up(settings, period)
        sensor = self._plant.sensor
        pulse_step = max(round(settings.wire.pulse_resolution / 1e-7), 1)
        position = ChannelScale(sensor.scale, float(sensor.zero))
        self._firmware = Firmware(position, settings.speed, settings.wire.clock_start, pulse_step)
        self._random = np.random.default_rng([settings.seed, 1])
        self._on_the_way: deque[tuple[float, bytes]] = deque()
        self._faults_left = {"reset", "garbage", "silence"}
        self._begin(0.0)

    @staticmethod
    def _warm_up(settings: TwinSettings, period: float) -> None:
        """Compile before anybody waits, on a plant that is thrown away."""
        BallBeamPlant(settings.plant, settings.terms, 0, period).step(0.01)

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
        """A client has opened the wire: the device boots, a hand puts the ball where it belongs."""
        self._plant.place(self._plant.parameters["start_position"])
        self._held = True
        self._silent = False
        self._samples_since_release = 0
        self._pulse = LEVEL
        self._due = now
        self._on_the_way.clear()
        self._send(self._firmware.boot(now), now)

    def _next_event(self) -> float:
        return min(self._due, self._on_the_way[0][0]) if self._on_the_way else self._due

    def _listen(self, wire: Wire) -> None:
        now = time.monotonic()
        self._send(self._firmware.receive(wire.read(), now), now)

    def _go_on(self, wire: Wire) -> None:
        now = time.monotonic()
        self._firmware.watch(now)
        if now - self._due > PATIENCE:
            self._due = now
        while now >= self._due:
            self._sample(now)
            self._due += self._pace
        while self._on_the_way and self._on_the_way[0][0] <= now:
            wire.write(self._on_the_way.popleft()[1])

    def _sample(self, now: float) -> None:
        """Let one sample period end: the servo has arrived where it was sent at the last sample."""
        if self._held:
            count = self._plant.count()
            self._held = not self._firmware.was_set
        else:
            count = self._plant.step(SERVO.value(self._pulse))
            self._samples_since_release += 1
        message = self._firmware.sample(count, self._pulse)
        if self._random.random() >= self._wire_settings.drop_rate:
            self._send(message, now)
        self._pulse = self._firmware.pulse
        self._misbehave(now)

    def _misbehave(self, now: float) -> None:
        if self._strikes("reset", self._wire_settings.fault_reset_at):
            self._send(self._firmware.boot(now), now)
        if self._strikes("garbage", self._wire_settings.fault_garbage_at):
            self._send(self._random.bytes(GARBAGE), now)
        if self._strikes("silence", self._wire_settings.fault_silence_at):
            self._silent = True

    def _strikes(self, fault: str, at: float) -> bool:
        """Tell whether it is time for a fault that has not happened yet."""
        if at <= 0.0 or fault not in self._faults_left or self._samples_since_release < at * SAMPLE_RATE:
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
