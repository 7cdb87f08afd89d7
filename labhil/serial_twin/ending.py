"""When a twin is to end: a signal, or the end of the pipe that its parent holds."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import stat
import sys
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, Self

Handler = Callable[[int, FrameType | None], Any] | int | None


class Ending:
    """Context in which SIGINT and SIGTERM set ``due`` instead of ending the process.

    Where standard input is a pipe its end sets it too: a parent that dies closes it. Signals are
    handled only in the main thread; handlers are put back at the end.
    """

    def __init__(self) -> None:
        self.due = False
        self._handlers: dict[int, Handler] = {}
        self._pipe = _standard_input_pipe()

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._handlers[number] = signal.signal(number, self._told)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def wait(self, timeout: float, fd: int | None = None) -> bool:
        """Wait up to ``timeout`` s for something to read on ``fd``, and tell whether it came."""
        watched = [number for number in (fd, self._pipe) if number is not None]
        readable, _, _ = select.select(watched, [], [], max(timeout, 0.0))
        if self._pipe in readable:
            self._read_pipe()
        return fd in readable

    def _read_pipe(self) -> None:
        said = b""
        if self._pipe is not None:
            with contextlib.suppress(OSError):
                said = os.read(self._pipe, 4096)
        if not said:
            self.due = True
            self._pipe = None

    def _told(self, _number: int, _frame: FrameType | None) -> None:
        self.due = True


def _standard_input_pipe() -> int | None:
    try:
        fd = sys.stdin.fileno()
        mode = os.fstat(fd).st_mode
    except (AttributeError, OSError, ValueError):
        return None
    return fd if stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) else None
