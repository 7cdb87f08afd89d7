"""The simulated ball and beam in the raw numbers of its board: pulse width in, converter counts out."""

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


def board(position: ChannelScale, speed: float, clock_start: float, pulse_resolution: float) -> Board:
    """The board of the bench; the servo's pulse has steps of ``pulse_resolution`` s."""
    step = max(round(pulse_resolution / 1e-7), 1)

    def allowed(wanted: int) -> int:
        steps = round((wanted - LEVEL) / step)
        return LEVEL + min(max(steps * step, -QUARTER_TURN), QUARTER_TURN)

    return Board("ball_beam", (position, SERVO), LEVEL, allowed, SAMPLE_RATE, speed, clock_start)


class BallBeamBench:
    """A hand holds the ball still at ``start_position`` until the first SET.

    Within a sample period the servo goes straight from the pulse at the last sample to the latest one.
    """

    def __init__(self, settings: TwinSettings) -> None:
        period = 1.0 / SAMPLE_RATE / (1.0 + 1e-6 * settings.wire.clock_drift)
        # compile before anybody waits, on a plant that is thrown away
        BallBeamPlant(settings.plant, settings.terms, 0, period).step(0.01)
        self._plant = BallBeamPlant(settings.plant, settings.terms, settings.seed, period)
        sensor = self._plant.sensor
        position = ChannelScale(sensor.scale, float(sensor.zero))
        resolution = settings.device["pulse_resolution"]
        self.board = board(position, settings.speed, settings.wire.clock_start, resolution)
        self.begin()

    def begin(self) -> None:
        """A hand puts the ball where it belongs."""
        self._plant.place(self._plant.parameters["start_position"])
        self._pulse = LEVEL

    def rest(self, output: int, count: int) -> Raw:
        """Samples of a ball that is held."""
        return np.concatenate([self._row(self._plant.count(), output) for _ in range(count)])

    def samples(self, output: int, count: int) -> Raw:
        """The next samples: the servo has arrived where it was sent at the sample before."""
        return np.concatenate(
            [self._row(self._plant.step(SERVO.value(self._pulse)), output) for _ in range(count)]
        )

    def _row(self, count: int, output: int) -> Raw:
        row = np.array([[count, self._pulse]], dtype=np.uint16)
        self._pulse = output
        return row
