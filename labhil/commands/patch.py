"""The command ``labhil patch``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.commands.json_flag import JsonFlagCommand, JsonOption
from labhil.console import deliver, refuse_unwritable
from labhil.terminal import show, status


def add_patch(app: typer.Typer) -> None:
    """Register this command."""
    app.command(
        cls=JsonFlagCommand,
        epilog="Example: labhil patch diagnosis.json --into arm.xml -o arm_fixed.xml --rig rig.toml",
    )(patch)


def patch(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT.json", help="The JSON of a diagnosis or a fit of that file.")
    ],
    *,
    into: Annotated[
        Path, typer.Option(help="The MJCF, URDF, FMU or Python file (bench.py:pendulum) that was diagnosed.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The new file; nothing is overwritten.")],
    rig: Annotated[Path | None, typer.Option(help="The rig file of the diagnosis, where it had one.")] = None,
    holdout: Annotated[float, typer.Option(help="Share that the diagnosis held out at the end.")] = 0.3,
    json_path: JsonOption = None,
) -> None:
    """Write a copy of a simulator's file with the values and terms of a result, and show the difference.

    The file is one of MuJoCo, an FMU, or Python with labhil.simulator. The new file is loaded and run on
    the held-out data, and is not written where its error is more than 1.05 times that of the diagnosed
    model. Terms that the format cannot express go into a Python file beside it.
    """
    from labhil.analysis.patching import patch as patch_file
    from labhil.extras import require_analysis

    require_analysis("a patch")
    refuse_unwritable(json_path)
    with status() as progress:
        patched = patch_file(result, into, out, rig, holdout=holdout, progress=progress)
    deliver(patched.to_dict(), json_path, lambda: show(str(patched)))
