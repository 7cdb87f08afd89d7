"""The command ``labhil compare``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.commands.analysis import (
    DeviceOption,
    PageOption,
    ResultOption,
    RigOption,
    SimulatorOption,
    rig_or_simulator,
)
from labhil.commands.files import RunOption
from labhil.console import deliver, refuse_unwritable, results_console, tell
from labhil.terminal import status

RECORDING_SUFFIXES = (".mcap", ".part")
"""Suffixes of arguments that are recordings and no results."""


def add_compare(app: typer.Typer) -> None:
    """Register this command."""
    app.command(epilog="Example: labhil compare simple.json full.json --html compare.html")(compare)


def compare(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT...",
            help="Two to eight results (JSON of fit, diagnose or verify), and recordings (.mcap) to compare "
            "them on.",
        ),
    ],
    *,
    recording: Annotated[
        list[Path] | None,
        typer.Option(help="Compare on this; may be repeated (default: the test data of the first)."),
    ] = None,
    rig: RigOption = None,
    simulator: SimulatorOption = None,
    horizon: Annotated[
        float | None,
        typer.Option(help="Length of the simulated windows, s (default: the longest that a model asks for)."),
    ] = None,
    device: DeviceOption = None,
    run: RunOption = None,
    html: PageOption = None,
    json_path: ResultOption = None,
) -> None:
    """Compare models on the same recording: which explains it best, by how much, and how significantly.

    Every model is simulated in the same windows. Of a diagnosis the final model is compared, of a
    verification the verified model. Shared parameters are listed side by side with their intervals.
    """
    from labhil.api.comparison import compare as compare_models

    refuse_unwritable(json_path, html)
    positional = [path for path in results if path.suffix.lower() in RECORDING_SUFFIXES]
    recordings = [*positional, *(recording or [])]
    with status() as progress:
        comparison = compare_models(
            *(path for path in results if path not in positional),
            recording=recordings or None,
            model=rig_or_simulator(rig, simulator),
            horizon=horizon,
            device=device,
            run=run,
            progress=progress,
            warn=tell,
        )
    deliver(comparison.to_dict(), json_path, lambda: comparison.show(results_console()))
    if html is not None:
        comparison.report(html)
