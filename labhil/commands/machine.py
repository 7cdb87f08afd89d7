"""The command ``labhil doctor``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.commands.json_flag import JsonFlagCommand, JsonOption
from labhil.console import STDOUT, write_json
from labhil.terminal import show


def add_machine(app: typer.Typer) -> None:
    """Register these commands."""
    app.command(cls=JsonFlagCommand, epilog="Example: labhil doctor --json")(doctor)


def doctor(
    json_path: JsonOption = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where recordings would go.")] = Path(),
) -> None:
    """Check this machine: packages, compiler, bus, serial ports, timer, disk.

    The exit status is 1 when something will not work; each finding names the remedy.
    """
    from labhil.doctor.examine import examine, format_finding, to_json

    findings = []
    for finding in examine(out):
        findings.append(finding)
        if json_path != STDOUT:
            show(format_finding(finding))
    report = to_json(findings)
    if json_path is not None:
        write_json(report, json_path)
    if not report["fine"]:
        raise typer.Exit(1)
