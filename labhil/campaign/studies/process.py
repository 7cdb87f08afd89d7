"""Helper processes that exchange lines of JSON with their parent, and end with it.

Work that takes long or must not be disturbed (a run, a fit) is never done in the process of a screen or a
service. When the parent dies, the end of its standard input makes a helper end.
"""

from __future__ import annotations

import contextlib
import json
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from labhil.errors import BusError
from labhil.service.child import Child
from labhil.supervised import SupervisedThread
from labhil.terminal import show

OnLine = Callable[[dict[str, Any]], object]
LISTEN = 1.0
PATIENCE = 30.0
"""How long a process may take to end in order before it is ended by force, s."""


class Helper:
    """A process ``python -m module``.

    Args:
        name: of the process, for messages.
        module: the module to run.
        request: the first line for the process.
        on_line: is called with each line that the process writes, in another thread. The last is ``{"ended":
            status}`` with ``complaint``, the end of its stderr. Where it raises, the process is ended.
    """

    def __init__(self, name: str, module: str, request: Mapping[str, Any], on_line: OnLine) -> None:
        self._on_line = on_line
        self._child = Child(name, [sys.executable, "-P", "-m", module])
        self.send(request)
        self._ended = threading.Event()
        self._thread = SupervisedThread(self._listen, f"listen to {name}", on_failure=self._give_up)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the process has not ended yet."""
        return not self._ended.is_set()

    def send(self, line: Mapping[str, Any]) -> None:
        """Send a line; a process that has ended does not get it."""
        with contextlib.suppress(ValueError):  # its input was closed before
            self._child.send(json.dumps(line) + "\n")

    def close(self, patience: float = PATIENCE) -> None:
        """End the process: in order within ``patience`` s, else by force. May be called again."""
        self._child.close_input()
        self._ended.wait(patience)
        self._child.stop()
        self._thread.join()

    def _listen(self) -> None:
        while True:
            try:
                line = self._child.line(LISTEN)
            except BusError:  # no line yet
                continue
            if line is None:
                break
            message = _parse(line)
            if message is not None:
                self._on_line(message)
        # the output of a process ends slightly before the process
        deadline = time.monotonic() + LISTEN
        while (status := self._child.exit_status()) is None and time.monotonic() < deadline:
            time.sleep(0.01)
        complaint = self._child.last_error()
        self._thread.end()
        self._say_ended(status, complaint.removeprefix(": "))

    def _give_up(self) -> None:
        """End the process in order, since nobody reads its lines."""
        self._child.close_input()
        with contextlib.suppress(Exception):  # ``on_line`` is often the cause of the failure
            self._say_ended(None, self._thread.failure())

    def _say_ended(self, status: int | None, complaint: str) -> None:
        """Say the last line; whoever sees that nothing runs any more has it already."""
        try:
            self._on_line({"ended": status, "complaint": complaint})
        finally:
            self._ended.set()


def write_line(line: Mapping[str, Any]) -> None:
    """Write a line to the parent process, from within a helper; nothing happens where the parent is gone."""
    try:
        show(json.dumps(line, allow_nan=False))
    except OSError:
        return


def read_request() -> dict[str, Any]:
    """Read the request in the first line, from within a helper."""
    return dict(json.loads(sys.stdin.readline()))


def read_further_lines(take: OnLine, end: Callable[[], None]) -> None:
    """Read further lines in another thread, from within a helper.

    Args:
        take: is called with each line.
        end: is called at the end of the input.
    """

    def listen() -> None:
        try:
            for line in sys.stdin:
                message = _parse(line)
                if message is not None:
                    take(message)
        finally:  # a helper without input must not continue
            end()

    threading.Thread(target=listen, name="listen to the parent", daemon=True).start()


def _parse(line: str) -> dict[str, Any] | None:
    try:
        message = json.loads(line)
    except ValueError:
        return None
    return message if isinstance(message, dict) else None
