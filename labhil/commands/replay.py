"""The command ``labhil replay``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labhil.commands.files import RunOption
from labhil.console import tell
from labhil.errors import BusError
from labhil.terminal import show

if TYPE_CHECKING:
    from labhil.service.replay import Replay


def add_replay(app: typer.Typer) -> None:
    """Register this command."""
    app.command(epilog="Example: labhil replay run.mcap --speed 2")(replay)


def replay(
    recording: Annotated[Path, typer.Argument(help="A recording (.mcap), also an unfinished .part.")],
    *,
    speed: Annotated[
        float,
        typer.Option(metavar="FACTOR", help="How many times as fast as it was recorded, 0.01 to 100."),
    ] = 1.0,
    start: Annotated[
        float,
        typer.Option(
            "--from", metavar="SECONDS", help="Begin here, in the time that `labhil info` and plots show."
        ),
    ] = 0.0,
    loop: Annotated[bool, typer.Option("--loop", help="Start again at the end.")] = False,
    no_screen: Annotated[
        bool,
        typer.Option(
            "--no-screen", help="Only on the bus: print its endpoint, and exit at the end of the recording."
        ),
    ] = False,
    device: Annotated[str | None, typer.Option(help="Only this device.")] = None,
    run: RunOption = None,
    light: Annotated[bool, typer.Option("--light", help="Dark on light, for bright rooms.")] = False,
) -> None:
    """Play a recording in the terminal UI and on the bus, as if its devices ran.

    Only on the bus of this machine, under replay/ and not under lab/: no recorder, controller or emergency
    stop receives it. In the terminal UI (tab 2) p pauses, < and > change the speed, j goes back.
    """
    from labhil.recording.reader import read_recording
    from labhil.service.replay import Replay

    source = read_recording(recording, run).of_device(device)
    tell(source.warnings())
    with Replay(source, speed=speed, start=start, loop=loop) as playing:
        if no_screen or not sys.stdout.isatty():
            _play(playing)
            return
        from labhil.tui.main import run_tui

        raise typer.Exit(run_tui(recording.parent, (), light=light, tab="live"))


def _play(playing: Replay) -> None:
    """Wait for the end of the replay, or for Ctrl+C."""
    from labhil.experiment.interruption import Interruption

    show(playing.endpoint)
    with Interruption() as interrupted:
        while not interrupted() and not playing.wait(0.1):
            continue
    if playing.fault:
        raise BusError(playing.fault)
    if playing.overflows:
        tell([f"{playing.overflows} samples were dropped: the bus could not take so many; lower --speed"])
