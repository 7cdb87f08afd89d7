"""Ctrl+C and its relatives, and the emergency stop, as something that a run looks at when it is ready to."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Self

from labhil.bus.latch import read_latch
from labhil.ending import Handled
from labhil.errors import CommandRefusedError, EmergencyStopError, LabhilError


class Interruption:
    """Context in which SIGINT, SIGTERM and SIGHUP are noted instead of breaking in.

    A second Ctrl+C thus cannot cut short what the first one set off: bringing devices to their safe
    state and finishing the recording. Outside the main thread, where Python handles no signals, it
    notes nothing. ``reason`` is the name of the first signal, or empty.
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
        """Whether it is time to stop."""
        return bool(self.reason)


def raise_standing_stop() -> None:
    """Raise EmergencyStopError where an emergency stop stands, heard without any device or the bus."""
    standing = _standing()
    if standing is not None:
        raise standing


def in_place_of(error: LabhilError | None) -> LabhilError | None:
    """Return the emergency stop that stands, where nothing failed or a device only refuses because of it.

    Any other ``error`` came before the stop, and is returned as it is.
    """
    if error is None or isinstance(error, CommandRefusedError):
        return _standing() or error
    return error


def reason_of(error: LabhilError) -> str:
    """Return what an error says, with the emergency stop that stands beside it.

    A run that something else has ended a moment before states both: the stop has to be released before the
    next.
    """
    standing, reason = _standing(), str(error)
    return reason if standing is None or "emergency stop" in reason else f"{reason}; {standing}"


def _standing() -> EmergencyStopError | None:
    try:
        standing = read_latch()
    except (LabhilError, OSError):
        return None  # a directory that cannot be read is no stop; hosts look there as well
    return None if standing is None else EmergencyStopError(standing.describe())
