"""The terminal UI."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def add_tui(app: typer.Typer) -> None:
    """Register this command."""
    app.command(epilog="Example: labhil tui --folder recordings")(tui)


def tui(
    folder: Annotated[Path, typer.Option(metavar="DIR", help="Where recordings and results are.")] = Path(),
    connect: Annotated[
        list[str] | None,
        typer.Option(metavar="ENDPOINT", help="A bus to watch, tcp/HOST:PORT; may be repeated."),
    ] = None,
    light: Annotated[bool, typer.Option("--light", help="Dark on light, for bright rooms.")] = False,
) -> None:
    """Work in the terminal: devices, live plots, experiments, recordings, fits and diagnoses.

    Shows the devices of every run on this machine, and needs none to be useful: 3 and then Enter run the
    example on a simulated bench.
    """
    from labhil.tui.main import run_tui

    raise typer.Exit(run_tui(folder, connect or (), light=light))
