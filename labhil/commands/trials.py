"""Commands of sealed trials."""

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

FIRST = "Number of the first: of a seed whose earlier trials you have looked at."
METHOD = "diagnose, or stepwise: forward steps by the extended BIC, to compare with."


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
    trials: Annotated[int, typer.Option(help="How many.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Where the recordings go.")],
    answers: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where the answers go (default: DIR-answers).")
    ] = None,
    effects: Annotated[
        str, typer.Option(help="0, 1, 2 or 3 concealed effects, hidden, some, or mixed.")
    ] = "mixed",
    seed: Annotated[
        int | None, typer.Option(help="For tests: the same trials again; default: the system's randomness.")
    ] = None,
    first: Annotated[int, typer.Option(help=FIRST)] = 1,
    seconds: Annotated[
        float | None, typer.Option(help="How long each recording is (default: 2 to 30, by the rig).")
    ] = None,
    disturbed: Annotated[
        str | None, typer.Option(help="force: a random force at the drive beside all; drift: of its gain.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes (default: one a core).")] = None,
) -> None:
    """Draw rigs with concealed physics and record them; the answers are sealed in a folder elsewhere.

    "hidden" draws an effect that stands in no list of names, "some" any sort with effects, "mixed" any sort
    with nulls among them.
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
    with status() as say:
        index = make_trials(options, jobs or cores(), say)
    if index.fixed_seed:
        show(f"Drawn from the fixed seed {seed}: good for tests, no secret to anyone who knows it.")
    show(f"{len(index.trials)} trials of {rig} in {options.out}, answers in {options.answers}")


def trial_run(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of `labhil trial make`.")],
    *,
    jobs: Annotated[int | None, typer.Option(help="Processes (default: one a core).")] = None,
    method: Annotated[str, typer.Option(help=METHOD)] = "diagnose",
) -> None:
    """Diagnose all trials blind; every result is kept at once and hashed.

    The diagnoses run in processes that are given DIR alone and cannot open an envelope, wherever it lies.
    The same command goes on where it was interrupted. A diagnosis that fails is recorded as a failure.
    """
    from labhil.campaign.trials.folder import Results
    from labhil.campaign.trials.run import run_trials

    with status() as say:
        sealed = run_trials(folder, jobs or cores(), say, method)
    results = Results(folder, method)
    show(f"Results in {folder / results.name}; SHA-256 of their hashes ({results.hashes}): {sealed}")


def trial_score(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of `labhil trial make`, run.")],
    answers: Annotated[Path, typer.Argument(metavar="ANSWERS", help="The folder of its answers.")],
    *,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
    plot_path: Annotated[Path | None, typer.Option("--plot", help="Draw the result here (PNG).")] = None,
    method: Annotated[str, typer.Option(help=METHOD)] = "diagnose",
    jobs: Annotated[int | None, typer.Option(help="Processes (default: one a core).")] = None,
) -> None:
    """Open the envelopes and score what was said: detection, naming, false alarms, reliability, errors.

    Results, recordings or answers that are not the ones that were hashed are refused.
    """
    from labhil.campaign.trials.score import score_trials

    refuse_unwritable(json_path, plot_path)
    with status() as say:
        card = score_trials(folder, answers, say, method, jobs or cores())
    deliver_card(card, json_path, plot_path)


def deliver_card(card: ScoreCard, json_path: Path | None, plot_path: Path | None) -> None:
    """Print a score card, and write and draw it where that was asked for."""
    from labhil.campaign.trials.show import show

    deliver(card.to_json(), json_path, lambda: show(card, results_console()))
    if plot_path is not None:
        from labhil.campaign.trials.plot import plot

        plot(card, plot_path)
