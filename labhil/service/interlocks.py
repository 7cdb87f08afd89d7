"""The interlocks of a rig file, checked at every sample; while one has tripped, commands are refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labhil.rig_sections import Interlock
from labhil.signals import Batch, FloatArray, Stream


@dataclass(frozen=True, slots=True)
class Tripped:
    """An interlock that has tripped: the message, and what a run has to do (``then``)."""

    message: str
    then: str


class Interlocks:
    """Checks every sample; an interlock that trips stays so until its signal is inside ``resume_…`` again.

    At the start every interlock counts as tripped until a sample shows its signal inside. NaN trips.

    Args:
        stream: The samples of the device.
        interlocks: The interlocks of the rig file, by signal.
    """

    def __init__(self, stream: Stream, interlocks: Mapping[str, Interlock]) -> None:
        self._stream = stream
        self._interlocks = {name: interlocks[name] for name in interlocks if name in stream.names()}
        self._standing = {name: _unseen_message(name, lock) for name, lock in self._interlocks.items()}
        self._seen = False

    def take_in(self, batch: Batch) -> Tripped | None:
        """Check samples, oldest first; return the first interlock that tripped, if one did."""
        tripped: Tripped | None = None
        for name, interlock in self._interlocks.items():
            values = batch.values[:, self._stream.columns_of(name)]
            message = self._standing.get(name) or _trip_message(name, interlock, values)
            if message is not None and name not in self._standing:
                tripped = tripped or Tripped(message, interlock.then)
                self._standing[name] = message
            if bool(((values[-1] >= interlock.resume_low) & (values[-1] <= interlock.resume_high)).all()):
                self._standing.pop(name, None)
            elif not self._seen and name in self._standing:
                self._standing[name] = _standing_message(name, interlock, values[-1])
        self._seen = True
        return tripped

    def standing(self) -> str | None:
        """Return the message of an interlock that has tripped; None where none has."""
        return next(iter(self._standing.values()), None)


def _trip_message(name: str, interlock: Interlock, values: FloatArray) -> str | None:
    high = np.inf if interlock.trip_above is None else interlock.trip_above
    low = -np.inf if interlock.trip_below is None else interlock.trip_below
    outside = ~((values >= low) & (values <= high))
    if not outside.any():
        return None
    return f"interlock: {name} = {values[outside][0]:.6g} tripped, {'; '.join(format_thresholds(interlock))}"


def _standing_message(name: str, interlock: Interlock, value: FloatArray) -> str:
    numbers = ", ".join(f"{x:.6g}" for x in value)
    return f"interlock: {name} = {numbers} stands where it may not, {'; '.join(format_thresholds(interlock))}"


def _unseen_message(name: str, interlock: Interlock) -> str:
    return f"interlock: {name} has not been seen yet, {'; '.join(format_thresholds(interlock))}"


def format_thresholds(interlock: Interlock) -> list[str]:
    """Describe the thresholds of an interlock, one phrase for each side."""
    phrases = []
    if interlock.trip_above is not None:
        phrases.append(f"trips above {interlock.trip_above:g} until below {interlock.resume_high:g}")
    if interlock.trip_below is not None:
        phrases.append(f"trips below {interlock.trip_below:g} until above {interlock.resume_low:g}")
    return phrases
