"""The simulated DC motor with its board: voltage in, counts out."""

from __future__ import annotations

import math

import numpy as np

from labhil.link import ChannelScale
from labhil.plants.dc_motor import DcMotorPlant
from labhil.serial_twin.converter import NOT_FITTED, Converter, Counter
from labhil.serial_twin.firmware import Board, Raw
from labhil.serial_twin.settings import TwinSettings

ZERO_VOLTAGE = 32_768
MAX_COMMAND = 12_000
"""Largest command from zero voltage, mV."""
VOLTAGE = ChannelScale(1e-3, float(ZERO_VOLTAGE))
MIN_TEMPERATURE, MAX_TEMPERATURE = -40.0, 215.0

PATIENCE = 0.25
"""Delay of the host up to which the bench catches up, s; nothing falls down without a controller."""


class DcMotorBench:
    """A motor whose voltage is constant between samples.

    Whenever a client connects, it begins at rest, without current, at ambient temperature.
    """

    def __init__(self, settings: TwinSettings) -> None:
        self._settings, device = settings, settings.device
        rate = device["sample_rate"]
        self._period = 1.0 / rate / (1.0 + 1e-6 * settings.wire.clock_drift)
        bits = int(device["adc_bits"])
        channels: dict[str, Converter | Counter | None] = {
            "speed": Converter(-device["largest_speed"], device["largest_speed"], bits),
            "current": Converter(-device["largest_current"], device["largest_current"], bits),
            "angle": Counter(2.0 * math.pi / device["encoder"]) if device["encoder"] else None,
            "winding_temperature": Converter(MIN_TEMPERATURE, MAX_TEMPERATURE, bits)
            if device["temperature_sensor"]
            else None,
        }
        self._converters = {name: converter for name, converter in channels.items() if converter is not None}
        scales = [NOT_FITTED if converter is None else converter.scale for converter in channels.values()]
        self.board = Board(
            "dc_motor",
            (*scales, VOLTAGE),
            ZERO_VOLTAGE,
            lambda output: min(max(output, ZERO_VOLTAGE - MAX_COMMAND), ZERO_VOLTAGE + MAX_COMMAND),
            rate,
            settings.speed,
            settings.wire.clock_start,
            int(device["samples_per_frame"]),
            device["longest_output"],
            patience=PATIENCE,
        )
        self._n_worlds = 0
        self.begin()
        # compile the plant before a client waits for it
        self.samples(ZERO_VOLTAGE + MAX_COMMAND, 2)
        self._n_worlds = 0

    def begin(self) -> None:
        """Begin a new simulation with other noise."""
        settings = self._settings
        seed = settings.seed + 7919 * self._n_worlds
        self._n_worlds += 1
        self._plant = DcMotorPlant(settings.plant, settings.terms, seed, self._period)
        self._last_output = ZERO_VOLTAGE

    def rest(self, output: int, count: int) -> Raw:
        """Return samples of a motor without voltage."""
        return self.samples(output, count)

    def samples(self, output: int, count: int) -> Raw:
        """Return the next samples; the voltage of the previous sample acts up to the first of them."""
        voltage = np.full(count, VOLTAGE.value(output))
        voltage[0] = VOLTAGE.value(self._last_output)
        self._last_output = output
        measured = self._plant.advance(voltage)
        columns = [converter.raw(measured[name]) for name, converter in self._converters.items()]
        return np.column_stack([*columns, np.full(count, output, dtype=np.uint16)])
