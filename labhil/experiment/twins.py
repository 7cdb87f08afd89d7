"""Starting simulated devices (twins), each in a process of its own, for a run or a lab."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from labhil.errors import UsageError
from labhil.experiment.device_sections import TwinSection
from labhil.service.child import Child


def start_twin(
    device: str,
    kind: str,
    section: TwinSection,
    answer: Path,
    interrupted: Callable[[], bool],
    directory: Path = Path(),
    *,
    timeout: float = 180.0,
) -> tuple[Child, str]:
    """Start a simulated device.

    Args:
        device: Name of the device in the experiment.
        kind: Name of the twin.
        section: Its settings.
        answer: File to which its terms and parameters are written.
        interrupted: Whether to stop waiting.
        directory: Where relative paths of its tables begin.
        timeout: How long it may take to open its port, s: the first start compiles its plant, perhaps beside
            other twins.

    Returns:
        Its process, and the address to connect to; empty after an interruption.

    Raises:
        UsageError: It does not start; the message is the twin's own.
        BusError: It does not report its address in time.
    """
    twin = Child(f"the twin of {device!r}", twin_command(kind, section, answer, directory))
    try:
        address = twin.line(timeout, interrupted)
    except BaseException:
        twin.stop()
        raise
    if address is None and not interrupted():
        message = twin.last_error()
        twin.stop()
        raise UsageError(f"{twin.name} did not start{message}")
    return twin, address or ""


def twin_command(kind: str, section: TwinSection, answer: Path, directory: Path = Path()) -> list[str]:
    """Return the command line that starts a twin; see :func:`start_twin` for the arguments."""
    command = [sys.executable, "-P", "-m", "labhil", "twin", kind]
    command += ["--seed", str(section.seed), "--speed", repr(section.speed), "--wire", section.wire]
    if section.terms is not None:
        command += ["--terms", ",".join(section.terms)]
    for name, number in section.set.items():
        command += ["--set", f"{name}={number!r}"]
    for name, file in section.tables.items():
        command += ["--table", f"{name}={directory / file}"]
    for option, value in (("--host", section.host), ("--series", section.series)):
        command += [] if value is None else [option, value]
    return [*command, "--answer", str(answer)]
