"""Commands of sealed trials."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labhil.console import deliver, refuse_unwritable, results_console
from labhil.cores import cores
from labhil.terminal import show, status

if TYPE_CHECKING:
    from labhil.campaign.trials.card import Card

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
    trial.command("benchmark", epilog="Example: labhil trial benchmark axis --trials 300 -o axis-trials")(
        trial_benchmark
    )
    trial.command("compare", epilog="Example: labhil trial compare axis.json dc_motor.json")(trial_compare)
    trial.command("calibrate", epilog="Example: labhil trial calibrate axis-trials/effects")(trial_calibrate)
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
    jobs: Annotated[int | None, typer.Option(help="Processes (default: one a core).")] = None,
) -> None:
    """Draw rigs with concealed physics and record them; the answers are sealed in a folder elsewhere.

    "hidden" draws an effect that stands in no list of names, "some" any sort with effects, "mixed" any sort
    with nulls among them.
    """
    from labhil.campaign.trials.make import Order, answers_beside, make_trials

    order = Order(
        rig, trials, effects, out, answers or answers_beside(out), seed, first=first, seconds=seconds
    )
    with status() as say:
        index = make_trials(order, jobs or cores(), say)
    if index.fixed_seed:
        show(f"Drawn from the fixed seed {seed}: good for tests, no secret to anyone who knows it.")
    show(f"{len(index.trials)} trials of {rig} in {order.out}, answers in {order.answers}")


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
    _tell(card, json_path, plot_path)


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
    jobs: Annotated[int | None, typer.Option(help="Processes (default: one a core).")] = None,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
    plot_path: Annotated[Path | None, typer.Option("--plot", help="Draw the result here (PNG).")] = None,
) -> None:
    """Make, diagnose and score as many nulls as trials with effects; goes on where it was interrupted."""
    from labhil.campaign.trials.benchmark import Plan, run_trial_benchmark

    refuse_unwritable(json_path, plot_path)
    with status() as say:
        plan = Plan(rig, trials, out, seed, method, jobs or cores(), first)
        card = run_trial_benchmark(plan, say)
    _tell(card, json_path, plot_path)


def trial_compare(
    cards: Annotated[list[Path], typer.Argument(metavar="FILE...", help="JSON of score or benchmark.")],
) -> None:
    """Print score cards side by side, as a Markdown table."""
    from labhil.campaign.trials.compare import compared

    show(compared(cards))


def trial_calibrate(
    folders: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Folders of trials, run, with DIR-answers beside.")
    ],
) -> None:
    """Fit how probable a claim is to trials whose answers are open: the weights of a stated probability.

    Probabilities that were fitted to trials are to be scored on others.
    """
    from labhil.campaign.trials.calibrate import calibrated, claimed_in
    from labhil.diagnose.credence import WEIGHTS

    fitted = calibrated([claim for folder in folders for claim in claimed_in(folder)])
    show(f"{fitted.claims} claims, {fitted.right} of them right")
    names = ("a single claim, ΔBIC −100, nothing left", "ln (what is left)", "each further claim", "lg ΔBIC")
    for name, weight, error, used in zip(names, fitted.weights, fitted.errors, WEIGHTS, strict=True):
        show(f"{name:42} {weight:7.2f} ± {error:.2f}   in use: {used:.2f}")


def _tell(card: Card, json_path: Path | None, plot_path: Path | None) -> None:
    """Print a score card, and write and draw it where that was asked for."""
    from labhil.campaign.trials.show import show

    deliver(card.to_json(), json_path, lambda: show(card, results_console()))
    if plot_path is not None:
        from labhil.campaign.trials.plot import plot

        plot(card, plot_path)
