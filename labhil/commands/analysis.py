"""Commands of the analysis wing: fit, diagnose, verify, and what shows their results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.commands.files import RunOption
from labhil.commands.json_flag import JsonFlagCommand
from labhil.console import (
    deliver,
    early_line,
    ending_early,
    refuse_unwritable,
    results_console,
    split_names,
    status,
    tell,
    write_json,
)
from labhil.errors import UsageError
from labhil.terminal import show

RecordingsArgument = Annotated[
    list[Path],
    typer.Argument(metavar="RECORDING...", help="A recording (.mcap), or several of the same rig."),
]
PerRecordingOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        help="What has a value of its own in each recording: terms, parameters or sizes of the rig, a,b,…",
    ),
]
DeviceOption = Annotated[
    str | None, typer.Option(metavar="NAME", help="Which device, where a recording holds several.")
]
SpanOption = Annotated[
    tuple[float, float] | None,
    typer.Option(metavar="FROM TO", help="Use only this stretch of every recording, s."),
]
TestOption = Annotated[
    list[Path] | None, typer.Option(help="A separate recording to judge on; may be repeated.")
]


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
    as_json: Annotated[bool, typer.Option("--json", help="Print them as JSON.")] = False,
) -> None:
    """List the effects that a rig's model may have, with equation, parameters, units and source."""
    from labhil.report.catalogue import catalogue_json, show_catalogue

    if as_json:
        write_json(catalogue_json(rig))
    else:
        show_catalogue(rig)


def fit(
    recordings: RecordingsArgument,
    *,
    rig: Annotated[Path | None, typer.Option(help="Rig file; default: the recording's own.")] = None,
    model: Annotated[Path | None, typer.Option(help="A fit or diagnosis to start from (JSON).")] = None,
    estimator: Annotated[
        str,
        typer.Option(
            help="Where it begins: hybrid, nlse, pso, pso_adaptive, pso_de, differential_evolution, "
            "simulated_annealing, cma_es or mcmc; all end with least squares."
        ),
    ] = "hybrid",
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
    device: DeviceOption = None,
    run: RunOption = None,
    window: Annotated[
        float | None, typer.Option(help="Length of the fitted windows, s (default: several, compared).")
    ] = None,
    intervals: Annotated[str, typer.Option(help="auto, wald, profile (slower) or bootstrap.")] = "auto",
    criterion: Annotated[
        str | None,
        typer.Option(
            help="What the fit makes small: windowed_simulation or, of an axis too, inverse_dynamics "
            "(default: the rig's own metric, which scores either)."
        ),
    ] = None,
    simultaneous: Annotated[
        bool, typer.Option("--simultaneous", help="Intervals that hold for all parameters together.")
    ] = False,
    plot: Annotated[Path | None, typer.Option(help="Draw fit and residuals here (PNG).")] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page about it here (HTML).")] = None,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
) -> None:
    """Fit a white-box model to a recording, with honest errors, and test it on data it has not seen.

    Several recordings of a rig are fitted together: they share all values but those of --per-recording.
    """
    from labhil.analysis.kept_curve import curve_note
    from labhil.analysis.material import load_material
    from labhil.analysis.study import fit_study
    from labhil.identify.estimators import estimator_named
    from labhil.identify.fit import Options, criterion_named
    from labhil.identify.intervals import interval_method
    from labhil.report.faults import fault_lines
    from labhil.report.text import show_fit

    refuse_unwritable(json_path, plot, html)
    method, small = interval_method(intervals), criterion_named(criterion)
    apart = split_names(per_recording) or ()
    material = load_material(
        recordings, rig, test, holdout, apart, span=span, all_of_it=True, device=device, run=run
    )
    tell(material.losses())
    with status() as say, ending_early() as deadline:
        options = Options(window, method, simultaneous, estimator_named(estimator), seed, say, small)
        result = fit_study(material, terms=split_names(names), start=model, options=options)
    notes = [*fault_lines(material.faults()), *result.doubts, *material.numbered()]
    notes += [*material.notes(), *curve_note(model)]
    with early_line(result.fit.complete, deadline, json_path):
        deliver(result.json, json_path, lambda: show_fit(result.fit, results_console(), notes))
    if plot is not None:
        from labhil.report.fit_plot import fit_plot

        fit_plot(result.fit, material.judge, plot)
    if html is not None:
        from labhil.report.html.study import write_fit_page

        write_fit_page(result, html)


def diagnose(
    recordings: RecordingsArgument,
    *,
    rig: Annotated[Path | None, typer.Option(help="Rig file; default: the recording's own.")] = None,
    model: Annotated[Path | None, typer.Option(help="A fit or diagnosis: your simulation (JSON).")] = None,
    baseline: Annotated[str | None, typer.Option(help="Terms that your simulation has: a,b,…")] = None,
    per_recording: PerRecordingOption = None,
    test: TestOption = None,
    device: DeviceOption = None,
    run: RunOption = None,
    holdout: Annotated[float, typer.Option(help="Share held out at the end; not used with --test.")] = 0.3,
    span: SpanOption = None,
    seconds: Annotated[
        float | None,
        typer.Option(metavar="N", help="End after so many s, with the best so far (so does Ctrl+C)."),
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw it here (PNG).")] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page about it here (HTML).")] = None,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
    exit_code: Annotated[
        bool, typer.Option("--exit-code", help="End with 1 when there is a mismatch.")
    ] = False,
) -> None:
    """Say where a model and a recording disagree, what physics is missing, and how much it helps.

    Several recordings of a rig are searched together: they share all values but those of --per-recording.
    """
    from labhil.analysis.kept_curve import curve_note
    from labhil.analysis.material import load_material
    from labhil.analysis.study import diagnose_study
    from labhil.report.text import show_diagnosis

    refuse_unwritable(json_path, plot, html)
    if seconds is not None and not seconds > 0:
        raise UsageError(f"--seconds: expected more than 0, found {seconds:g}")
    apart = split_names(per_recording) or ()
    material = load_material(recordings, rig, test, holdout, apart, span=span, device=device, run=run)
    tell(material.losses())
    with status() as say, ending_early(seconds) as deadline:
        result = diagnose_study(material, baseline=split_names(baseline), reference=model, progress=say)
    notes = [*result.doubts, *material.numbered(), *material.notes(), *curve_note(model)]
    with early_line(result.diagnosis.complete, deadline, json_path):
        deliver(result.json, json_path, lambda: show_diagnosis(result.diagnosis, results_console(), notes))
    if plot is not None:
        from labhil.report.plots import diagnosis_plot

        diagnosis_plot(result.diagnosis, plot)
    if html is not None:
        from labhil.report.html.study import write_diagnosis_page

        write_diagnosis_page(result, html)
    if exit_code and result.diagnosis.verdict != "no_mismatch":
        raise typer.Exit(1)


def verify(
    recording: Annotated[Path, typer.Argument(help="A recording (.mcap).")],
    *,
    model: Annotated[Path, typer.Option(help="The accepted model: a fit or a diagnosis (JSON).")],
    rig: Annotated[Path | None, typer.Option(help="Rig file; default: the recording's own.")] = None,
    device: DeviceOption = None,
    run: RunOption = None,
    alpha: Annotated[
        float, typer.Option(help="Probability that a recording of the model itself is refused.")
    ] = 1e-3,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
) -> None:
    """Hold a recording against an accepted model: ends with 1 when it contradicts the model, else with 0.

    Tests the windowed simulation with the values as they are, whether the refitted model leaves residuals
    that go with the input, and whether refitted values differ from the accepted ones.
    """
    from labhil.analysis.verification import verify_study
    from labhil.report.verification import show_verification

    refuse_unwritable(json_path)
    with status() as say:
        result = verify_study(recording, model, rig, alpha=alpha, device=device, run=run, progress=say)
    tell(result.losses)
    deliver(result.json, json_path, lambda: show_verification(result.verification, results_console()))
    if not result.verification.consistent:
        raise typer.Exit(1)


def report(
    result: Annotated[
        Path,
        typer.Argument(metavar="OUT.json|REC.mcap", help="The JSON of a fit or diagnosis, or a recording."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The page to write (.html).")],
    run: RunOption = None,
) -> None:
    """Make one HTML page of a result or of a recording: complete in itself, to be read, printed or sent."""
    from labhil.report.html.page import write_page
    from labhil.report.html.report import report_page

    refuse_unwritable(out)
    write_page(report_page(result, run), out)
    show(out)


def linear(
    recording: Annotated[Path, typer.Argument(help="A recording (.mcap).")],
    *,
    rig: Annotated[Path | None, typer.Option(help="Rig file; default: the recording's own.")] = None,
    models: Annotated[str | None, typer.Option(help="Which: a,b,… (default: all).")] = None,
    test: Annotated[Path | None, typer.Option(help="A separate recording to judge on.")] = None,
    holdout: Annotated[float, typer.Option(help="Share held out at the end; not used with --test.")] = 0.3,
    run: RunOption = None,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the whole result here.")] = None,
) -> None:
    """Fit linear and black-box baselines, to see what physics is worth: ARX, OE, state space, NARX, …"""
    from labhil.analysis.material import load_material
    from labhil.identify.linear import linear_study, study_json, study_text

    refuse_unwritable(json_path)
    material = load_material(recording, rig, test, holdout, run=run)
    tell(material.losses())
    material.refuse_holes()
    with status() as say:
        rows = linear_study(material.learn, material.judge, split_names(models), progress=say)
    data = {"schema": "labhil.linear/1", "models": study_json(rows)}
    deliver(data, json_path, lambda: show(*study_text(rows)))
