"""The command ``labhil tui``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.extras import require


def add_tui(app: typer.Typer) -> None:
    """Register this command."""
    app.command(epilog="Example: labhil tui --folder recordings")(tui)


def tui(
    folder: Annotated[Path, typer.Option(metavar="DIR", help="Folder of recordings and results.")] = Path(),
    connect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENDPOINT",
            help="A bus to watch, tcp/HOST:PORT, or a folder of `labhil security add`; may be repeated.",
        ),
    ] = None,
    light: Annotated[bool, typer.Option("--light", help="Dark on light, for bright rooms.")] = False,
    web: Annotated[bool, typer.Option("--web", help="Show it in a browser, at the printed address.")] = False,
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="With --web: beyond the loopback a token is needed.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="With --web: the port; 0 for a free one.")
    ] = 8000,
) -> None:
    """Work in the terminal: devices, live plots, experiments, recordings, fits and diagnoses.

    Shows the devices of every run on this machine. Without devices, 3 and then Enter run the example on a
    simulated bench. With --web each page in a browser is such a screen, until Ctrl+C here.
    """
    if web:
        require("textual_serve", "the terminal UI in a browser")
        from labhil.tui.web import serve_web

        raise typer.Exit(serve_web(folder, connect or (), light=light, host=host, port=port))
    from labhil.tui.main import run_tui

    raise typer.Exit(run_tui(folder, connect or (), light=light))
