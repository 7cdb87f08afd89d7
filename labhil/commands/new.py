"""The command ``labhil new``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from labhil.console import tell
from labhil.errors import UsageError
from labhil.terminal import complain, show


def add_new(app: typer.Typer) -> None:
    """Register this command."""
    app.command(epilog="Example: labhil new dc_motor --address /dev/ttyACM0 --out bench")(new)


def new(
    kind: Annotated[
        str | None, typer.Argument(help="A driver of `labhil devices`; asked for if absent.")
    ] = None,
    address: Annotated[
        str | None,
        typer.Option(help="twin, /dev/ttyACM0, socket://host:port, an IP address; else asked for."),
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Where the files go.")] = Path(),
) -> None:
    """Write a first rig file and a first experiment for a device; nothing moves.

    Asks for missing arguments, and proposes the serial ports of this machine. Prints the two files.
    """
    from labhil.experiment.new import check_kind, example_drivers, write_new

    if kind is None:
        kind = _ask(f"Which device ({', '.join(example_drivers())})", None, "KIND")
    check_kind(kind)
    if address is None:
        address = _ask_address(kind)
    rig, experiment = write_new(kind, address, out)
    tell(
        (
            f"check [limits] and [known] in {rig} before anything moves",
            f"then: labhil run {experiment} --dry-run",
        )
    )
    show(rig, experiment)


def _ask(question: str, default: str | None, option: str) -> str:
    if not sys.stdin.isatty():
        raise UsageError(f"{option}: expected it on the command line, as stdin is no terminal")
    return str(typer.prompt(question, default=default, err=True)).strip()


def _ask_address(kind: str) -> str:
    """Ask for the address of a device; the serial ports are proposed where its driver takes them."""
    from labhil.plugins import load_driver

    takes = load_driver(kind).spec.address_help
    ports = _serial_ports() if "/dev/" in takes else []
    complain(*(f"serial port: {port}" for port in ports))
    proposed = ports[0] if ports else "twin"
    return _ask(f"Its address (twin for a simulated one; or {takes})", proposed, "--address")


def _serial_ports() -> list[str]:
    from serial.tools.list_ports import comports

    return sorted(port.device for port in comports())
