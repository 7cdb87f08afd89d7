"""The command ``labhil firmware``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.console import tell
from labhil.errors import UnknownNameError
from labhil.terminal import show


def add_firmware(app: typer.Typer) -> None:
    """Register this command."""
    app.command(epilog="Example: labhil firmware ball_beam -o ball_beam_firmware")(firmware)


def firmware(
    name: Annotated[
        str | None, typer.Argument(help="A driver; without one, those that have firmware.")
    ] = None,
    *,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="DIR", help="Copy it to this new folder.")
    ] = None,
) -> None:
    """Print the folder of a bench's firmware for the Arduino Mega, or copy it to edit and build it.

    How to build and flash: docs/how-to/flash-firmware.md; to wire and calibrate: docs/how-to/wire-a-bench.md.
    """
    from labhil import plugins

    folders = {driver: plugins.firmware_folder(driver) for driver in plugins.names(plugins.DRIVERS)}
    firmware_folders = {driver: folder for driver, folder in folders.items() if folder is not None}
    if name is None:
        for driver, folder in firmware_folders.items():
            show(f"{driver}  {folder}")
        return
    if name not in firmware_folders:
        raise UnknownNameError("firmware", name, firmware_folders)
    if out is None:
        show(firmware_folders[name])
        return
    from labhil_firmware import write_sources

    write_sources(firmware_folders[name], out)
    tell(
        (
            f"wiring and calibration are in {out / 'bench.h'}: edit that first",
            f"build: make -C {out}",
            f"flash: make -C {out} flash PORT=/dev/ttyACM0",
        )
    )
    show(out)
