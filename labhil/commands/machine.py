"""Commands on the machine itself."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.commands.json_flag import JsonFlagCommand
from labhil.console import write_json
from labhil.terminal import show


def add_machine(app: typer.Typer) -> None:
    """Register these commands."""
    app.command(cls=JsonFlagCommand, epilog="Example: labhil doctor --json")(doctor)


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where recordings would go.")] = Path(),
) -> None:
    """Say whether this machine can do the work: packages, compiler, bus, serial ports, timer, disk.

    Ends with 1 when something will not work; each finding says what to do.
    """
    from labhil.doctor.examine import examine, line, to_json

    findings = []
    for finding in examine(out):
        findings.append(finding)
        if not as_json:
            show(line(finding))
    told = to_json(findings)
    if as_json:
        write_json(told)
    if not told["fine"]:
        raise typer.Exit(1)
