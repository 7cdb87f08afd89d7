"""A process that works for another one: lines of JSON out, lines of JSON in, gone when it is not needed.

What takes long or must not be disturbed (a run, a fit) never happens in the process of a screen or of a
service. Where that dies, for whatever reason, the end of its standard input makes such a process end.
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
    """``python -m module`` with a request in its first line.

    ``on_line`` gets each line that it writes, in a thread of its own; the last is ``{"ended": status}``
    with ``complaint``, the end of what it wrote to stderr. A process that is not heard any more is ended.
    """

    def __init__(self, name: str, module: str, request: Mapping[str, Any], on_line: OnLine) -> None:
        self._on_line = on_line
        self._child = Child(name, [sys.executable, "-P", "-m", module])
        self.tell(request)
        self._ended = threading.Event()
        self._thread = SupervisedThread(self._listen, f"listen to {name}", on_failure=self._give_up)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return not self._ended.is_set()

    def tell(self, line: Mapping[str, Any]) -> None:
        """Send a line; a process that has ended does not get it."""
        with contextlib.suppress(ValueError):  # its input was closed before
            self._child.send(json.dumps(line) + "\n")

    def close(self, patience: float = PATIENCE) -> None:
        """End it: in order if it can within ``patience`` s, else by force. Safe twice."""
        self._child.close_input()
        self._ended.wait(patience)
        self._child.stop()
        self._thread.join()

    def _listen(self) -> None:
        while True:
            try:
                line = self._child.line(LISTEN)
            except BusError:  # no line for the moment
                continue
            if line is None:
                break
            message = _parse(line)
            if message is not None:
                self._on_line(message)
        # its output has ended, which it does a moment before the process itself
        deadline = time.monotonic() + LISTEN
        while (status := self._child.exit_status()) is None and time.monotonic() < deadline:
            time.sleep(0.01)
        complaint = self._child.last_error()
        self._thread.end()
        self._ended.set()
        self._on_line({"ended": status, "complaint": complaint.removeprefix(": ")})

    def _give_up(self) -> None:
        """End the process in order: nobody hears what it says."""
        self._child.close_input()
        self._ended.set()
        with contextlib.suppress(Exception):  # what it raised is often why nobody hears
            self._on_line({"ended": None, "complaint": self._thread.failure()})


def say(line: Mapping[str, Any]) -> None:
    """Write a line, from within a helper; it is dropped where the parent process is gone."""
    try:
        show(json.dumps(line, allow_nan=False))
    except OSError:
        return


def read_request() -> dict[str, Any]:
    """The request in a helper's first line."""
    return dict(json.loads(sys.stdin.readline()))


def on_further_lines(take: OnLine, end: Callable[[], None]) -> None:
    """In a helper: call ``take`` with each further line, and ``end`` when there will be none."""

    def listen() -> None:
        try:
            for line in sys.stdin:
                message = _parse(line)
                if message is not None:
                    take(message)
        finally:  # a helper without input must not go on by itself
            end()

    threading.Thread(target=listen, name="listen to who asked", daemon=True).start()


def _parse(line: str) -> dict[str, Any] | None:
    try:
        message = json.loads(line)
    except ValueError:
        return None
    return message if isinstance(message, dict) else None
