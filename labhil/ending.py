"""When something is to end: a twin, by signals and lines on the pipe of its parent; a computation, early."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import stat
import sys
import threading
import time
from collections.abc import Callable, Sequence
from types import FrameType, TracebackType
from typing import Any, Self

Handler = Callable[[int, FrameType | None], Any] | int | None


class Handled:
    """Signals that go to a function of ours for a while; outside the main thread Python handles none."""

    def __init__(self, numbers: Sequence[int], handler: Handler) -> None:
        self._numbers, self._handler = numbers, handler
        self._before: dict[int, Handler] = {}

    def put(self) -> None:
        """Have them from now on."""
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._handler) for number in self._numbers}

    def put_back(self) -> None:
        """Give them back to whoever had them."""
        for number, handler in self._before.items():
            signal.signal(number, handler)


class EndedEarly(Exception):  # noqa: N818 - no error: whoever has a result by then returns that
    """Work is to end with the best so far. ``theta`` is where it stood, if that is known, (P,)."""

    theta: Any = None


class Deadline:
    """Context in which SIGINT, SIGTERM or ``seconds`` end a long computation with the best so far.

    The computation asks :func:`checkpoint` now and then. Who catches what that raises calls :func:`accept`,
    and may then compute what a result needs. A second Ctrl+C breaks in as ever.
    """

    _present: Deadline | None = None

    def __init__(self, seconds: float | None = None) -> None:
        self.reason = ""
        self._at = float("inf") if seconds is None else time.monotonic() + seconds
        self._seconds = seconds
        self._accepted = False
        self._handled = Handled((signal.SIGINT, signal.SIGTERM), self._note_signal)

    def __enter__(self) -> Self:
        self._before, Deadline._present = Deadline._present, self
        self._handled.put()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._handled.put_back()
        Deadline._present = self._before

    def check(self) -> None:
        """Raise EndedEarly where it is time to end; safe from any thread."""
        if self._accepted:
            return
        if not self.reason and time.monotonic() > self._at:
            self.reason = f"{self._seconds:g} s are over"
        if self.reason:
            raise EndedEarly(self.reason)

    def accept(self) -> None:
        """Raise nothing any more: somebody ends with the best so far."""
        self._accepted = True

    def _note_signal(self, number: int, _frame: FrameType | None) -> None:
        if self.reason:
            raise KeyboardInterrupt
        self.reason = signal.Signals(number).name


def checkpoint() -> None:
    """Raise EndedEarly where the present :class:`Deadline` says so; cheap, and safe from any thread."""
    present = Deadline._present
    if present is not None:
        present.check()


def accept() -> None:
    """Let the present :class:`Deadline` raise nothing any more; safe to call without one."""
    if Deadline._present is not None:
        Deadline._present.accept()


class Ending:
    """Context in which SIGINT and SIGTERM set ``due`` instead of ending the process.

    Where standard input is a pipe its end sets it too: a parent that dies closes it. Signals are
    handled only in the main thread; handlers are put back at the end.
    """

    def __init__(self) -> None:
        self.due = False
        self._handled = Handled((signal.SIGINT, signal.SIGTERM), self._note_signal)
        self._pipe = _standard_input_pipe()
        self._rest = b""

    def __enter__(self) -> Self:
        self._handled.put()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._handled.put_back()

    def wait(self, timeout: float, fd: int | None = None) -> bool:
        """Wait up to ``timeout`` s for something to read on ``fd``, and tell whether it came.

        Lines that come in meanwhile are not meant for anybody.
        """
        watched = [*self.watched()] if fd is None else [fd, *self.watched()]
        readable, _, _ = select.select(watched, [], [], max(timeout, 0.0))
        self.hear(readable)
        return fd in readable

    def watched(self) -> list[int]:
        """File descriptors to wait for."""
        return [] if self._pipe is None else [self._pipe]

    def hear(self, readable: Sequence[int]) -> list[str]:
        """Return the lines that came in on those descriptors that are readable."""
        if self._pipe is None or self._pipe not in readable:
            return []
        data = b""
        with contextlib.suppress(OSError):
            data = os.read(self._pipe, 4096)
        if not data:
            self.due = True
            self._pipe = None
            return []
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [line.decode("utf-8", "replace").strip() for line in lines if line.strip()]

    def _note_signal(self, _number: int, _frame: FrameType | None) -> None:
        self.due = True


def _standard_input_pipe() -> int | None:
    try:
        fd = sys.stdin.fileno()
        mode = os.fstat(fd).st_mode
    except (AttributeError, OSError, ValueError):
        return None
    return fd if stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) else None
