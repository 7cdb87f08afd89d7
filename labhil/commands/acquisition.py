"""Commands of acquisition: ``labhil twin``, ``labhil devices``, ``labhil run``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from labhil.commands.json_flag import JsonFlagCommand, JsonOption
from labhil.console import STDOUT, refuse_unwritable, split_names, tell, write_json
from labhil.errors import UsageError
from labhil.terminal import complain, show

if TYPE_CHECKING:
    from labhil.api.acquisition import Experiment
    from labhil.driver import DriverSpec
    from labhil.signals import Signal


def add_acquisition(app: typer.Typer) -> None:
    """Register these commands."""
    app.command(
        epilog="Example: labhil twin ball_beam --seed 3 --terms viscous_friction,coulomb_friction --speed 5"
    )(twin)
    app.command(epilog="Example: labhil devices ball_beam")(devices)
    app.command(cls=JsonFlagCommand, epilog="Example: labhil run ball_beam_identify.toml --out recordings")(
        run
    )


def twin(
    kind: Annotated[str, typer.Argument(help="A name from `labhil devices`.")],
    *,
    seed: Annotated[int, typer.Option(help="Seed of its noise.")] = 0,
    terms: Annotated[
        str | None, typer.Option(help="Terms of its model: a,b,… (default: its own; see --list).")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="A value other than the default (SI; see --list); may be repeated.",
        ),
    ] = None,
    tables: Annotated[
        list[str] | None,
        typer.Option("--table", metavar="NAME=FILE", help="A measured map, like force_map=map.csv."),
    ] = None,
    speed: Annotated[float, typer.Option(help="Seconds of simulated time in one second.")] = 1.0,
    wire: Annotated[str, typer.Option(help="pty or tcp.")] = "pty",
    answer: Annotated[Path | None, typer.Option(help="Write its terms and values to this file.")] = None,
    host: Annotated[
        str | None,
        typer.Option(metavar="IP", help="Address of this machine for a networked twin: 127.0.0.2, …"),
    ] = None,
    series: Annotated[
        str | None, typer.Option(help="Make of its controller (ur5: cb3, e, or a version such as 5.11.1).")
    ] = None,
    parameters: Annotated[bool, typer.Option("--list", help="Print terms and settings, and exit.")] = False,
) -> None:
    """Start a simulated device on the real wire.

    The first line of its output is the address to connect to; it runs until it is interrupted.
    """
    from labhil.driver import TwinOptions
    from labhil.plugins import load_twin

    device = load_twin(kind)
    if parameters:
        for name, about in device.terms().items():
            show(f"--terms {name}: {about}")
        for name, value in device.parameters().items():
            show(f"--set {name}={value:g}")
        return
    chosen = parse_settings(settings or [])
    options = TwinOptions(
        seed=seed,
        speed=speed,
        terms=split_names(terms),
        parameters=chosen,
        wire=wire,
        answer=answer,
        tables=parse_tables(tables or []),
        host=host,
        series=series,
    )
    device.serve(options, _show_address)


def _show_address(address: str) -> None:
    show(address)


def parse_settings(settings: list[str]) -> dict[str, float]:
    """Parse settings.

    Args:
        settings: For example ``["viscous_friction.coefficient=0.3"]``.

    Raises:
        UsageError: One of them is not name=number.
    """
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


def parse_tables(tables: list[str]) -> dict[str, Path]:
    """Parse tables.

    Args:
        tables: For example ``["force_map=map.csv"]``.

    Raises:
        UsageError: One of them is not name=file.
    """
    parsed: dict[str, Path] = {}
    for table in tables:
        name, _, file = table.partition("=")
        if not name.strip() or not file.strip():
            raise UsageError(f"--table {table!r}: expected name=file, like force_map=map.csv")
        parsed[name.strip()] = Path(file.strip())
    return parsed


def devices(
    names: Annotated[list[str] | None, typer.Argument(help="Describe these (imports them).")] = None,
) -> None:
    """List the installed driver plugins and twins, or describe some of them."""
    from labhil import plugins

    if not names:
        twins = plugins.names(plugins.TWINS)
        for name in plugins.names(plugins.DRIVERS):
            show(f"{name}  (with a simulated device)" if name in twins else name)
        return
    for name in names:
        spec = plugins.load_driver(name).spec
        show(f"{name}: {spec.description}")
        show(f"  rig {spec.rig}; address: twin, {spec.address_help}")
        show(f"  samples at {spec.stream.rate:g} Hz; safe after {spec.command_timeout:g} s without a command")
        for signal in spec.stream.signals:
            command = _command_note(signal, spec)
            show(f"  {signal.name} [{signal.unit}] {signal.description}{command}")
        if plugins.firmware_folder(name) is not None:
            show(f"  firmware for an Arduino Mega: labhil firmware {name} -o DIR")


def _command_note(signal: Signal, spec: DriverSpec) -> str:
    if signal not in spec.commands:
        return ""
    if signal.name not in spec.safe:
        return ", commanded, holds when safe"
    return f", commanded, safe at {spec.safe[signal.name]:g}"


def run(
    experiment: Annotated[Path, typer.Argument(help="An experiment file (TOML).")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, touch no device.")] = False,
    json_path: JsonOption = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the recording goes.")] = Path(),
    anew: Annotated[
        bool, typer.Option("--anew", help="Start the campaign of a sweep again; its recordings stay.")
    ] = False,
) -> None:
    """Run the steps of an experiment file, and record them.

    The path of the recording is the last line of the output. Ctrl+C brings every device to its safe state
    and leaves a readable recording. With `repeat` or [sweep] in the file each run has its own recording, and
    there is a campaign file beside them; the same command continues a campaign that was interrupted.
    """
    from labhil.api.acquisition import Experiment

    refuse_unwritable(json_path)
    planned = Experiment.load(experiment)
    if dry_run:
        show(planned.plan())
        return
    tell(planned.warnings())
    if planned.is_campaign:
        _run_all(planned, out, json_path, anew=anew)
    if anew:
        raise UsageError(f"--anew is for campaigns; {experiment} has neither `repeat` nor [sweep]")
    result = planned.execute(out, progress=True)
    if result.error is not None:
        complain(result.reason)  # which names an emergency stop beside it
    tell(result.warnings)
    if json_path is not None:
        write_json(result.to_json(), json_path)
    if json_path != STDOUT and result.path is not None:
        show(result.path)
    raise typer.Exit(result.exit_status)


def _run_all(planned: Experiment, out: Path, json_path: Path | None, *, anew: bool) -> NoReturn:
    """Make all runs of a campaign, and end with its exit status."""
    campaign = planned.run_all(out, progress=True, announce=complain, anew=anew)
    if campaign.error is not None:
        complain(campaign.error)
        remaining = len(campaign.file.runs) - campaign.done
        complain(f"{remaining} of {len(campaign.file.runs)} runs are not done; the same command continues")
    tell(campaign.warnings)
    if json_path is not None:
        write_json(campaign.to_json(), json_path)
    if json_path != STDOUT:
        show(*campaign.recordings)
    raise typer.Exit(campaign.exit_status)
