"""Host processes as the process that starts them sees them; ``host.py`` is the other side."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from labhil import errors
from labhil.bus.publish import DELIVERY_TIMEOUT
from labhil.documents import parse_json
from labhil.errors import BusError, LabhilError, RunStoppedError
from labhil.service.child import STOP_TIMEOUT, Child
from labhil.service.messages import HostConfig
from labhil.signals import Signal, Stream

CONNECT_TIMEOUT = 30.0
"""How long a host may take to connect to its device or to report why it cannot, s."""


@dataclass(frozen=True, slots=True)
class ConnectedDevice:
    """What a host reports of its device once it is connected."""

    stream: Stream
    safe: Mapping[str, float]
    speed: float
    firmware: str
    serial: str


class HostProcess:
    """The host of one device: started by the constructor, ended by :meth:`stop`."""

    def __init__(self, config: HostConfig) -> None:
        self.config = config
        self._child = Child(
            f"the host of {config.device!r}", [sys.executable, "-P", "-m", "labhil.service.host"]
        )
        self.absent = ""
        """Why the device is absent, as long as its host searches for it; empty where it is connected."""
        self._child.send(config.to_line())

    @property
    def pid(self) -> int:
        """The process id."""
        return self._child.pid

    def wait_connected(self, interrupted: Callable[[], bool] = lambda: False) -> ConnectedDevice:
        """Wait until the device is connected.

        Raises:
            LabhilError: The error of the driver.
            RunStoppedError: ``interrupted`` returned true.
        """
        device = self.wait_reported(interrupted)
        while device is None:
            device = self.wait_reported(interrupted)
        return device

    def wait_reported(self, interrupted: Callable[[], bool] = lambda: False) -> ConnectedDevice | None:
        """Wait until the host reports; None where it searches for an absent device (see ``absent``)."""
        line = self._child.line(CONNECT_TIMEOUT, interrupted)
        if line is None and interrupted():
            raise RunStoppedError("stopped while the devices were being connected")
        message = _parse(line)
        if "waiting" in message:
            self.absent = str(message["waiting"])
            return None
        return self._device_in(message)

    def has_connected(self) -> bool:
        """Return whether an absent device is connected now; raises the error with which its host ended."""
        line = self._child.next_line()
        if not line:
            return False
        self._device_in(_parse(line))
        self.absent = ""
        return True

    def _device_in(self, message: Mapping[str, Any]) -> ConnectedDevice:
        if "ready" not in message:
            raise self._ending_error(message)
        ready = message["ready"]
        stream = ready["stream"]
        signals = tuple(Signal.from_json(item) for item in stream["signals"])
        return ConnectedDevice(
            Stream(stream["name"], signals, stream["rate"]),
            ready["safe"],
            ready["speed"],
            ready["firmware"],
            ready["serial"],
        )

    def failure(self) -> LabhilError | None:
        """Return why the host ended without a request; None while it runs."""
        if self._child.exit_status() is None:
            fault = self._child.reader_failure()
            return BusError(f"{self._child.name} is not heard any more: {fault}") if fault else None
        return self._ending_error(self._last_message())

    def _ending_error(self, message: Mapping[str, Any]) -> LabhilError:
        ending = message.get("ended")
        if fault := self._child.reader_failure():
            return BusError(f"{self._child.name} is not heard any more: {fault}")
        if ending is not None and ending["error"] is not None:
            return error_named(ending["error"], f"{self.config.device}: {ending['reason']}")
        if ending is not None:
            return BusError(f"{self._child.name} ended: {ending['reason']}")
        status = self._child.exit_status()
        cause = f" ({signal.Signals(-status).name})" if status is not None and status < 0 else ""
        return BusError(f"{self._child.name} died{cause}{self._child.last_error()}")

    def request_end(self) -> None:
        """Request the host to bring its device to its safe state and to end; does not wait."""
        self._child.close_input()

    def stop(self) -> None:
        """End the host and wait until it has ended; safe to call twice.

        A host whose device is safe gets more time, until recorders have received all that it published.
        """
        self._child.close_input()
        is_slow = not self._child.has_ended(STOP_TIMEOUT)
        self._child.stop(DELIVERY_TIMEOUT if is_slow and self._is_delivering() else 0.0)

    def _is_delivering(self) -> bool:
        """Return whether the host has reported that its device is safe and it waits only for recorders."""
        while line := self._child.next_line():
            if "delivering" in _parse(line):
                return True
        return False

    def _last_message(self) -> dict[str, Any]:
        """Return the last message of the host; empty where it was killed."""
        message = _parse(self._child.line(1.0))
        return _parse(self._child.line(1.0)) if "delivering" in message else message


def error_named(name: str, message: str) -> LabhilError:
    """Return the error of class ``name`` in :mod:`labhil.errors`; BusError where there is no such class."""
    kind = getattr(errors, name, None)
    if isinstance(kind, type) and issubclass(kind, LabhilError):
        try:
            return kind(message)
        except TypeError:  # an error that builds its message takes more than one argument
            return errors.UsageError(message)
    return BusError(message)


def _parse(line: str | None) -> dict[str, Any]:
    try:
        data = parse_json(line or "{}")
    except ValueError:
        return {}
    return data if isinstance(data, dict) else {}
