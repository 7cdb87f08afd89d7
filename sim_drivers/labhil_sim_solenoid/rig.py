"""The simulated solenoid in the raw numbers of its board: current command in, converters' counts out."""

from __future__ import annotations

import numpy as np

from labhil.link import ChannelScale
from labhil.plants.current_loop import CurrentLoop
from labhil.plants.solenoid import SolenoidPlant
from labhil.serial_twin.converter import NOT_FITTED, Converter
from labhil.serial_twin.firmware import Board, Raw
from labhil.serial_twin.settings import TwinSettings

COMMAND = ChannelScale(1e-4, 0.0)
LARGEST = 27_000
"""2.7 A."""
LOWEST_CURRENT, HIGHEST_CURRENT = -0.3, 3.0
LARGEST_VOLTAGE = 30.0
LOWEST_FORCE, HIGHEST_FORCE = -10.0, 110.0
MARGIN = 0.1
"""Share of the stroke by which the position sensor reaches beyond the stops."""

PATIENCE = 0.25
"""s; nothing falls down while its controller is away."""


class SolenoidBench:
    """The coil's current follows the command through the device's PI; the plunger follows the current.

    The world begins at rest at the lower stop, without current, whenever a client opens the wire.
    """

    def __init__(self, settings: TwinSettings) -> None:
        self._settings, device = settings, settings.device
        rate = device["sample_rate"]
        self._period = 1.0 / rate / (1.0 + 1e-6 * settings.wire.clock_drift)
        bits, plant = int(device["adc_bits"]), settings.plant
        low, high = plant["stop_low"], plant["stop_high"]
        beyond = MARGIN * (high - low)
        self._converters = {
            "coil_current": Converter(LOWEST_CURRENT, HIGHEST_CURRENT, bits),
            "plunger_position": Converter(low - beyond, high + beyond, bits),
            "coil_voltage": Converter(-LARGEST_VOLTAGE, LARGEST_VOLTAGE, bits),
        }
        force = Converter(LOWEST_FORCE, HIGHEST_FORCE, bits)
        if device["load_cell"]:
            self._converters["magnetic_force"] = force
        scales = [converter.scale for converter in self._converters.values()]
        self.board = Board(
            "solenoid",
            (*scales, *([] if device["load_cell"] else [NOT_FITTED]), COMMAND),
            0,
            lambda wanted: min(wanted, LARGEST),
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
        self.samples(LARGEST, 2)
        self._begun = 0

    def begin(self) -> None:
        """A new world, with noise of its own."""
        settings, device, plant = self._settings, self._settings.device, self._settings.plant
        seed = settings.seed + 7919 * self._begun
        self._begun += 1
        table = settings.tables.get("force_map")
        self._plant = SolenoidPlant(plant, settings.terms, seed, self._period, table)
        self._loop = CurrentLoop(
            plant["coil_inductance"],
            plant["loop_time"],
            device["supply_voltage"],
            device["loop_rate"],
            self._period,
        )
        self._held = 0

    def rest(self, output: int, count: int) -> Raw:
        """Samples of a coil without current."""
        return self.samples(output, count)

    def samples(self, output: int, count: int) -> Raw:
        """The next samples: the command of the sample before acts up to the first of them."""
        commands = np.full(count, COMMAND.value(output))
        commands[0] = COMMAND.value(self._held)
        self._held = output
        current = self._loop.follow(commands, *self._plant.coil())
        seen = self._plant.advance(current)
        columns = [converter.raw(seen[name]) for name, converter in self._converters.items()]
        return np.column_stack([*columns, np.full(count, output, dtype=np.uint16)])
