"""The command ``labhil``: one thin function per command.

Each command imports what it needs when it runs, so that a rack PC that records loads no compiler and a
laptop that fits loads no bus. Results go to stdout, everything else to stderr.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from labhil.commands import add_studies
from labhil.console import refuse_unwritable, results_console, split_names, status, tell, write_json
from labhil.errors import LabhilError, UsageError

app = typer.Typer(
    help="Record a rig and its simulation, find where they disagree, and say what physics was left out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


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
TestOption = Annotated[
    list[Path] | None, typer.Option(help="A separate recording to judge on; may be repeated.")
]


def main() -> None:
    """Run the command line; ends the process with 0 (done), 1 (the run came to grief) or 2 (wrong use)."""
    try:
        app()
    except LabhilError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_status)


def parse_settings(settings: list[str]) -> dict[str, float]:
    """Return the numbers in ``["name=value", …]``; UsageError says which one is not like that."""
    parsed: dict[str, float] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        try:
            parsed[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals or not name.strip():
            raise UsageError(
                f"--set {setting!r}: expected name=number, like viscous_friction.coefficient=0.3"
            )
    return parsed


def _print_version(wanted: bool) -> None:
    if wanted:
        from labhil import __version__

        print(f"labhil {__version__}")
        raise typer.Exit


@app.callback()
def _labhil(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Say which version it is."),
    ] = False,
) -> None:
    """Bench-to-model loop: acquire, fit, diagnose."""


@app.command(
    epilog="Example: labhil twin ball_beam --seed 3 --terms viscous_friction,coulomb_friction --speed 5"
)
def twin(
    kind: Annotated[str, typer.Argument(help="A name from `labhil devices`.")],
    *,
    seed: Annotated[int, typer.Option(help="Seed of its noise.")] = 0,
    terms: Annotated[
        str | None, typer.Option(help="Effects it is made of: a,b,… (default: its own; see --list).")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="A value other than the default (SI; see --list); may be repeated.",
        ),
    ] = None,
    speed: Annotated[float, typer.Option(help="How many seconds of its world pass in one.")] = 1.0,
    wire: Annotated[str, typer.Option(help="pty or tcp.")] = "pty",
    answer: Annotated[Path | None, typer.Option(help="Write what it is made of to this file.")] = None,
    parameters: Annotated[bool, typer.Option("--list", help="Print terms and settings, and end.")] = False,
) -> None:
    """Start a simulated device on the real wire.

    The first line of its output is the address to connect to; it runs until it is interrupted.
    """
    from labhil.driver import TwinOptions
    from labhil.plugins import load_twin

    device = load_twin(kind)
    if parameters:
        for name, about in device.terms().items():
            print(f"--terms {name}: {about}")
        for name, value in device.parameters().items():
            print(f"--set {name}={value:g}")
        return
    chosen = parse_settings(settings or [])
    options = TwinOptions(seed, speed, split_names(terms), chosen, wire, answer)
    device.serve(options, lambda address: print(address, flush=True))


@app.command(epilog="Example: labhil devices ball_beam")
def devices(
    names: Annotated[list[str] | None, typer.Argument(help="Describe these (imports them).")] = None,
) -> None:
    """List the installed driver plugins and twins, or describe some of them."""
    from labhil import plugins

    if not names:
        twins = plugins.names(plugins.TWINS)
        for name in plugins.names(plugins.DRIVERS):
            print(f"{name}  (with a simulated device)" if name in twins else name)
        return
    for name in names:
        spec = plugins.load_driver(name).spec
        print(f"{name}: {spec.description}")
        print(f"  rig {spec.rig}; address: twin, {spec.address_help}")
        print(
            f"  samples at {spec.stream.rate:g} Hz; safe after {spec.command_timeout:g} s without a command"
        )
        for signal in spec.stream.signals:
            command = f", commanded, safe at {spec.safe[signal.name]:g}" if signal.name in spec.safe else ""
            print(f"  {signal.name} [{signal.unit}] {signal.description}{command}")


@app.command(epilog="Example: labhil run ball_beam_identify.toml --out recordings")
def run(
    experiment: Annotated[Path, typer.Argument(help="An experiment file (TOML).")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, touch no device.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the recording goes.")] = Path(),
) -> None:
    """Acquire: run the steps of an experiment file and leave one recording.

    Its path is the last line of the output. Ctrl+C brings every device to its safe state and leaves a
    readable recording.
    """
    from labhil.experiment.experiment import load_experiment
    from labhil.experiment.plan import make_plan

    plan = make_plan(load_experiment(experiment))
    if dry_run:
        print(plan.describe())
        return
    from labhil.experiment.run import run_experiment
    from labhil.experiment.show import ProgressBar

    tell(plan.warnings())
    with ProgressBar() as bar:
        result = run_experiment(plan.experiment, out, bar)
    if result.error is not None:
        print(result.error, file=sys.stderr)
    if as_json:
        write_json(result.to_json())
    elif result.path is not None:
        print(result.path)
    raise typer.Exit(result.exit_status)


@app.command("import", epilog="Example: labhil import bench.csv --rig ball_beam.toml -o bench.mcap")
def import_(
    data: Annotated[Path, typer.Argument(help="A text table (any extension) or a MAT file.")],
    rig: Annotated[
        Path, typer.Option(help="The rig file; its [table] and [channels] say how to read the data.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The recording to write (.mcap).")],
) -> None:
    """Make a recording of a table that others wrote."""
    from labhil.recording.tables import describe_import, import_table, write_import
    from labhil.rig import load_rig

    table = import_table(data, load_rig(rig))
    tell(describe_import(table))
    print(write_import(table, out))


@app.command(epilog="Example: labhil export run.mcap -o run.csv")
def export(
    recording: Annotated[Path, typer.Argument(help="A recording (.mcap).")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The table to write (.csv).")],
) -> None:
    """Write the samples of a recording as a table: a column t (s), then the signals in SI units."""
    from labhil.recording.export import export as write_table
    from labhil.recording.reader import read_recording

    found = read_recording(recording)
    tell(found.losses())
    print(write_table(found, out))


@app.command(epilog="Example: labhil terms ball_beam")
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


@app.command(epilog="Example: labhil fit run.mcap --terms viscous_friction,coulomb_friction --json fit.json")
def fit(
    recordings: RecordingsArgument,
    *,
    rig: Annotated[Path | None, typer.Option(help="Rig file; default: the recording's own.")] = None,
    model: Annotated[Path | None, typer.Option(help="A fit to start from (JSON).")] = None,
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
    span: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="FROM TO", help="Use only this stretch of every recording, s."),
    ] = None,
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
    from labhil.identify.estimators import estimator_named
    from labhil.identify.fit import Options, criterion_named
    from labhil.identify.intervals import interval_method
    from labhil.report.material import load_material
    from labhil.report.study import fit_study
    from labhil.report.text import show_fit

    refuse_unwritable(json_path, plot, html)
    method, small = interval_method(intervals), criterion_named(criterion)
    apart = split_names(per_recording) or ()
    material = load_material(recordings, rig, test, holdout, apart, span=span, all_of_it=True)
    tell(material.losses())
    with status() as say:
        options = Options(window, method, simultaneous, estimator_named(estimator), seed, say, small)
        result = fit_study(material, terms=split_names(names), start=model, options=options)
    show_fit(result.fit, results_console(), material.numbered())
    if plot is not None:
        from labhil.report.fit_plot import fit_plot

        fit_plot(result.fit, material.judge, plot)
    if json_path is not None:
        write_json(result.json, json_path)
    if html is not None:
        from labhil.report.html.study import write_fit_page

        write_fit_page(result, html)


@app.command(
    epilog="Example: labhil diagnose run.mcap --test test.mcap --baseline viscous_friction --plot d.png"
)
def diagnose(
    recordings: RecordingsArgument,
    *,
    rig: Annotated[Path | None, typer.Option(help="Rig file; default: the recording's own.")] = None,
    model: Annotated[Path | None, typer.Option(help="A fit that stands for your simulation (JSON).")] = None,
    baseline: Annotated[str | None, typer.Option(help="Terms that your simulation has: a,b,…")] = None,
    per_recording: PerRecordingOption = None,
    test: TestOption = None,
    holdout: Annotated[float, typer.Option(help="Share held out at the end; not used with --test.")] = 0.3,
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
    from labhil.report.material import load_material
    from labhil.report.study import diagnose_study
    from labhil.report.text import show_diagnosis

    refuse_unwritable(json_path, plot, html)
    material = load_material(recordings, rig, test, holdout, split_names(per_recording) or ())
    tell(material.losses())
    with status() as say:
        result = diagnose_study(material, baseline=split_names(baseline), reference=model, progress=say)
    show_diagnosis(result.diagnosis, results_console(), material.numbered())
    if json_path is not None:
        write_json(result.json, json_path)
    if plot is not None:
        from labhil.report.plots import diagnosis_plot

        diagnosis_plot(result.diagnosis, material.judge, plot)
    if html is not None:
        from labhil.report.html.study import write_diagnosis_page

        write_diagnosis_page(result, html)
    if exit_code and result.diagnosis.verdict != "no_mismatch":
        raise typer.Exit(1)


@app.command(epilog="Example: labhil demo --seed 7")
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


add_studies(app)
