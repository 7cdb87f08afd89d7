"""``labhil`` for a machine that is kept from running now and then:

    python tests/patient_labhil.py run experiment.toml

A host brings its device to safety where commands stop for 0.22 s, and a simulated arm stops its program where
its client is silent for 0.1 s. Both are right to do so on a test machine that has no time, but end the run.
Tests of anything else wait longer, so that they fail for what they test only.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Any

from labhil.experiment import devices, twins
from labhil.service.messages import HostConfig

PATIENT_WATCHDOG = 5.0
"""s that commands to a host may stop; a loaded machine keeps a process waiting for a second or two."""

SLOWER_ARM = 20.0
"""By how much longer a simulated arm waits for its client, too."""

COMMAND = (sys.executable, "-P", str(Path(__file__).resolve()))
"""What ``labhil`` is in a process of its own."""

patient_config = partial(HostConfig, watchdog=PATIENT_WATCHDOG)
"""A host's configuration with that watchdog."""

_twin_command = twins.twin_command


def patient_twin_command(*arguments: Any) -> list[str]:
    """Return the command line of a twin that waits longer, too."""
    command = _twin_command(*arguments)
    return [*COMMAND, *command[command.index("labhil") + 1 :]]


def main() -> None:
    """Run the command line with longer watchdogs."""
    from labhil.cli import main as labhil
    from labhil_sim_ur5.program import Program

    set_watchdog = Program.set_watchdog
    Program.set_watchdog = lambda self, frequency: set_watchdog(self, frequency / SLOWER_ARM)  # type: ignore[method-assign]
    devices.HostConfig = patient_config  # type: ignore[misc,assignment]
    twins.twin_command = patient_twin_command
    labhil()


if __name__ == "__main__":
    main()
