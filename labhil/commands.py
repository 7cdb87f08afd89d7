"""Commands that are studies of their own: pages, a gate, baselines, benchmarks, designs, the text."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from labhil.console import refuse_unwritable, results_console, split_names, status, tell, write_json


def add_studies(app: typer.Typer) -> None:
    """Register these commands."""
    app.command(epilog="Example: labhil report diagnosis.json -o diagnosis.html")(report)
    app.command(epilog="Example: labhil verify run.mcap --model fit.json --json verified.json")(verify)
    app.command(epilog="Example: labhil linear run.mcap --test test.mcap --models arx,oe")(linear)
    app.command(epilog="Example: labhil optimise solenoid --plot design.png")(optimise)
    app.command(epilog="Example: labhil reference 5.3 5.5 --quick")(reference)
    app.command(epilog="Example: labhil benchmark dc_motor --recordings 20 -o bench")(benchmark)
    app.add_typer(_trial_commands(), name="trial")


def _trial_commands() -> typer.Typer:
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
    return trial


def report(
    result: Annotated[
        Path,
        typer.Argument(metavar="OUT.json|REC.mcap", help="The JSON of a fit or diagnosis, or a recording."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The page to write (.html).")],
) -> None:
    """Make one HTML page of a result or of a recording: complete in itself, to be read, printed or sent."""
    from labhil.report.html.page import write_page
    from labhil.report.html.report import report_page

    refuse_unwritable(out)
    write_page(report_page(result), out)
    print(out)


def verify(
    recording: Annotated[Path, typer.Argument(help="A recording (.mcap).")],
    *,
    model: Annotated[Path, typer.Option(help="The accepted model: a fit or a diagnosis (JSON).")],
    rig: Annotated[Path | None, typer.Option(help="Rig file; default: the recording's own.")] = None,
    alpha: Annotated[
        float, typer.Option(help="Probability that a recording of the model itself is refused.")
    ] = 1e-3,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
) -> None:
    """Hold a recording against an accepted model: ends with 1 when it contradicts the model, else with 0.

    Tests the windowed simulation with the values as they are, whether the refitted model leaves residuals
    that go with the input, and whether refitted values differ from the accepted ones.
    """
    from labhil.report.verification import show_verification, verify_study

    refuse_unwritable(json_path)
    with status() as say:
        result = verify_study(recording, model, rig, alpha=alpha, progress=say)
    tell(result.losses)
    show_verification(result.verification, results_console())
    if json_path is not None:
        write_json(result.json, json_path)
    if not result.verification.consistent:
        raise typer.Exit(1)


def linear(
    recording: Annotated[Path, typer.Argument(help="A recording (.mcap).")],
    *,
    rig: Annotated[Path | None, typer.Option(help="Rig file; default: the recording's own.")] = None,
    models: Annotated[str | None, typer.Option(help="Which: a,b,… (default: all).")] = None,
    test: Annotated[Path | None, typer.Option(help="A separate recording to judge on.")] = None,
    holdout: Annotated[float, typer.Option(help="Share held out at the end; not used with --test.")] = 0.3,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
) -> None:
    """Fit linear and black-box baselines, to see what physics is worth: ARX, OE, state space, NARX, …"""
    from labhil.identify.linear import linear_study, study_json, study_text
    from labhil.report.material import load_material

    refuse_unwritable(json_path)
    material = load_material(recording, rig, test, holdout)
    tell(material.losses())
    with status() as say:
        rows = linear_study(material.learn, material.judge, split_names(models), progress=say)
    for line in study_text(rows):
        print(line)
    if json_path is not None:
        write_json({"schema": "labhil.linear/1", "models": study_json(rows)}, json_path)


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
    show(study, results_console())
    if json_path is not None:
        write_json(study.to_json(), json_path)
    if plot is not None:
        from labhil.optimise.plot import plot as draw

        draw(study, plot)


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
    with status() as say:
        reference_command(
            tables or NUMBERS,
            quick=quick,
            seed=seed,
            cache=cache,
            markdown=markdown,
            json_path=json_path,
            progress=say,
        )


def trial_make(
    *,
    rig: Annotated[str, typer.Option(help="A kind of rig: ball_beam, dc_motor, axis or solenoid.")],
    trials: Annotated[int, typer.Option(help="How many.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Where the recordings go.")],
    answers: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where the answers go (default: DIR-answers).")
    ] = None,
    effects: Annotated[str, typer.Option(help="0, 1, 2 or 3 concealed effects, hidden, or mixed.")] = "mixed",
    seed: Annotated[
        int | None, typer.Option(help="For tests: the same trials again; default: the system's randomness.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes (default: one a core).")] = None,
) -> None:
    """Draw rigs with concealed physics and record them; the answers are sealed in a folder elsewhere.

    "hidden" draws an effect that stands in no list of names, "mixed" any sort, with nulls among them.
    """
    from labhil.campaign.trials.make import Order, answers_beside, make_trials

    order = Order(rig, trials, effects, out, answers or answers_beside(out), seed)
    with status() as say:
        index = make_trials(order, jobs or _cores(), say)
    if index.fixed_seed:
        print(f"Drawn from the fixed seed {seed}: good for tests, no secret to anyone who knows it.")
    print(f"{len(index.trials)} trials of {rig} in {order.out}, answers in {order.answers}")


def trial_run(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of `labhil trial make`.")],
    *,
    jobs: Annotated[int | None, typer.Option(help="Processes (default: one a core).")] = None,
) -> None:
    """Diagnose all trials blind; every result is kept at once and hashed.

    The diagnoses run in processes that are given DIR alone and cannot open an envelope, wherever it lies.
    The same command goes on where it was interrupted. A diagnosis that fails is recorded as a failure.
    """
    from labhil.campaign.trials.run import run_trials

    with status() as say:
        sealed = run_trials(folder, jobs or _cores(), say)
    print(f"Results in {folder / 'results'}; SHA-256 of their hashes ({folder / 'results.sha256'}): {sealed}")


def trial_score(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of `labhil trial make`, run.")],
    answers: Annotated[Path, typer.Argument(metavar="ANSWERS", help="The folder of its answers.")],
    *,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
) -> None:
    """Open the envelopes and score what was said: detection, naming, false alarms, reliability, errors.

    Results, recordings or answers that are not the ones that were hashed are refused.
    """
    from labhil.campaign.trials.score import score_trials
    from labhil.campaign.trials.show import show

    refuse_unwritable(json_path)
    with status() as say:
        card = score_trials(folder, answers, say)
    show(card, results_console())
    if json_path is not None:
        write_json(card.to_json(), json_path)


def _cores() -> int:
    return os.cpu_count() or 1
