"""A child process that communicates in lines and ends with its parent."""

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
    """A child process; the end of its standard input is the request to end.

    It has a session of its own, so that Ctrl+C in a terminal reaches only its parent, which ends everything
    in order. Where the parent is killed, the end of its standard input still reaches the child.

    Args:
        name: What it is, for messages.
        arguments: The command line.
        environment: Environment variables that are added to those of this process.
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
        self._reader.end()  # a child may close its output at any time: that is no failure
        self._lines.put(None)

    def _take_line(self, line: str) -> None:
        self._lines.put(line.rstrip("\n"))

    def reader_failure(self) -> str:
        """Return why the output of the child is not read any more; empty while it is."""
        return self._reader.failure()

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    def exit_status(self) -> int | None:
        """Return the exit status of the process (negative: number of a signal), or None while it runs."""
        return self._process.poll()

    def send(self, line: str) -> None:
        """Write one line to the child; :meth:`line` reports a child that has ended already."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(line)
            self._process.stdin.flush()

    def line(self, timeout: float, interrupted: Callable[[], bool] = lambda: False) -> str | None:
        """Wait for the next line; None where the child closed its output, or after an interruption.

        Args:
            timeout: Longest wait, s.
            interrupted: Whether to stop waiting.

        Raises:
            BusError: No line came in time.
        """
        deadline = time.monotonic() + timeout
        while not interrupted():
            with contextlib.suppress(queue.Empty):
                return self._lines.get(timeout=POLL_INTERVAL)
            if time.monotonic() > deadline:
                raise BusError(f"{self.name} said nothing for {timeout:g} s{self.last_error()}")
        return None

    def next_line(self) -> str:
        """Return the next line if there is one already, otherwise an empty text; does not wait."""
        with contextlib.suppress(queue.Empty):
            line = self._lines.get_nowait()
            if line is not None:
                return line
            self._lines.put(None)  # keep the end for a later call of `line`
        return ""

    def last_error(self) -> str:
        """Return ": " and the last line that the child wrote to standard error; empty where there is none."""
        if self._errors.closed:
            return ""
        # pread does not move the offset, at which the child appends
        written = os.pread(self._errors.fileno(), 1 << 20, 0)
        text = written.decode(errors="replace").strip()
        return f": {text.splitlines()[-1]}" if text else ""

    def close_input(self) -> None:
        """Request the child to end; does not wait for it."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def has_ended(self, within: float) -> bool:
        """Wait up to ``within`` s for the child to end, and return whether it has."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(within)
        return self._process.poll() is not None

    def stop(self, patience: float = STOP_TIMEOUT) -> None:
        """End the child and wait for it: SIGTERM after ``patience`` s, then SIGKILL; safe to call twice."""
        self.close_input()
        for timeout, escalate in ((patience, self._process.terminate), (KILL_TIMEOUT, self._process.kill)):
            try:
                self._process.wait(timeout)
                break
            except subprocess.TimeoutExpired:
                escalate()
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
