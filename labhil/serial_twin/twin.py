"""The twin of a serial rig: a plant, its firmware and a wire, served by a process of its own."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from labhil.driver import ReadyCallback, TwinOptions
from labhil.ending import Ending
from labhil.errors import UnknownNameError, UsageError
from labhil.serial_twin.bench import Bench, SimulatedRig
from labhil.serial_twin.settings import Settable, TwinSettings
from labhil.serial_twin.wires import open_wire
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class SerialTwin:
    """A simulated rig on a serial line; satisfies :class:`labhil.driver.Twin`.

    Each time a client opens the wire the device boots, as an Arduino does, and the plant begins in its
    initial state. (A pty that is closed and opened again within 20 ms goes unnoticed.) Without a client the
    simulated time stands still. The 0.3 s of the watchdog are the host's, whatever the speed.

    Attributes:
        name: Its name.
        rig: Kind of rig.
        description: One line about it.
        effects: Effects of the plant, each with one line about it.
        settable: Its parameters.
        make: Builds and compiles the plant.
        tables: Readers of files that replace some of its parameters, by name.
        sensors: Signals that may not be fitted, each with the parameter that is 0 then.
    """

    name: str
    rig: str
    description: str
    effects: Mapping[str, str]
    settable: Settable
    make: Callable[[TwinSettings], SimulatedRig]
    tables: Mapping[str, Callable[[Path], FloatArray]] = field(default_factory=dict)
    sensors: Mapping[str, str] = field(default_factory=dict)

    def terms(self) -> Mapping[str, str]:
        """Return the effects that the plant can have, each with one line about it."""
        return self.effects

    def parameters(self) -> Mapping[str, float]:
        """Return the parameters that ``--set`` takes, with their defaults (SI; ``clock_drift`` in ppm)."""
        return self.settable.parameters()

    def unfitted(self, parameters: Mapping[str, float]) -> Mapping[str, str]:
        """Return the signals that it lacks with these parameters, each with the setting that fits it."""
        stated = {**self.parameters(), **parameters}
        return {signal: name for signal, name in self.sensors.items() if not stated[name]}

    def serve(self, options: TwinOptions, ready: ReadyCallback) -> None:
        """Run until SIGINT, SIGTERM or, where standard input is a pipe, its end.

        Args:
            options: The options of the twin.
            ready: Is called with the address once a client can connect.

        Raises:
            UsageError: An option is wrong; nothing has been opened.
            UnknownNameError: A name in the options is unknown; likewise.
        """
        settings = replace(TwinSettings.of(options, self.settable), tables=self._tables(options))
        if options.answer is not None:
            write_answer(options.answer, settings)
        with Ending() as ending:
            bench = Bench(settings, self.make(settings))
            wire = open_wire(options.wire)
            try:
                ready(wire.address)
                bench.serve(wire, ending)
            finally:
                wire.close()

    def _tables(self, options: TwinOptions) -> dict[str, FloatArray]:
        """Read the tables; UsageError where a parameter that a table replaces is set, too."""
        tables = {}
        for name, path in options.tables.items():
            if name not in self.tables:
                raise UnknownNameError("table", name, self.tables)
            for parameter in options.parameters:
                if parameter.startswith(f"{name}_"):
                    raise UsageError(f"expected {parameter} or a table for {name}, found both")
            tables[name] = self.tables[name](path)
        return tables


def write_answer(path: Path, settings: TwinSettings) -> None:
    """Write the terms and parameters of the twin; UsageError where the file cannot be written."""
    try:
        path.write_text(json.dumps(settings.answer(), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: the twin's answer cannot be written: {error}") from error
