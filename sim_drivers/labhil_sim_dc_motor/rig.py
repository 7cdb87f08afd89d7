"""The simulated DC motor in the raw numbers of its board: voltage in, counts out."""

from __future__ import annotations

import math

import numpy as np

from labhil.link import ChannelScale
from labhil.plants.dc_motor import DcMotorPlant
from labhil.serial_twin.converter import NOT_FITTED, Converter, Counter
from labhil.serial_twin.firmware import Board, Raw
from labhil.serial_twin.settings import TwinSettings

STILL = 32_768
LARGEST = 12_000
"""12 V."""
VOLTAGE = ChannelScale(1e-3, float(STILL))
COLDEST, HOTTEST = -40.0, 215.0

PATIENCE = 0.25
"""s; nothing falls down while its controller is away."""


class DcMotorBench:
    """A motor whose voltage is held from sample to sample.

    The world begins at rest, without current, at ambient temperature whenever a client opens the wire.
    """

    def __init__(self, settings: TwinSettings) -> None:
        self._settings, device = settings, settings.device
        rate = device["sample_rate"]
        self._period = 1.0 / rate / (1.0 + 1e-6 * settings.wire.clock_drift)
        bits = int(device["adc_bits"])
        fitted: dict[str, Converter | Counter | None] = {
            "speed": Converter(-device["largest_speed"], device["largest_speed"], bits),
            "current": Converter(-device["largest_current"], device["largest_current"], bits),
            "angle": Counter(2.0 * math.pi / device["encoder"]) if device["encoder"] else None,
            "winding_temperature": Converter(COLDEST, HOTTEST, bits)
            if device["temperature_sensor"]
            else None,
        }
        self._converters = {name: converter for name, converter in fitted.items() if converter is not None}
        scales = [NOT_FITTED if converter is None else converter.scale for converter in fitted.values()]
        self.board = Board(
            "dc_motor",
            (*scales, VOLTAGE),
            STILL,
            lambda wanted: min(max(wanted, STILL - LARGEST), STILL + LARGEST),
            rate,
            settings.speed,
            settings.wire.clock_start,
            int(device["samples_per_frame"]),
            device["longest_output"],
            patience=PATIENCE,
        )
        self._begun = 0
        self.begin()
        # compile before anybody waits, on a plant that is thrown away
        self.samples(STILL + LARGEST, 2)
        self._begun = 0

    def begin(self) -> None:
        """A new world, with noise of its own."""
        settings = self._settings
        seed = settings.seed + 7919 * self._begun
        self._begun += 1
        self._plant = DcMotorPlant(settings.plant, settings.terms, seed, self._period)
        self._held = STILL

    def rest(self, output: int, count: int) -> Raw:
        """Samples of a motor without voltage."""
        return self.samples(output, count)

    def samples(self, output: int, count: int) -> Raw:
        """The next samples: the voltage of the sample before is held up to the first of them."""
        voltage = np.full(count, VOLTAGE.value(output))
        voltage[0] = VOLTAGE.value(self._held)
        self._held = output
        seen = self._plant.advance(voltage)
        columns = [converter.raw(seen[name]) for name, converter in self._converters.items()]
        return np.column_stack([*columns, np.full(count, output, dtype=np.uint16)])
