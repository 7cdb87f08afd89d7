"""Signals such as Ctrl+C and the emergency stop, in a form that a run polls."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Self

from labhil.bus.latch import read_latch
from labhil.ending import Handled
from labhil.errors import CommandRefusedError, EmergencyStopError, LabhilError


class Interruption:
    """A context that notes SIGINT, SIGTERM and SIGHUP instead of raising.

    A second Ctrl+C thus cannot interrupt the orderly end: bringing devices to their safe state and completing
    the recording. Outside the main thread, where Python handles no signals, it notes nothing. ``reason`` is
    the name of the first signal, or empty.
    """

    def __init__(self) -> None:
        self.reason = ""
        self._handled = Handled((signal.SIGINT, signal.SIGTERM, signal.SIGHUP), self._note)

    def __enter__(self) -> Self:
        self._handled.put()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._handled.put_back()

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.reason = self.reason or signal.Signals(number).name

    def __call__(self) -> bool:
        """Return whether a signal has come."""
        return bool(self.reason)


def raise_emergency_stop() -> None:
    """Raise EmergencyStopError while the emergency stop is pressed; needs neither a device nor the bus."""
    error = _emergency_stop()
    if error is not None:
        raise error


def emergency_stop_or(error: LabhilError | None) -> LabhilError | None:
    """Return the emergency stop where it explains ``error``, otherwise ``error``.

    It does so where there is no error, or a device only refuses because of the stop. Any other error came
    before the stop.
    """
    if error is None or isinstance(error, CommandRefusedError):
        return _emergency_stop() or error
    return error


def reason_of(error: LabhilError) -> str:
    """Return the message of an error, with the emergency stop that holds beside it.

    The reason of a run that another error ended a moment earlier states both: the stop has to be released
    before the next run.
    """
    stop, reason = _emergency_stop(), str(error)
    return reason if stop is None or "emergency stop" in reason else f"{reason}; {stop}"


def _emergency_stop() -> EmergencyStopError | None:
    try:
        latch = read_latch()
    except (LabhilError, OSError):
        return None  # a directory that cannot be read is no stop; hosts read it as well
    return None if latch is None else EmergencyStopError(latch.describe())
