"""The commands ``labhil demo`` and ``labhil optimise``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.console import deliver, refuse_unwritable, results_console
from labhil.terminal import status


def add_studies(app: typer.Typer) -> None:
    """Register these commands."""
    app.command(epilog="Example: labhil demo --seed 7")(demo)
    app.command(epilog="Example: labhil optimise solenoid --plot design.png")(optimise)


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of recordings and plots.")] = Path(
        "labhil-demo"
    ),
    seed: Annotated[
        int | None, typer.Option(help="Seed of the concealed physics; default: drawn afresh.")
    ] = None,
) -> None:
    """Diagnose a simulated rig: record a twin with concealed physics, find it, and show the better fit."""
    from labhil.campaign.demo import run_demo

    with status() as progress:
        run_demo(out, seed, progress)


def optimise(
    what: Annotated[str, typer.Argument(help="solenoid: the geometry of a solenoid (Appendix A).")],
    *,
    seed: Annotated[int, typer.Option(help="Seed of the swarms.")] = 0,
    field: Annotated[
        bool, typer.Option("--field", help="Check a few points by a field solver (labhil[field]).")
    ] = False,
    plot: Annotated[Path | None, typer.Option(help="Draw it here (PNG).")] = None,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
) -> None:
    """Optimise a design: Pareto front of largest force and flattest force curve, with sensitivities."""
    from labhil.errors import UnknownNameError
    from labhil.optimise.show import show
    from labhil.optimise.study import run

    if what != "solenoid":
        raise UnknownNameError("design", what, ("solenoid",))
    refuse_unwritable(json_path, plot)
    with status() as progress:
        study = run(seed, progress, field=field)
    deliver(study.to_json(), json_path, lambda: show(study, results_console()))
    if plot is not None:
        from labhil.optimise.plot import plot as draw

        draw(study, plot)
