"""Simulated devices that are started for a run and stopped after it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from labhil.errors import UsageError
from labhil.experiment.experiment import TwinSection
from labhil.service.child import Child

START_TIMEOUT = 180.0
"""How long a twin may take to open its port, s: the first start compiles its plant, beside other twins."""


def start_twin(
    device: str,
    kind: str,
    section: TwinSection,
    answer: Path,
    interrupted: Callable[[], bool],
    directory: Path = Path(),
) -> tuple[Child, str]:
    """Start the twin ``kind`` for ``device``; return its process and the address to connect to.

    What it is made of goes to ``answer``; its tables are relative to ``directory``. Raises UsageError
    with the twin's own words when it does not start, BusError when it says nothing; the address is
    empty when ``interrupted`` turned true.
    """
    twin = Child(f"the twin of {device!r}", twin_command(kind, section, answer, directory))
    try:
        address = twin.line(START_TIMEOUT, interrupted)
    except BaseException:
        twin.stop()
        raise
    if address is None and not interrupted():
        complaint = twin.complaint()
        twin.stop()
        raise UsageError(f"{twin.name} did not start{complaint}")
    return twin, address or ""


def twin_command(kind: str, section: TwinSection, answer: Path, directory: Path = Path()) -> list[str]:
    """Return the command line that starts a twin; its tables are relative to ``directory``."""
    command = [sys.executable, "-P", "-m", "labhil", "twin", kind]
    command += ["--seed", str(section.seed), "--speed", repr(section.speed), "--wire", section.wire]
    if section.terms is not None:
        command += ["--terms", ",".join(section.terms)]
    for name, value in section.set.items():
        command += ["--set", f"{name}={value!r}"]
    for name, file in section.tables.items():
        command += ["--table", f"{name}={directory / file}"]
    for option, chosen in (("--host", section.host), ("--series", section.series)):
        command += [] if chosen is None else [option, chosen]
    return [*command, "--answer", str(answer)]
