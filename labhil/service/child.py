"""A child process of ours that speaks in lines, and is gone when we are done with it."""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Self

from labhil.errors import BusError
from labhil.supervised import SupervisedThread

STOP_TIMEOUT = 5.0
"""How long a child may take to end once its standard input is closed, s."""
KILL_TIMEOUT = 2.0
"""How long it may take after SIGTERM, s."""
POLL_INTERVAL = 0.05


class Child:
    """One child process; the end of its standard input tells it to end.

    It has a session of its own, so that Ctrl+C in a terminal reaches only us and we take everything
    down in order. If we are killed instead, the end of its standard input still reaches it.
    """

    def __init__(
        self, name: str, arguments: Sequence[str], environment: Mapping[str, str] | None = None
    ) -> None:
        self.name = name
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed in `stop`
        self._process = subprocess.Popen(
            arguments,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            start_new_session=True,
            text=True,
            errors="replace",
            bufsize=1,
            env={**os.environ, **(environment or {})},
        )
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._reader = SupervisedThread(
            self._read_lines, f"lines of {name}", daemon=True, on_failure=lambda: self._lines.put(None)
        )
        self._reader.start()

    def _read_lines(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._take_line(line)
        self._reader.end()  # the child closes its output when it likes
        self._lines.put(None)

    def _take_line(self, line: str) -> None:
        self._lines.put(line.rstrip("\n"))

    def reader_failure(self) -> str:
        """Return why nothing that the child says is heard any more; empty while all is well."""
        return self._reader.failure()

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    def exit_status(self) -> int | None:
        """Return how the process ended (negative: by that signal), or None while it runs."""
        return self._process.poll()

    def send(self, line: str) -> None:
        """Write one line to the child; :meth:`line` notices a child that is gone already."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(line)
            self._process.stdin.flush()

    def line(self, timeout: float, interrupted: Callable[[], bool] = lambda: False) -> str | None:
        """Return the next line; None when the child closed its output or ``interrupted`` turned true.

        Raises BusError when nothing came within ``timeout`` s.
        """
        deadline = time.monotonic() + timeout
        while not interrupted():
            with contextlib.suppress(queue.Empty):
                return self._lines.get(timeout=POLL_INTERVAL)
            if time.monotonic() > deadline:
                raise BusError(f"{self.name} said nothing for {timeout:g} s{self.last_error()}")
        return None

    def next_line(self) -> str:
        """Return the next line if it is there already, else nothing; does not wait."""
        with contextlib.suppress(queue.Empty):
            line = self._lines.get_nowait()
            if line is not None:
                return line
            self._lines.put(None)  # the end is for whoever waits, too
        return ""

    def last_error(self) -> str:
        """Return the last line of what the child wrote to its standard error, for a message of ours."""
        if self._errors.closed:
            return ""
        # pread leaves the offset alone: the child appends at it
        written = os.pread(self._errors.fileno(), 1 << 20, 0)
        text = written.decode(errors="replace").strip()
        return f": {text.splitlines()[-1]}" if text else ""

    def close_input(self) -> None:
        """Tell the child to end, without waiting for it."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def has_ended(self, within: float) -> bool:
        """Whether the child ends within so many s; waits that long at most."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(within)
        return self._process.poll() is not None

    def stop(self, patience: float = STOP_TIMEOUT) -> None:
        """Have the child end and wait for it; SIGTERM after ``patience`` s, then SIGKILL. Safe twice."""
        self.close_input()
        for timeout, then in ((patience, self._process.terminate), (KILL_TIMEOUT, self._process.kill)):
            try:
                self._process.wait(timeout)
                break
            except subprocess.TimeoutExpired:
                then()
        self._process.wait()
        self._reader.join()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._errors.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
