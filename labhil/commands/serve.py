"""The command ``labhil serve``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.console import tell


def add_serve(app: typer.Typer) -> None:
    """Register this command."""
    app.command(epilog="Example: labhil serve --config lab.toml --folder recordings")(serve)


def serve(
    config: Annotated[
        Path | None, typer.Option(help="A lab file (TOML); default: a simulated ball and beam.")
    ] = None,
    *,
    folder: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where recordings go (default: the folder in the lab file)."),
    ] = None,
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Join an existing bus (loopback).")
    ] = None,
) -> None:
    """Keep the devices of a lab connected, published and recorded, and analyse each finished recording.

    The first line of its output is the bus's endpoint (for `labhil tui --connect`, `labhil estop --connect`).
    Ctrl+C brings every device to its safe state and leaves readable recordings. Recordings that `labhil run`
    leaves in the same folder are analysed too; a lab file without devices does only that.
    """
    from labhil.campaign.lab import serve_lab

    raise typer.Exit(serve_lab(config, folder, connect, lambda line: tell([line])))
