"""Shutdown from outside: by a signal, or by the end of the web server."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Protocol

from textual.app import App

from labhil.supervised import SupervisedThread

ENDINGS = (signal.SIGTERM, signal.SIGHUP)
SERVER = "LABHIL_WEB_SERVER"
"""Environment variable with the process id of the web server, for the process of a page."""


class Stoppable(Protocol):
    """End a run in order on request."""

    def request(self, what: str, reason: str = "") -> None:
        """Request ``stop``."""


def end_in_order(app: App[None], runner: Stoppable) -> None:
    """End the app and its run in order on SIGTERM and SIGHUP; a page also with its web server.

    Args:
        app: The app.
        runner: Its run.
    """

    def end(number: signal.Signals) -> None:
        runner.request("stop", f"the terminal UI was ended by {number.name}")
        app.exit(return_code=128 + number)

    if threading.current_thread() is not threading.main_thread():
        return
    loop = asyncio.get_running_loop()
    for ending in ENDINGS:
        loop.add_signal_handler(ending, end, ending)
    if app.is_web and SERVER in os.environ:
        server = int(os.environ[SERVER])
        hang_up = partial(loop.call_soon_threadsafe, end, signal.SIGHUP)
        SupervisedThread(
            partial(_end_with, server, hang_up), "watch the web server", daemon=True, on_failure=hang_up
        ).start()


def _end_with(
    server: int, end: Callable[[], object], *, interval: float = 0.5, patience: float = 20.0
) -> None:
    """End this process with its server, by force where it does not end within ``patience`` s.

    A screen that draws into a broken pipe may never end. The run that it started sees the end of its input in
    either case, and ends in order.
    """
    while os.getppid() == server:
        time.sleep(interval)
    with suppress(RuntimeError):  # the loop has ended already
        end()
    time.sleep(patience)
    os._exit(1)
