"""What a rig file's ``[limits]`` allow, for commands on their way out and samples on their way in."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite

import numpy as np

from labhil.errors import CommandRefusedError, UnknownNameError
from labhil.rig_sections import Limit
from labhil.signals import Batch, Signal, Stream

COMMAND_MARGIN = 0.01
"""Share of its span by which a commanded signal's sample may pass its limits: pulses and converters round."""

NO_LIMIT = Limit()


class CommandLimits:
    """Keeps commands within their limits; a signal without limits passes as it is, if it is finite.

    A vector's columns have the vector's limits, or their own where the rig file gives them.
    """

    def __init__(self, commands: tuple[Signal, ...], limits: Mapping[str, Limit]) -> None:
        self._limits = {
            column: limits.get(column, limits.get(signal.name, NO_LIMIT))
            for signal in commands
            for column in signal.columns()
        }

    def clip(self, name: str, value: float, before: float | None, elapsed: float) -> float:
        """Return ``value`` within min, max, and within ``rate``·``elapsed`` of the value ``before``.

        ``elapsed`` is s of the device's clock since ``before`` was sent; None when nothing was. The value
        must be finite.
        """
        limit = self._limits[name]
        reach = limit.rate * elapsed if elapsed > 0 else 0.0
        if isfinite(limit.rate) and before is not None:
            value = min(max(value, before - reach), before + reach)
        return min(max(value, limit.min), limit.max)

    def refuse_unusable(self, values: Mapping[str, float]) -> None:
        """Raise CommandRefusedError for a signal that cannot be commanded or a value that is no number."""
        for name, value in values.items():
            if name not in self._limits:
                raise CommandRefusedError(str(UnknownNameError("command", name, self._limits)))
            if not isfinite(value):
                raise CommandRefusedError(f"{name}: expected a finite number, found {value}")

    def refuse_beyond(self, values: Mapping[str, float]) -> None:
        """Raise CommandRefusedError for a value beyond min or max, besides the unusable ones."""
        self.refuse_unusable(values)
        for name, value in values.items():
            limit = self._limits[name]
            if not limit.min <= value <= limit.max:
                raise CommandRefusedError(
                    f"{name}: {value:g} is outside its limits, {limit.min:g} to {limit.max:g}"
                )


class SampleLimits:
    """Looks at every sample of a stream; a limited signal that is not a number is outside its limits."""

    def __init__(self, stream: Stream, commands: tuple[Signal, ...], limits: Mapping[str, Limit]) -> None:
        self._stream = stream
        self._low = np.full(stream.width, -np.inf)
        self._high = np.full(stream.width, np.inf)
        self._checked = np.zeros(stream.width, dtype=np.bool_)
        commanded = {signal.name for signal in commands}
        for signal in stream.signals:
            limit = limits.get(signal.name)
            place = stream.columns_of(signal.name)
            if limit is not None:
                self._add(place, limit, signal.name in commanded)
            for number, column in enumerate(signal.columns() if signal.width > 1 else ()):
                if column in limits:
                    one = slice(place.start + number, place.start + number + 1)
                    self._add(one, limits[column], signal.name in commanded)

    def _add(self, columns: slice, limit: Limit, commanded: bool) -> None:
        span = limit.max - limit.min
        margin = COMMAND_MARGIN * span if commanded and isfinite(span) else 0.0
        self._low[columns] = limit.min - margin
        self._high[columns] = limit.max + margin
        self._checked[columns] = True

    def violation(self, batch: Batch) -> str | None:
        """Return what the first sample outside the limits did, in words; None when all are inside."""
        values = batch.values
        outside = ~((values >= self._low) & (values <= self._high)) & self._checked
        if not outside.any():
            return None
        row, column = (int(i) for i in np.argwhere(outside)[0])
        name = self._stream.columns()[column]
        reading, low, high = float(values[row, column]), self._low[column], self._high[column]
        return f"{name} = {reading:.6g} left its limits, {low:g} to {high:g} (sample {int(batch.seq[row])})"
