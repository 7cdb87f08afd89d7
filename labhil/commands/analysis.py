"""Commands of analysis: ``labhil terms``, ``fit``, ``diagnose``, ``verify``, ``report`` and ``linear``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labhil.commands.files import RunOption
from labhil.commands.json_flag import JsonFlagCommand, JsonOption
from labhil.console import (
    STDOUT,
    deliver,
    refuse_unwritable,
    results_console,
    split_names,
    tell,
)
from labhil.errors import OptionError
from labhil.terminal import show, status

if TYPE_CHECKING:
    from labhil.api.diagnosis import Diagnosis
    from labhil.api.fit import Fit

RecordingsArgument = Annotated[
    list[Path],
    typer.Argument(metavar="RECORDING...", help="A recording (.mcap), or several of the same rig."),
]
PerRecordingOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        help="Terms, parameters or sizes of the rig with a separate value in each recording: a,b,…",
    ),
]
DeviceOption = Annotated[
    str | None, typer.Option(metavar="NAME", help="Which device, where a recording holds several.")
]
SpanOption = Annotated[
    tuple[float, float] | None,
    typer.Option(metavar="FROM TO", help="Use only this span of every recording, s."),
]
MaxSamplesOption = Annotated[
    int,
    typer.Option(
        metavar="N", help="Use so many samples of every recording, where its inputs change most (arms: all)."
    ),
]
SimulatorOption = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="Your simulator instead: arm.xml (MuJoCo), x.fmu, bench.py:pendulum."),
]
TestOption = Annotated[
    list[Path] | None, typer.Option(help="A separate recording to judge on; may be repeated.")
]
RigOption = Annotated[Path | None, typer.Option(help="Rig file; default: the recording's own.")]
EstimatorOption = Annotated[
    str,
    typer.Option(
        help="First stage: hybrid, nlse, pso, pso_adaptive, pso_de, differential_evolution, "
        "simulated_annealing, cma_es or mcmc; all end with least squares."
    ),
]
WindowOption = Annotated[
    float | None, typer.Option(help="Length of the fitted windows, s (default: several, compared).")
]
CriterionOption = Annotated[
    str | None,
    typer.Option(
        help="Criterion of the fit: windowed_simulation or, for an axis, also inverse_dynamics "
        "(default: the rig's own metric, which scores either)."
    ),
]
PageOption = Annotated[Path | None, typer.Option(help="Write a page about it here (HTML).")]
ResultOption = Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")]


def rig_or_simulator(rig: Path | None, simulator: str | None) -> Path | str | None:
    """Return the one of the two that is given.

    Raises:
        OptionError: Both are given.
    """
    if rig is not None and simulator is not None:
        raise OptionError("simulator", ": expected it or --rig, found both; a rig file names it as [model]")
    return simulator or rig


def add_analysis(app: typer.Typer) -> None:
    """Register these commands."""
    app.command(cls=JsonFlagCommand, epilog="Example: labhil terms ball_beam")(terms)
    app.command(
        epilog="Example: labhil fit run.mcap --terms viscous_friction,coulomb_friction --json fit.json"
    )(fit)
    app.command(
        epilog="Example: labhil diagnose run.mcap --test test.mcap --baseline viscous_friction --plot d.png"
    )(diagnose)
    app.command(epilog="Example: labhil verify run.mcap --model fit.json --json verified.json")(verify)
    app.command(epilog="Example: labhil report diagnosis.json -o diagnosis.html")(report)
    app.command(epilog="Example: labhil linear run.mcap --test test.mcap --models arx,oe")(linear)


def terms(
    rig: Annotated[str | None, typer.Argument(help="A rig kind; all when absent.")] = None,
    json_path: JsonOption = None,
) -> None:
    """List the terms that a rig's model may have, with equation, parameters, units and source."""
    from labhil.report.catalogue import catalogue_json, show_catalogue

    refuse_unwritable(json_path)
    deliver(catalogue_json(rig), json_path, lambda: show_catalogue(rig))


def fit(
    recordings: RecordingsArgument,
    *,
    rig: RigOption = None,
    simulator: SimulatorOption = None,
    model: Annotated[Path | None, typer.Option(help="A fit or diagnosis to start from (JSON).")] = None,
    estimator: EstimatorOption = "hybrid",
    seed: Annotated[int, typer.Option(help="Seed of the estimator's draws.")] = 0,
    names: Annotated[
        str | None, typer.Option("--terms", help="Terms of the model: a,b,… (default: the general model).")
    ] = None,
    per_recording: PerRecordingOption = None,
    test: TestOption = None,
    holdout: Annotated[
        float, typer.Option(help="Share held out at the end, 0 for nothing; not used with --test.")
    ] = 0.3,
    span: SpanOption = None,
    max_samples: MaxSamplesOption = 100_000,
    device: DeviceOption = None,
    run: RunOption = None,
    window: WindowOption = None,
    intervals: Annotated[str, typer.Option(help="auto, wald, profile (slower) or bootstrap.")] = "auto",
    criterion: CriterionOption = None,
    simultaneous: Annotated[
        bool, typer.Option("--simultaneous", help="Intervals that hold for all parameters together.")
    ] = False,
    plot: Annotated[Path | None, typer.Option(help="Draw fit and residuals here (PNG).")] = None,
    html: PageOption = None,
    json_path: ResultOption = None,
) -> None:
    """Fit a white-box model to a recording, with confidence intervals, and test it on data it has not seen.

    Several recordings of a rig are fitted together: they share all values but those of --per-recording.
    """
    from labhil.api.fit import fit as fit_recordings

    refuse_unwritable(json_path, plot, html)
    with status() as progress:
        result = fit_recordings(
            recordings,
            rig_or_simulator(rig, simulator),
            terms=names,
            test=test or None,
            holdout=holdout,
            start=model,
            per_recording=per_recording,
            span=span,
            max_samples=max_samples,
            estimator=estimator,
            seed=seed,
            window=window,
            intervals=intervals,
            simultaneous=simultaneous,
            criterion=criterion,
            device=device,
            run=run,
            progress=progress,
            warn=tell,
        )
    _deliver(result, json_path, plot, html)


def diagnose(
    recordings: RecordingsArgument,
    *,
    rig: RigOption = None,
    simulator: SimulatorOption = None,
    model: Annotated[Path | None, typer.Option(help="A fit or diagnosis: your simulation (JSON).")] = None,
    baseline: Annotated[str | None, typer.Option(help="Terms that your simulation has: a,b,…")] = None,
    per_recording: PerRecordingOption = None,
    test: TestOption = None,
    device: DeviceOption = None,
    run: RunOption = None,
    holdout: Annotated[float, typer.Option(help="Share held out at the end; not used with --test.")] = 0.3,
    span: SpanOption = None,
    max_samples: MaxSamplesOption = 100_000,
    seconds: Annotated[
        float | None,
        typer.Option(metavar="N", help="Time limit, s; the best result so far counts (as after Ctrl+C)."),
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw it here (PNG).")] = None,
    html: PageOption = None,
    json_path: ResultOption = None,
    exit_code: Annotated[
        bool, typer.Option("--exit-code", help="End with 1 when there is a mismatch.")
    ] = False,
) -> None:
    """Find where a model and a recording disagree, which physics is missing, and what it improves.

    Several recordings of a rig are searched together: they share all values but those of --per-recording.
    """
    from labhil.api.diagnosis import diagnose as diagnose_recordings

    refuse_unwritable(json_path, plot, html)
    with status() as progress:
        result = diagnose_recordings(
            recordings,
            rig_or_simulator(rig, simulator),
            baseline=baseline,
            test=test or None,
            holdout=holdout,
            reference=model,
            per_recording=per_recording,
            span=span,
            max_samples=max_samples,
            device=device,
            run=run,
            seconds=seconds,
            progress=progress,
            warn=tell,
        )
    _deliver(result, json_path, plot, html)
    if exit_code and result.verdict != "no_mismatch":
        raise typer.Exit(1)


def _deliver(result: Fit | Diagnosis, json_path: Path | None, plot: Path | None, html: Path | None) -> None:
    """Save a result, show it, draw it, and make a page of it."""
    if not result.complete and json_path != STDOUT:
        show(f"ENDED EARLY ({result.ended}): the best so far; more time may change it.")
    deliver(result.to_dict(), json_path, lambda: result.show(results_console()))
    if plot is not None:
        from labhil.report.figure import save

        save(result.figure(), plot)
    if html is not None:
        result.report(html)


def verify(
    recording: Annotated[Path, typer.Argument(help="A recording (.mcap).")],
    *,
    model: Annotated[Path, typer.Option(help="The accepted model: a fit or a diagnosis (JSON).")],
    rig: RigOption = None,
    simulator: SimulatorOption = None,
    device: DeviceOption = None,
    run: RunOption = None,
    alpha: Annotated[
        float,
        typer.Option(help="Probability of a false alarm: that a recording of the model itself is refused."),
    ] = 1e-3,
    span: SpanOption = None,
    max_samples: MaxSamplesOption = 100_000,
    html: PageOption = None,
    json_path: ResultOption = None,
) -> None:
    """Verify an accepted model on a recording; the exit status is 1 when the recording contradicts the model.

    Tests the windowed simulation with the accepted values, whether the residuals of the refitted model are
    correlated with the input, and whether refitted values differ from the accepted ones.
    """
    from labhil.api.verification import verify as verify_recording

    refuse_unwritable(json_path, html)
    with status() as progress:
        result = verify_recording(
            recording,
            model,
            rig_or_simulator(rig, simulator),
            alpha=alpha,
            span=span,
            max_samples=max_samples,
            device=device,
            run=run,
            progress=progress,
            warn=tell,
        )
    deliver(result.to_dict(), json_path, lambda: result.show(results_console()))
    if html is not None:
        result.report(html)
    if result.contradicted:
        raise typer.Exit(1)


def report(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="OUT.json|REC.mcap",
            help="The JSON of a fit, diagnosis or verification, or a recording.",
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The page to write (.html).")],
    run: RunOption = None,
) -> None:
    """Make one self-contained HTML page of a result or of a recording, to read, print or send."""
    from labhil.report.html.page import write_page
    from labhil.report.html.report import report_page

    refuse_unwritable(out)
    write_page(report_page(result, run), out)
    show(out)


def linear(
    recording: Annotated[Path, typer.Argument(help="A recording (.mcap).")],
    *,
    rig: RigOption = None,
    simulator: SimulatorOption = None,
    models: Annotated[str | None, typer.Option(help="Which: a,b,… (default: all).")] = None,
    test: Annotated[Path | None, typer.Option(help="A separate recording to judge on.")] = None,
    holdout: Annotated[float, typer.Option(help="Share held out at the end; not used with --test.")] = 0.3,
    run: RunOption = None,
    json_path: ResultOption = None,
) -> None:
    """Fit linear and black-box models, to compare physics with: ARX, OE, state space, NARX, …"""
    from labhil.analysis.dataset import load_dataset
    from labhil.api.inputs import rig_file
    from labhil.identify.linear import linear_study, study_json, study_text

    refuse_unwritable(json_path)
    dataset = load_dataset(recording, rig_file(rig_or_simulator(rig, simulator)), test, holdout, run=run)
    tell(dataset.losses())
    dataset.refuse_holes()
    with status() as progress:
        rows = linear_study(dataset.train, dataset.test, split_names(models), progress=progress)
    data = {"schema": "labhil.linear/1", "models": study_json(rows)}
    deliver(data, json_path, lambda: show(*study_text(rows)))
