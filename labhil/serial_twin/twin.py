"""The twin: a plant behind a firmware behind a wire, as a program of its own."""

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
    """A rig on a serial line that is not there; satisfies :class:`labhil.driver.Twin`.

    Each time a client opens the wire the device boots, as an Arduino does, and the plant begins anew.
    (A pty that is closed and opened again within 20 ms goes unnoticed.) Without a client the world
    stands still. The watchdog's 0.3 s are the host's, whatever the speed.

    ``effects`` are what the plant can carry, each with one line about it; ``make`` builds the plant and
    compiles it; ``tables`` read the files that take the place of some of its numbers.
    """

    name: str
    rig: str
    description: str
    effects: Mapping[str, str]
    settable: Settable
    make: Callable[[TwinSettings], SimulatedRig]
    tables: Mapping[str, Callable[[Path], FloatArray]] = field(default_factory=dict)

    def terms(self) -> Mapping[str, str]:
        """Names of the effects that the plant can carry, each with one line about it."""
        return self.effects

    def parameters(self) -> Mapping[str, float]:
        """Names that ``--set`` takes, with their default values (SI; ``clock_drift`` in ppm)."""
        return self.settable.parameters()

    def serve(self, options: TwinOptions, ready: ReadyCallback) -> None:
        """Run until SIGINT, SIGTERM or, where standard input is a pipe, its end.

        Raises UsageError or UnknownNameError for options that make no twin, before anything is opened.
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
        """What stands in the files; UsageError where a number is set, too, that a table replaces."""
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
    """Write what the twin is made of; UsageError when the file cannot be written."""
    try:
        path.write_text(json.dumps(settings.answer(), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: the twin's answer cannot be written: {error}") from error
