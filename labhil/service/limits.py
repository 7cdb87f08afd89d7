"""The ``[limits]`` of a rig file, applied to outgoing commands and checked on incoming samples.

Commands are also kept within what the device takes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from labhil.errors import CommandRefusedError, UnknownNameError
from labhil.rig_sections import Limit
from labhil.signals import Batch, Signal, Stream

COMMAND_MARGIN = 0.01
"""Share of its span by which samples of a commanded signal may exceed its limits: converters round."""

NO_LIMIT = Limit()
NO_RANGE = (-inf, inf)


@dataclass(frozen=True, slots=True)
class _Bounds:
    """What a command may be, and its largest rate of change per second."""

    low: float
    high: float
    rate: float


class CommandLimits:
    """Keeps commands within their limits and the range of the device; others pass unchanged.

    The columns of a vector have the limits of the vector, or their own where the rig file gives them.

    Args:
        commands: The commands of the device.
        limits: The limits of the rig file, by signal or column.
        ranges: Lowest and highest values that the device takes, by signal or column.
    """

    def __init__(
        self,
        commands: tuple[Signal, ...],
        limits: Mapping[str, Limit],
        ranges: Mapping[str, tuple[float, float]],
    ) -> None:
        self._bounds: dict[str, _Bounds] = {}
        for signal in commands:
            for column in signal.columns():
                limit = limits.get(column, limits.get(signal.name, NO_LIMIT))
                low, high = ranges.get(column, ranges.get(signal.name, NO_RANGE))
                self._bounds[column] = _Bounds(max(limit.min, low), min(limit.max, high), limit.rate)

    def range_of(self, name: str) -> tuple[float, float]:
        """Return the lowest and highest value of a command (a column), infinite where none is stated."""
        bounds = self._bounds[name]
        return bounds.low, bounds.high

    def clip(self, name: str, value: float, previous: float | None, elapsed: float) -> float:
        """Clip a command to min and max, and to ``rate``·``elapsed`` around the previous command.

        Args:
            name: The column.
            value: The requested value; it must be finite.
            previous: The value that was sent before; None where there was none.
            elapsed: Time since then, s of the device's clock.
        """
        bounds = self._bounds[name]
        reach = bounds.rate * elapsed if elapsed > 0 else 0.0
        if isfinite(bounds.rate) and previous is not None:
            value = min(max(value, previous - reach), previous + reach)
        return min(max(value, bounds.low), bounds.high)

    def refuse_unusable(self, values: Mapping[str, float]) -> None:
        """Raise CommandRefusedError for an unknown command or a value that is not finite."""
        for name, value in values.items():
            if name not in self._bounds:
                raise CommandRefusedError(str(UnknownNameError("command", name, self._bounds)))
            if not isfinite(value):
                raise CommandRefusedError(f"{name}: expected a finite number, found {value}")

    def refuse_beyond(self, values: Mapping[str, float]) -> None:
        """Raise CommandRefusedError for an unusable value, or one beyond min or max."""
        self.refuse_unusable(values)
        for name, value in values.items():
            bounds = self._bounds[name]
            if not bounds.low <= value <= bounds.high:
                raise CommandRefusedError(
                    f"{name}: {value:g} is outside its limits, {bounds.low:g} to {bounds.high:g}"
                )


class SampleLimits:
    """Checks every sample of a stream; NaN in a limited signal is outside its limits.

    Args:
        stream: The samples of the device.
        commands: Its commands, which get a margin for rounding.
        limits: The limits of the rig file, by signal or column.
    """

    def __init__(self, stream: Stream, commands: tuple[Signal, ...], limits: Mapping[str, Limit]) -> None:
        self._stream = stream
        self._low = np.full(stream.width, -np.inf)
        self._high = np.full(stream.width, np.inf)
        self._checked = np.zeros(stream.width, dtype=np.bool_)
        commanded = {signal.name for signal in commands}
        for signal in stream.signals:
            limit = limits.get(signal.name)
            columns = stream.columns_of(signal.name)
            if limit is not None:
                self._add(columns, limit, signal.name in commanded)
            for number, column in enumerate(signal.columns() if signal.width > 1 else ()):
                if column in limits:
                    single = slice(columns.start + number, columns.start + number + 1)
                    self._add(single, limits[column], signal.name in commanded)

    def _add(self, columns: slice, limit: Limit, commanded: bool) -> None:
        span = limit.max - limit.min
        margin = COMMAND_MARGIN * span if commanded and isfinite(span) else 0.0
        self._low[columns] = limit.min - margin
        self._high[columns] = limit.max + margin
        self._checked[columns] = True

    def violation(self, batch: Batch) -> str | None:
        """Describe the first sample outside the limits; None where all are inside."""
        values = batch.values
        outside = ~((values >= self._low) & (values <= self._high)) & self._checked
        if not outside.any():
            return None
        row, column = (int(i) for i in np.argwhere(outside)[0])
        name = self._stream.columns()[column]
        reading, low, high = float(values[row, column]), self._low[column], self._high[column]
        return f"{name} = {reading:.6g} left its limits, {low:g} to {high:g} (sample {int(batch.seq[row])})"
