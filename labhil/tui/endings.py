"""Ends of the screen that nobody asks for on the screen: a signal, and a web server that is gone."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
from typing import Protocol

from textual.app import App

ENDINGS = (signal.SIGTERM, signal.SIGHUP)
SERVER_INTERVAL = 0.5


class Asked(Protocol):
    """Ends a run in order when it is asked to."""

    def ask(self, what: str, reason: str = "") -> None:
        """Ask for ``stop``."""


def end_in_order(app: App[None], runner: Asked) -> None:
    """Let signals end ``app`` and its run in order; in a page, so does the end of its web server."""

    def end(number: signal.Signals) -> None:
        runner.ask("stop", f"the terminal UI was ended by {number.name}")
        app.exit(return_code=128 + number)

    if threading.current_thread() is threading.main_thread():
        loop = asyncio.get_running_loop()
        for each in ENDINGS:
            loop.add_signal_handler(each, end, each)
    if app.is_web:
        server = os.getppid()

        def look() -> None:
            if os.getppid() != server:
                end(signal.SIGHUP)

        app.set_interval(SERVER_INTERVAL, look)
