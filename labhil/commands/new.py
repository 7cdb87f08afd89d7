"""The command ``labhil new``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labhil.commands.json_flag import JsonFlagCommand, JsonOption
from labhil.console import STDOUT, refuse_unwritable, tell, write_json
from labhil.errors import OptionError, UsageError
from labhil.terminal import complain, show

if TYPE_CHECKING:
    from labhil.device_check.small_step import SmallStep
    from labhil.doctor.finding import Finding


def add_new(app: typer.Typer) -> None:
    """Register this command."""
    app.command(
        cls=JsonFlagCommand, epilog="Example: labhil new dc_motor --address /dev/ttyACM0 --out bench"
    )(new)


def new(
    kind: Annotated[
        str | None, typer.Argument(help="A driver of `labhil devices`; asked for if absent.")
    ] = None,
    address: Annotated[
        str | None,
        typer.Option(help="twin, /dev/ttyACM0, socket://host:port, an IP address; else asked for."),
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Where the files go.")] = Path(),
    search: Annotated[
        str | None,
        typer.Option(metavar="NETWORK", help="Look for controllers there, such as 192.168.1.0/24."),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Then read the device for 1.5 s, and say what is wrong.")
    ] = False,
    move: Annotated[
        bool, typer.Option("--move", help="Check it with a small step of each command; it moves.")
    ] = False,
    step: Annotated[
        float, typer.Option(metavar="PERCENT", help="Size of that step, of the range that [limits] allow.")
    ] = 5.0,
    json_path: JsonOption = None,
) -> None:
    """Write a first rig file and a first experiment for a device; nothing moves without --move or a yes.

    Asks for missing arguments. As addresses it proposes the serial ports of this machine, or the robot
    controllers that answer among the hosts that this machine knows. Prints the two files.

    The check reads every channel without a command: its range, its limits, its sample rate. After a yes, or
    with --move, each command makes a small step within the limits and goes back, and each channel is told to
    move as the model expects, or not. With --check, files that are there already are used as they are. The
    exit status is 1 where a finding is a fault. With --json, what was found of each channel is JSON.
    """
    if not 0.0 < step <= 100.0:
        raise OptionError("step", f": expected more than 0 and at most 100 percent, found {step:g}")
    if address is not None and search is not None:
        raise OptionError("search", f": expected no --address beside it, found {address!r}; it finds one")
    if json_path is not None and not (check or move):
        raise OptionError("json", ": expected --check or --move beside it, as it holds what the check finds")
    refuse_unwritable(json_path)
    experiment, is_asked = _make_files(
        kind, address, out, search, may_exist=check or move, quiet=json_path == STDOUT
    )
    if check or move or (is_asked and _is_yes("Read the device now, to check it? Nothing moves by that.")):
        _check(experiment, json_path, may_move=move, share=step / 100.0)


def _make_files(
    kind: str | None, address: str | None, out: Path, search: str | None, *, may_exist: bool, quiet: bool
) -> tuple[Path, bool]:
    """Write the two files and print their paths; those that are there already stay.

    Args:
        kind: The driver; None to ask for it.
        address: The device's address; None to ask for it.
        out: Folder of the files.
        search: Network to look for a controller in.
        may_exist: Whether files that are there already are used as they are.
        quiet: Whether stdout is for something else.

    Returns:
        The experiment file, and whether somebody was asked for something.
    """
    from labhil.experiment.new import check_kind, example_drivers, files_of, write_new

    is_asked = kind is None or address is None
    if kind is None:
        kind = _ask(f"Which device ({', '.join(example_drivers())})", None, "KIND")
    check_kind(kind)
    rig, experiment = files_of(kind, out)
    if may_exist and rig.exists() and experiment.exists():
        _refuse_other_address(experiment, address)
        tell((f"{rig} and {experiment} are there already and are used as they are",))
        is_asked = False
    else:
        if address is None:
            address = _ask_address(kind, search)
        rig, experiment = write_new(kind, address, out)
        tell(
            (
                f"check [limits] and [known] in {rig} before anything moves",
                f"then: labhil run {experiment} --dry-run",
            )
        )
    if not quiet:
        show(rig, experiment)
    return experiment, is_asked


def _refuse_other_address(experiment: Path, address: str | None) -> None:
    """UsageError where the file that is there already is for a device at another address."""
    from labhil.experiment.experiment import load_experiment

    stated = [device.address for device in load_experiment(experiment).devices.values()]
    if address is not None and stated != [address]:
        raise UsageError(
            f"{experiment}: expected the address {address}, found {', '.join(stated)}; correct the file, or "
            "choose another folder with --out"
        )


def _check(experiment: Path, json_path: Path | None, *, may_move: bool, share: float) -> None:
    """Check the device, and end with exit status 1 where a finding is a fault."""
    from labhil.device_check.check import Check, check_device
    from labhil.doctor.examine import format_finding

    def agree(steps: Sequence[SmallStep]) -> bool:
        if not steps:
            complain("no command can make a step")
            return False
        complain("a small step of each command, within the limits:", *(f"  {one}" for one in steps))
        if may_move:
            return True
        if sys.stdin.isatty():
            return _is_yes("Move the device? Is everybody out of its way?")
        complain("nothing was moved; --move makes these steps")
        return False

    is_quiet = json_path == STDOUT

    def print_finding(finding: Finding) -> None:
        if not is_quiet:
            show(format_finding(finding))

    tell(("reading the device; nothing is commanded",))
    found = check_device(experiment, Check(print_finding, agree, share))
    if json_path is not None:
        write_json(found.to_json(), json_path)
    if not found.fine:
        complain(f"there are faults: see the {'broken findings' if is_quiet else 'lines with FAIL'}")
        raise typer.Exit(1)
    complain("no fault was found")


def _is_yes(question: str) -> bool:
    """Ask a question whose answer is no unless somebody says yes; the end of the input is no yes."""
    try:
        return bool(typer.confirm(question, default=False, err=True))
    except typer.Abort as abort:
        if isinstance(abort.__context__, EOFError):
            return False
        raise KeyboardInterrupt from abort


def _ask(question: str, default: str | None, option: str) -> str:
    if not sys.stdin.isatty():
        raise UsageError(f"{option}: expected it on the command line, as stdin is no terminal")
    try:
        return str(typer.prompt(question, default=default, err=True)).strip()
    except typer.Abort as abort:
        if isinstance(abort.__context__, EOFError):
            raise UsageError(f"{option}: expected an answer, found the end of the input") from abort
        raise KeyboardInterrupt from abort


def _ask_address(kind: str, search: str | None) -> str:
    """Ask for the address of a device; those that its driver finds are proposed."""
    from labhil.plugins import find_addresses, load_driver

    found = find_addresses(kind, search)
    complain(*(f"{place.address}: {place.what}" for place in found))
    if search is not None and not found:
        complain(f"nobody answers in {search}; is the controller on, and is it in that network?")
    proposed = found[0].address if found else "twin"
    takes = load_driver(kind).spec.address_help
    return _ask(f"Its address (twin for a simulated one; or {takes})", proposed, "--address")
