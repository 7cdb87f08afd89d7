"""From the command to the screen, and back without leaving anything behind."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterable
from pathlib import Path

from labhil.errors import UsageError
from labhil.tui.app import LabApp
from labhil.tui.session import Session
from labhil.tui.themes import DARK, LIGHT

SWITCH_INTERVAL = 0.001
"""Seconds after which a thread that reads files lets the screen go on; Python's own 5 ms, many times per key,
are felt."""


def run_tui(folder: Path, connect: Iterable[str], *, light: bool = False, tab: str = "devices") -> int:
    """Show the screen, first this ``tab`` of it, until it is left; returns the exit status.

    Raises UsageError where there is no such folder, BusError where nobody listens at an endpoint. However
    the screen ends, a run that it started is ended in order.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: expected a folder for recordings, found none")
    with Session(tuple(connect)) as session:
        app = LabApp(folder, session, theme=LIGHT.name if light else DARK.name, tab=tab)
        # modules live as long as the screen: a collection that walks through them holds a key up for 0.1 s
        gc.freeze()
        sys.setswitchinterval(SWITCH_INTERVAL)
        try:
            app.run()
        finally:
            app.close_everything()
    return app.return_code or 0
