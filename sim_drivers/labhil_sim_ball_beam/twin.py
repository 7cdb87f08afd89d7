"""The twin: a plant behind a firmware behind a wire, paced against the clock."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from labhil.driver import ReadyCallback, TwinOptions
from labhil.errors import UsageError
from labhil.plants.effects import EFFECTS
from labhil_sim_ball_beam.settings import TwinSettings, twin_parameters
from labhil_sim_ball_beam.wires import open_wire


class BallBeamTwin:
    """A ball and beam that is not there; satisfies :class:`labhil.driver.Twin`.

    Each time a client opens the wire the device boots, as an Arduino does, and a hand holds the ball
    still at ``start_position`` until the first SET. (A pty that is closed and opened again within
    20 ms goes unnoticed.) Without a client the world stands still. The watchdog's 0.3 s are the
    host's, whatever the speed.
    """

    name = "ball_beam"
    rig = "ball_beam"
    description = "simulated ball and beam: servo pulse in, potentiometer counts out, 100 Hz"

    def terms(self) -> Mapping[str, str]:
        """Names of the effects that the plant can carry, each with one line about it."""
        return {name: effect.about for name, effect in EFFECTS.items()}

    def parameters(self) -> Mapping[str, float]:
        """Names that ``--set`` takes, with their default values (SI; ``clock_drift`` in ppm)."""
        return twin_parameters()

    def serve(self, options: TwinOptions, ready: ReadyCallback) -> None:
        """Run until SIGINT, SIGTERM or, where standard input is a pipe, its end.

        Raises UsageError or UnknownNameError for options that make no twin, before anything is opened.
        """
        # compiling the plant takes a moment, and a list of twins must not
        from labhil_sim_ball_beam.bench import Bench
        from labhil_sim_ball_beam.ending import Ending

        settings = TwinSettings.of(options)
        if options.answer is not None:
            write_answer(options.answer, settings)
        with Ending() as ending:
            bench = Bench(settings)
            wire = open_wire(options.wire)
            try:
                ready(wire.address)
                bench.serve(wire, ending)
            finally:
                wire.close()


def write_answer(path: Path, settings: TwinSettings) -> None:
    """Write what the twin is made of; UsageError when the file cannot be written."""
    try:
        path.write_text(json.dumps(settings.answer(), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: the twin's answer cannot be written: {error}") from error


TWIN = BallBeamTwin()
