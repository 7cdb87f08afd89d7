"""Host processes, seen from the process that starts them."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from labhil import errors
from labhil.bus.publish import LONGEST_DELIVERY
from labhil.documents import parse_json
from labhil.errors import BusError, LabhilError, RunStoppedError
from labhil.service.child import STOP_TIMEOUT, Child
from labhil.service.messages import HostConfig
from labhil.signals import Signal, Stream

CONNECT_TIMEOUT = 30.0
"""How long a host may take to connect to its device or say why it cannot, s."""


@dataclass(frozen=True, slots=True)
class ConnectedDevice:
    """What a host reports once its device is there."""

    stream: Stream
    safe: Mapping[str, float]
    speed: float
    firmware: str
    serial: str


class HostProcess:
    """One device's host: started at once, connected by :meth:`wait_connected`, ended by :meth:`stop`."""

    def __init__(self, config: HostConfig) -> None:
        self.config = config
        self._child = Child(
            f"the host of {config.device!r}", [sys.executable, "-P", "-m", "labhil.service.host"]
        )
        self.absent = ""
        """Why the device is not there, as long as its host looks for it."""
        self._child.send(config.to_line())

    @property
    def pid(self) -> int:
        """The process id."""
        return self._child.pid

    def wait_connected(self, interrupted: Callable[[], bool] = lambda: False) -> ConnectedDevice:
        """Wait for the device; raises what the driver raised, or RunStoppedError when ``interrupted``."""
        device = self.wait_or_absent(interrupted)
        while device is None:
            device = self.wait_or_absent(interrupted)
        return device

    def wait_or_absent(self, interrupted: Callable[[], bool] = lambda: False) -> ConnectedDevice | None:
        """The same; None when a patient host says that it looks for the device (why: ``absent``)."""
        line = self._child.line(CONNECT_TIMEOUT, interrupted)
        if line is None and interrupted():
            raise RunStoppedError("stopped while the devices were being connected")
        message = _parse(line)
        if "waiting" in message:
            self.absent = str(message["waiting"])
            return None
        return self._device_in(message)

    def has_come(self) -> bool:
        """Whether a device that was absent is there now; does not wait. Raises what its host ended with."""
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
        """Return why the host ended, when it ended without an order; None while it runs."""
        if self._child.exit_status() is None:
            deaf = self._child.reader_failure()
            return BusError(f"{self._child.name} is not heard any more: {deaf}") if deaf else None
        return self._ending_error(self._last_message())

    def _ending_error(self, message: Mapping[str, Any]) -> LabhilError:
        ended = message.get("ended")
        if deaf := self._child.reader_failure():
            return BusError(f"{self._child.name} is not heard any more: {deaf}")
        if ended is not None and ended["error"] is not None:
            return error_named(ended["error"], f"{self.config.device}: {ended['reason']}")
        if ended is not None:
            return BusError(f"{self._child.name} ended: {ended['reason']}")
        status = self._child.exit_status()
        how = f" ({signal.Signals(-status).name})" if status is not None and status < 0 else ""
        return BusError(f"{self._child.name} died{how}{self._child.last_error()}")

    def request_end(self) -> None:
        """Let the host bring its device to safety and end, without waiting for it."""
        self._child.close_input()

    def stop(self) -> None:
        """End the host and wait until it is gone. Safe twice.

        One whose device is safe has time until recorders have received all that it published.
        """
        self._child.close_input()
        is_slow = not self._child.has_ended(STOP_TIMEOUT)
        self._child.stop(LONGEST_DELIVERY if is_slow and self._is_delivering() else 0.0)

    def _is_delivering(self) -> bool:
        """Whether the host has said that its device is safe, and only what it published is left to do."""
        while line := self._child.next_line():
            if "delivering" in _parse(line):
                return True
        return False

    def _last_message(self) -> dict[str, Any]:
        """What the host said in the end; nothing where it was killed."""
        message = _parse(self._child.line(1.0))
        return _parse(self._child.line(1.0)) if "delivering" in message else message


def error_named(name: str, message: str) -> LabhilError:
    """Return the error of our tree that bears ``name``; BusError when there is none that says a message."""
    kind = getattr(errors, name, None)
    if isinstance(kind, type) and issubclass(kind, LabhilError):
        try:
            return kind(message)
        except TypeError:  # those that build their own message take more than one argument
            return errors.UsageError(message)
    return BusError(message)


def _parse(line: str | None) -> dict[str, Any]:
    try:
        data = parse_json(line or "{}")
    except ValueError:
        return {}
    return data if isinstance(data, dict) else {}
