"""Client of the controller's dashboard server: one answer line per line."""

from __future__ import annotations

import contextlib
import socket
from types import TracebackType
from typing import Self

from labhil.errors import ConnectError

PORT = 29999
TIMEOUT = 2.0


class Dashboard:
    """A connection to the dashboard of a controller.

    Args:
        host: Address of the controller.
        timeout: Longest time of an answer, s.

    Raises:
        ConnectError: No dashboard answers.
    """

    def __init__(self, host: str, timeout: float = TIMEOUT) -> None:
        self.host = host
        try:
            self._socket = socket.create_connection((host, PORT), timeout)
        except OSError as error:
            raise ConnectError(
                f"{host}: expected a UR controller's dashboard on port {PORT}, found: {error}; it is enabled"
                " under Security → Services"
            ) from error
        self._lines = self._socket.makefile("rb")
        with contextlib.suppress(ConnectError):
            self._line()

    def ask(self, line: str) -> str:
        """Send a line and return the answer.

        Raises:
            ConnectError: There is no answer.
        """
        try:
            self._socket.sendall(line.encode() + b"\n")
        except OSError as error:
            raise ConnectError(f"{self.host}: the dashboard is gone: {error}") from error
        return self._line()

    def _line(self) -> str:
        try:
            line = self._lines.readline(4096)
        except OSError as error:
            raise ConnectError(f"{self.host}: the dashboard did not answer: {error}") from error
        return line.decode("utf-8", "replace").strip()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lines.close()
        self._socket.close()


def stop_program(host: str, timeout: float = 0.5) -> None:
    """Stop the program that moves the arm, if there is one. Never raises."""
    with contextlib.suppress(ConnectError), Dashboard(host, timeout) as dashboard:
        dashboard.ask("stop")


def serial_number(host: str) -> str:
    """Return the serial number of the controller, or "unknown". Never raises."""
    try:
        with Dashboard(host) as dashboard:
            number = dashboard.ask("get serial number")
    except ConnectError:
        return "unknown"
    return number if number.isdigit() else "unknown"
