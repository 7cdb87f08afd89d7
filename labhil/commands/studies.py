"""Commands that are studies of their own: the demo, designs, the reference text, benchmarks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.console import STDOUT, deliver, refuse_unwritable, results_console, write_json
from labhil.terminal import status, terminal


def add_studies(app: typer.Typer) -> None:
    """Register these commands."""
    app.command(epilog="Example: labhil demo --seed 7")(demo)
    app.command(epilog="Example: labhil optimise solenoid --plot design.png")(optimise)
    app.command(epilog="Example: labhil reference 5.3 5.5 --quick")(reference)
    app.command(epilog="Example: labhil benchmark dc_motor --recordings 20 -o bench")(benchmark)


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where recordings and plots stay.")] = Path(
        "labhil-demo"
    ),
    seed: Annotated[
        int | None, typer.Option(help="Seed of the concealed physics; default: drawn afresh.")
    ] = None,
) -> None:
    """Do the main job without hardware: record a twin that conceals physics, find it, show the better fit."""
    from labhil.campaign.demo import run_demo

    with status() as say:
        run_demo(out, seed, say)


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
    """Optimise a design: largest force against flattest force curve, front and sensitivities."""
    from labhil.errors import UnknownNameError
    from labhil.optimise.show import show
    from labhil.optimise.study import run

    if what != "solenoid":
        raise UnknownNameError("design", what, ("solenoid",))
    refuse_unwritable(json_path, plot)
    with status() as say:
        study = run(seed, say, field=field)
    deliver(study.to_json(), json_path, lambda: show(study, results_console()))
    if plot is not None:
        from labhil.optimise.plot import plot as draw

        draw(study, plot)


def reference(
    tables: Annotated[list[str] | None, typer.Argument(help="Numbers like 5.3 (default: all).")] = None,
    *,
    quick: Annotated[bool, typer.Option("--quick", help="A twentieth of the swarms' iterations.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of everything that is drawn.")] = 0,
    cache: Annotated[Path, typer.Option(help="Where finished parts are kept.")] = Path("labhil-reference"),
    markdown: Annotated[Path | None, typer.Option(help="Write a page here.")] = None,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
) -> None:
    """Set the tables of the reference text's chapter 5 beside ours, beside the truth and what data can know.

    At full length it takes a while; finished parts are kept, and the same command goes on from there.
    """
    from labhil.campaign.reference import reference_command
    from labhil.campaign.reference.published import NUMBERS

    refuse_unwritable(json_path, markdown)
    to_stdout = json_path == STDOUT
    with status() as say:
        found = reference_command(
            tables or NUMBERS,
            quick=quick,
            seed=seed,
            cache=cache,
            markdown=markdown,
            json_path=None if to_stdout else json_path,
            progress=say,
            console=terminal(stderr=True) if to_stdout else None,
        )
    if to_stdout:
        write_json(found.to_json())


def benchmark(
    cases: Annotated[list[str] | None, typer.Argument(help="Which (default: all).")] = None,
    *,
    recordings: Annotated[int, typer.Option(help="With white noise, and as many with coloured.")] = 150,
    starts: Annotated[
        int | None, typer.Option(help="Instead: fit one recording from so many random starts.")
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="Where results are kept.")] = Path(
        "labhil-benchmark"
    ),
) -> None:
    """Measure the statistics on simulated recordings with known answers: errors, coverage, decisions.

    Every finished recording is kept at once; the same command goes on where it was interrupted.
    """
    from labhil.campaign.benchmark.cases import CASES
    from labhil.campaign.benchmark.run import run_benchmark, run_starts
    from labhil.campaign.benchmark.starts import show as show_starts
    from labhil.campaign.benchmark.summary import show

    names = cases or list(CASES)
    console = results_console()
    if starts is not None:
        with status() as say:
            arrivals = run_starts(names, starts, out, say)
        console.print(*(show_starts(each) for each in arrivals), sep="\n")
        return
    with status() as say:
        summaries = run_benchmark(names, recordings, out, say)
    for summary in summaries:
        console.print(show(summary))
