"""The simulated solenoid with its board: current command in, converter counts out."""

from __future__ import annotations

import numpy as np

from labhil.link import ChannelScale
from labhil.plants.current_loop import CurrentLoop
from labhil.plants.solenoid import SolenoidPlant
from labhil.serial_twin.converter import NOT_FITTED, Converter
from labhil.serial_twin.firmware import Board, Raw
from labhil.serial_twin.settings import TwinSettings

COMMAND = ChannelScale(1e-4, 0.0)
MAX_COMMAND = 27_000
"""Largest command, 0.1 mA."""
MIN_CURRENT, MAX_CURRENT = -0.3, 3.0
MAX_VOLTAGE = 30.0
MIN_FORCE, MAX_FORCE = -10.0, 110.0
MARGIN = 0.1
"""Range of the position sensor beyond each stop, as a share of the stroke."""

PATIENCE = 0.25
"""Delay of the host up to which the bench catches up, s; nothing falls down without a controller."""


class SolenoidBench:
    """A solenoid whose coil current follows the command by the device's PI controller.

    Whenever a client connects, it begins at rest at the lower stop, without current.
    """

    def __init__(self, settings: TwinSettings) -> None:
        self._settings, device = settings, settings.device
        rate = device["sample_rate"]
        self._period = 1.0 / rate / (1.0 + 1e-6 * settings.wire.clock_drift)
        bits, plant = int(device["adc_bits"]), settings.plant
        low, high = plant["stop_low"], plant["stop_high"]
        margin = MARGIN * (high - low)
        self._converters = {
            "coil_current": Converter(MIN_CURRENT, MAX_CURRENT, bits),
            "plunger_position": Converter(low - margin, high + margin, bits),
            "coil_voltage": Converter(-MAX_VOLTAGE, MAX_VOLTAGE, bits),
        }
        force = Converter(MIN_FORCE, MAX_FORCE, bits)
        if device["load_cell"]:
            self._converters["magnetic_force"] = force
        scales = [converter.scale for converter in self._converters.values()]
        self.board = Board(
            "solenoid",
            (*scales, *([] if device["load_cell"] else [NOT_FITTED]), COMMAND),
            0,
            lambda output: min(output, MAX_COMMAND),
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
        self.samples(MAX_COMMAND, 2)
        self._n_worlds = 0

    def begin(self) -> None:
        """Begin a new simulation with other noise."""
        settings, device, plant = self._settings, self._settings.device, self._settings.plant
        seed = settings.seed + 7919 * self._n_worlds
        self._n_worlds += 1
        table = settings.tables.get("force_map")
        self._plant = SolenoidPlant(plant, settings.terms, seed, self._period, table)
        self._loop = CurrentLoop(
            plant["coil_inductance"],
            plant["loop_time"],
            device["supply_voltage"],
            device["loop_rate"],
            self._period,
        )
        self._last_output = 0

    def rest(self, output: int, count: int) -> Raw:
        """Return samples of a coil without current."""
        return self.samples(output, count)

    def samples(self, output: int, count: int) -> Raw:
        """Return the next samples; the command of the previous sample acts up to the first of them."""
        commands = np.full(count, COMMAND.value(output))
        commands[0] = COMMAND.value(self._last_output)
        self._last_output = output
        current = self._loop.follow(commands, *self._plant.coil())
        measured = self._plant.advance(current)
        columns = [converter.raw(measured[name]) for name, converter in self._converters.items()]
        return np.column_stack([*columns, np.full(count, output, dtype=np.uint16)])
