"""The command line of the benchmarks; ``labhil reference`` and its neighbours hand on to it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from labhil.commands.trials import FIRST, METHOD, deliver_card
from labhil.console import STDOUT, refuse_unwritable, results_console, write_json
from labhil.cores import cores
from labhil.terminal import show, status, terminal

app = typer.Typer(
    help="What measures labhil.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
trial = typer.Typer(help="Many sealed trials.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(trial, name="trial")


def run(arguments: Sequence[str]) -> None:
    """Run a command of the benchmarks; ends the process as the commands of labhil do."""
    app(list(arguments), prog_name="labhil")


@app.command(epilog="Example: labhil reference 5.3 5.5 --quick")
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
    from labhil_benchmarks.reference import reference_command
    from labhil_benchmarks.reference.published import NUMBERS

    refuse_unwritable(json_path, markdown)
    to_stdout = json_path == STDOUT
    with status() as say:
        result = reference_command(
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
        write_json(result.to_json())


@app.command(epilog="Example: labhil benchmark dc_motor --recordings 20 -o bench")
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
    from labhil_benchmarks.statistics.cases import CASES
    from labhil_benchmarks.statistics.run import run_benchmark, run_starts
    from labhil_benchmarks.statistics.starts import show as show_starts
    from labhil_benchmarks.statistics.summary import show

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


@trial.command("benchmark", epilog="Example: labhil trial benchmark axis --trials 300 -o axis-trials")
def trial_benchmark(
    rig: Annotated[str, typer.Argument(help="A kind of rig: ball_beam, dc_motor, axis, solenoid or ur5.")],
    *,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Where everything goes.")],
    trials: Annotated[int, typer.Option(help="How many nulls, and how many trials with effects.")] = 300,
    seed: Annotated[
        int | None, typer.Option(help="For tests: the same trials again; default: the system's randomness.")
    ] = None,
    first: Annotated[int, typer.Option(help=FIRST)] = 1,
    method: Annotated[str, typer.Option(help=METHOD)] = "diagnose",
    effects: Annotated[str, typer.Option(help="Sort of trials with effects: some, 1, hidden, bristles …")] = (
        "some"
    ),
    disturbed: Annotated[
        str | None, typer.Option(help="force: a random force at the drive beside all; drift: of its gain.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes (default: one a core).")] = None,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
    plot_path: Annotated[Path | None, typer.Option("--plot", help="Draw the result here (PNG).")] = None,
) -> None:
    """Make, diagnose and score as many nulls as trials with effects; goes on where it was interrupted."""
    from labhil_benchmarks.trials.benchmark import Plan, run_trial_benchmark

    refuse_unwritable(json_path, plot_path)
    with status() as say:
        plan = Plan(rig, trials, out, seed, method, jobs or cores(), first, effects, disturbed)
        card = run_trial_benchmark(plan, say)
    deliver_card(card, json_path, plot_path)


@trial.command("compare", epilog="Example: labhil trial compare axis.json dc_motor.json")
def trial_compare(
    cards: Annotated[list[Path], typer.Argument(metavar="FILE...", help="JSON of score or benchmark.")],
) -> None:
    """Print score cards side by side, as a Markdown table."""
    from labhil_benchmarks.trials.compare import compare_cards

    show(compare_cards(cards))


@trial.command("calibrate", epilog="Example: labhil trial calibrate axis-trials/effects")
def trial_calibrate(
    folders: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Folders of trials, run, with DIR-answers beside.")
    ],
) -> None:
    """Fit how probable a claim is to trials whose answers are open: the weights of a stated probability.

    Probabilities that were fitted to trials are to be scored on others.
    """
    from labhil.diagnose.claim_probability import WEIGHTS
    from labhil_benchmarks.trials.calibrate import calibrate, claimed_in

    fitted = calibrate([claim for folder in folders for claim in claimed_in(folder)])
    show(f"{fitted.claims} claims, {fitted.right} of them right")
    names = ("a single claim", "each further claim")
    for name, weight, error, used in zip(names, fitted.weights, fitted.errors, WEIGHTS, strict=True):
        show(f"{name:20} {weight:7.2f} ± {error:.2f}   in use: {used:.2f}")
