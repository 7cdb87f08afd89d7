"""The simulated ball and beam with its board: pulse width in, converter counts out."""

from __future__ import annotations

import math

import numpy as np

from labhil.link import ChannelScale
from labhil.plants.ball_beam import BallBeamPlant
from labhil.serial_twin.firmware import Board, Raw
from labhil.serial_twin.settings import TwinSettings

SAMPLE_RATE = 100.0
LEVEL = 15000
"""Pulse width, in 0.1 µs, at which the beam is level."""
QUARTER_TURN = 5000
SERVO = ChannelScale(math.pi / 2 / QUARTER_TURN, LEVEL)


def make_board(position: ChannelScale, speed: float, clock_start: float, pulse_resolution: float) -> Board:
    """Make the board of the bench.

    Args:
        position: Scale of the position's counts.
        speed: Simulated time over real time.
        clock_start: Time of the device's clock at the start, s.
        pulse_resolution: Step of the servo's pulse width, s.
    """
    step = max(round(pulse_resolution / 1e-7), 1)

    def quantise(output: int) -> int:
        steps = round((output - LEVEL) / step)
        return LEVEL + min(max(steps * step, -QUARTER_TURN), QUARTER_TURN)

    return Board("ball_beam", (position, SERVO), LEVEL, quantise, SAMPLE_RATE, speed, clock_start)


class BallBeamBench:
    """The bench; the ball is held at ``start_position`` until the first SET.

    Within a sample period the servo moves linearly from the pulse at the last sample to the latest one.
    """

    def __init__(self, settings: TwinSettings) -> None:
        period = 1.0 / SAMPLE_RATE / (1.0 + 1e-6 * settings.wire.clock_drift)
        # compile the plant before a client waits for it
        BallBeamPlant(settings.plant, settings.terms, 0, period).step(0.01)
        self._plant = BallBeamPlant(settings.plant, settings.terms, settings.seed, period)
        sensor = self._plant.sensor
        position = ChannelScale(sensor.scale, float(sensor.zero))
        resolution = settings.device["pulse_resolution"]
        self.board = make_board(position, settings.speed, settings.wire.clock_start, resolution)
        self.begin()

    def begin(self) -> None:
        """Place the ball at its start position."""
        self._plant.place(self._plant.parameters["start_position"])
        self._pulse = LEVEL

    def rest(self, output: int, count: int) -> Raw:
        """Return samples of a held ball."""
        return np.concatenate([self._row(self._plant.count(), output) for _ in range(count)])

    def samples(self, output: int, count: int) -> Raw:
        """Return the next samples; the servo has reached the command of the previous sample."""
        return np.concatenate(
            [self._row(self._plant.step(SERVO.value(self._pulse)), output) for _ in range(count)]
        )

    def _row(self, count: int, output: int) -> Raw:
        row = np.array([[count, self._pulse]], dtype=np.uint16)
        self._pulse = output
        return row
