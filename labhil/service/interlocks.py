"""What a rig file's ``[interlocks]`` hold against commanding a device, sample by sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labhil.rig_sections import Interlock
from labhil.signals import Batch, FloatArray, Stream


@dataclass(frozen=True, slots=True)
class Tripped:
    """One interlock has tripped: what it saw, and what a run is to do."""

    message: str
    then: str


class Interlocks:
    """Looks at every sample; an interlock that trips stands until its signal is inside ``resume_…`` again.

    At the start each stands until a sample has shown that its signal is there. A signal that is not a
    number trips.
    """

    def __init__(self, stream: Stream, interlocks: Mapping[str, Interlock]) -> None:
        self._stream = stream
        self._locks = {name: lock for name, lock in interlocks.items() if name in stream.names()}
        self._standing = {name: _unseen_message(name, lock) for name, lock in self._locks.items()}
        self._seen = False

    def take_in(self, batch: Batch) -> Tripped | None:
        """Look at samples, oldest first; returns the first interlock that tripped in them, if one did."""
        tripped: Tripped | None = None
        for name, lock in self._locks.items():
            values = batch.values[:, self._stream.columns_of(name)]
            message = self._standing.get(name) or _trip(name, lock, values)
            if message is not None and name not in self._standing:
                tripped = tripped or Tripped(message, lock.then)
                self._standing[name] = message
            if bool(((values[-1] >= lock.resume_low) & (values[-1] <= lock.resume_high)).all()):
                self._standing.pop(name, None)
            elif not self._seen and name in self._standing:
                self._standing[name] = _standing_message(name, lock, values[-1])
        self._seen = True
        return tripped

    def standing(self) -> str | None:
        """Return what stands, in words; None when nothing does."""
        return next(iter(self._standing.values()), None)


def _trip(name: str, lock: Interlock, values: FloatArray) -> str | None:
    high = np.inf if lock.trip_above is None else lock.trip_above
    low = -np.inf if lock.trip_below is None else lock.trip_below
    outside = ~((values >= low) & (values <= high))
    if not outside.any():
        return None
    return f"interlock: {name} = {values[outside][0]:.6g} tripped, {_thresholds(lock)}"


def _standing_message(name: str, lock: Interlock, value: FloatArray) -> str:
    numbers = ", ".join(f"{x:.6g}" for x in value)
    return f"interlock: {name} = {numbers} stands where it may not, {_thresholds(lock)}"


def _unseen_message(name: str, lock: Interlock) -> str:
    return f"interlock: {name} has not been seen yet, {_thresholds(lock)}"


def _thresholds(lock: Interlock) -> str:
    parts = []
    if lock.trip_above is not None:
        parts.append(f"trips above {lock.trip_above:g} until below {lock.resume_high:g}")
    if lock.trip_below is not None:
        parts.append(f"trips below {lock.trip_below:g} until above {lock.resume_low:g}")
    return "; ".join(parts)
