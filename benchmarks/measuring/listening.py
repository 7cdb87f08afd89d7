"""A recording of devices that nobody commands, as `labhil serve` makes it: for what is measured over minutes.

Where whole processes are kept from running for longer than the watchdog waits, a run ends; a recording goes
on, and shows what came in spite of it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from labhil.bus.session import open_bus
from labhil.experiment.device_sections import parse_devices
from labhil.experiment.lab import Lab
from labhil.experiment.lab_service import LabService


@dataclass(frozen=True, slots=True)
class ListeningResult:
    """The outcome; ``reason`` is why it ended, ``exit_status`` 0 where the time was over."""

    path: Path | None
    exit_status: int
    reason: str


def record_listening(devices: str, seconds: float, folder: Path) -> ListeningResult:
    """Record these devices (sections of a lab file) for so long after the last of them is up."""
    text = f'[lab]\nname = "measured"\nroll = {10.0 * seconds + 600.0!r}\nanalyse = []\n{devices}'
    lab = parse_devices(text, folder / "lab.toml", Lab)
    up: dict[str, float] = {}

    def say(line: str) -> None:
        if line.endswith(" is up"):
            up["since"] = time.monotonic()

    with open_bus() as bus:
        service = LabService(lab, bus, folder, say)
        service.run(lambda: "since" in up and time.monotonic() - up["since"] > seconds)
    path = next(iter(folder.glob("*.mcap")), None)
    failed = "; ".join(f"{name}: {error}" for name, error in service.failed.items())
    return ListeningResult(path, 1 if failed else 0, failed or "the time is over")
