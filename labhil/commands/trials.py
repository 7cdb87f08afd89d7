"""Commands of sealed trials: ``labhil trial``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labhil.commands.benchmarks import add_trial_benchmarks
from labhil.console import deliver, refuse_unwritable, results_console
from labhil.cores import cores
from labhil.terminal import show, status

if TYPE_CHECKING:
    from labhil.campaign.trials.card import ScoreCard

FIRST = "Number of the first trial, where earlier trials of the seed are known already."
METHOD = (
    "diagnose, stepwise (forward selection by the extended BIC, for comparison), or a diagnosis with your "
    "own simulator of the rig: bench.py:cart, cart.xml, cart.fmu."
)


def add_trials(app: typer.Typer) -> None:
    """Register these commands."""
    trial = typer.Typer(
        help="Sealed trials: rigs with concealed physics, diagnosed blind, scored against sealed answers.",
        no_args_is_help=True,
        rich_markup_mode=None,
    )
    trial.command("make", epilog="Example: labhil trial make --rig ball_beam --trials 20 -o trials")(
        trial_make
    )
    trial.command("run", epilog="Example: labhil trial run trials --jobs 2")(trial_run)
    trial.command("score", epilog="Example: labhil trial score trials trials-answers --json score.json")(
        trial_score
    )
    add_trial_benchmarks(trial)
    app.add_typer(trial, name="trial")


def trial_make(
    *,
    rig: Annotated[str, typer.Option(help="A kind of rig: ball_beam, dc_motor, axis, solenoid or ur5.")],
    trials: Annotated[int, typer.Option(help="Number of trials.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Where the recordings go.")],
    answers: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where the answers go (default: DIR-answers).")
    ] = None,
    effects: Annotated[
        str, typer.Option(help="0, 1, 2 or 3 concealed effects, hidden, some, or mixed.")
    ] = "mixed",
    seed: Annotated[int | None, typer.Option(help="Seed, for reproducible tests; default: random.")] = None,
    first: Annotated[int, typer.Option(help=FIRST)] = 1,
    seconds: Annotated[
        float | None, typer.Option(help="Length of each recording, s (default: 2 to 30, by the rig).")
    ] = None,
    disturbed: Annotated[
        str | None,
        typer.Option(help="Disturbance: force (a random force at the drive) or drift (of its gain)."),
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes (default: one per core).")] = None,
) -> None:
    """Draw rigs with concealed physics and record them; the answers are sealed in a folder elsewhere.

    "hidden" draws an effect that is in no catalogue, "some" any sort with effects, "mixed" any sort, also
    without effects.
    """
    from labhil.campaign.trials.make import TrialSetOptions, answers_beside, make_trials

    options = TrialSetOptions(
        rig,
        trials,
        effects,
        out,
        answers or answers_beside(out),
        seed,
        first=first,
        seconds=seconds,
        disturbed=disturbed,
    )
    with status() as progress:
        index = make_trials(options, jobs or cores(), progress)
    if index.fixed_seed:
        show(f"Drawn from the fixed seed {seed}: for tests only, since whoever knows it knows the answers.")
    show(f"{len(index.trials)} trials of {rig} in {options.out}, answers in {options.answers}")


def trial_run(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of `labhil trial make`.")],
    *,
    jobs: Annotated[int | None, typer.Option(help="Processes (default: one per core).")] = None,
    method: Annotated[str, typer.Option(help=METHOD)] = "diagnose",
) -> None:
    """Diagnose all trials blind; every result is saved and hashed at once.

    The diagnoses run in processes that know only DIR and cannot open an answer, wherever it is. The same
    command continues where it was interrupted. A diagnosis that fails is recorded as a failure.
    """
    from labhil.campaign.trials.folder import Results
    from labhil.campaign.trials.run import run_trials

    with status() as progress:
        sealed = run_trials(folder, jobs or cores(), progress, method)
    results = Results(folder, method)
    show(f"Results in {folder / results.name}; SHA-256 of their hashes ({results.hashes}): {sealed}")


def trial_score(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of `labhil trial make`, run.")],
    answers: Annotated[Path, typer.Argument(metavar="ANSWERS", help="The folder of its answers.")],
    *,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
    plot_path: Annotated[Path | None, typer.Option("--plot", help="Draw the result here (PNG).")] = None,
    method: Annotated[str, typer.Option(help=METHOD)] = "diagnose",
    jobs: Annotated[int | None, typer.Option(help="Processes (default: one per core).")] = None,
) -> None:
    """Open the answers and score the diagnoses: detection, naming, false alarms, reliability, errors.

    Results, recordings or answers that differ from their hashes are refused.
    """
    from labhil.campaign.trials.score import score_trials

    refuse_unwritable(json_path, plot_path)
    with status() as progress:
        card = score_trials(folder, answers, progress, method, jobs or cores())
    deliver_card(card, json_path, plot_path)


def deliver_card(card: ScoreCard, json_path: Path | None, plot_path: Path | None) -> None:
    """Print a score card, and write and draw it where a path is given."""
    from labhil.campaign.trials.show import show

    deliver(card.to_json(), json_path, lambda: show(card, results_console()))
    if plot_path is not None:
        from labhil.campaign.trials.plot import plot

        plot(card, plot_path)
