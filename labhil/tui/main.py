"""The entry point of the terminal UI."""

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
"""Switch interval of Python's threads, s; its default of 5 ms, many times per key, is perceptible."""


def run_tui(folder: Path, connect: Iterable[str], *, light: bool = False, tab: str = "devices") -> int:
    """Show the terminal UI until it is quit.

    However it ends, a run that it started is ended in order.

    Args:
        folder: Folder of recordings, results and experiments.
        connect: Endpoints of buses to watch.
        light: Whether to begin with the light theme.
        tab: Name of the first tab.

    Returns:
        The exit status.

    Raises:
        UsageError: There is no such folder.
        BusError: Nobody listens at an endpoint.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: expected a folder for recordings, found none")
    with Session(tuple(connect)) as session:
        app = LabApp(folder, session, theme=LIGHT.name if light else DARK.name, tab=tab)
        # modules live as long as the screen: a garbage collection of them would delay a key by 0.1 s
        gc.freeze()
        sys.setswitchinterval(SWITCH_INTERVAL)
        try:
            app.run()
        finally:
            app.close_everything()
    return app.return_code or 0
