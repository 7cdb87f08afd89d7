"""The approach of a device to the start of its steps, and the rate at which a path is sent to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from labhil.driver import DriverSpec
from labhil.errors import RunError
from labhil.signals import Stream


class Approach:
    """Detects that the signals in ``spec.approach`` are where the steps begin, and that the device is ready.

    Args:
        spec: The declaration of the device.
        stream: Its samples.
        timeout: How long the approach may take, s of the device's clock.
        settling: How long the device has to stay there, s of the device's clock.
    """

    def __init__(
        self, spec: DriverSpec, stream: Stream, *, timeout: float = 60.0, settling: float = 0.1
    ) -> None:
        columns = stream.columns()
        self._timeout = timeout
        self._tolerances = {
            column: (columns.index(column), spec.approach[signal.name])
            for signal in spec.commands
            if signal.name in spec.approach
            for column in signal.columns()
        }
        self._ready = [(name, columns.index(name), value) for name, value in spec.ready.items()]
        self._required_samples = max(1, round(settling * stream.rate))
        self._max_samples = round(timeout * stream.rate)
        self._samples_there = self._samples = 0

    def reset(self) -> None:
        """Begin again, as with the first sample."""
        self._samples_there = self._samples = 0

    def has_arrived(self, setpoints: Mapping[str, float], values: Sequence[float]) -> bool:
        """Take a sample, and return whether the clock of the steps may start.

        Args:
            setpoints: The first setpoint of the steps, by column.
            values: The sample, in the order of the stream's columns.

        Raises:
            RunError: The device did not arrive in time.
        """
        if not self._tolerances:
            return True
        deviation = self._deviation(setpoints, values)
        self._samples_there = 0 if deviation else self._samples_there + 1
        self._samples += 1
        if deviation and self._samples > self._max_samples:
            raise RunError(
                f"the device did not come to where the steps begin within {self._timeout:g} s: {deviation}"
            )
        return self._samples_there >= self._required_samples

    def _deviation(self, setpoints: Mapping[str, float], values: Sequence[float]) -> str:
        """Describe what is not yet as required; empty where all is."""
        for name, index, value in self._ready:
            if values[index] != value:
                return f"{name} is {values[index]:g}, expected {value:g}"
        for column, (index, tolerance) in self._tolerances.items():
            distance = abs(values[index] - setpoints[column]) if column in setpoints else 0.0
            if not distance <= tolerance:
                return f"{column} is {distance:.3g} away"
        return ""


class Waypoints:
    """Schedules setpoints: at ``rate`` Hz of the device's clock, or with every batch where it is 0."""

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self._due_ns: int | None = None

    def reset(self) -> None:
        """Let the next setpoint be due at once."""
        self._due_ns = None

    def is_due(self, t_ns: int) -> bool:
        """Return whether a setpoint is due at ``t_ns`` of the device's clock, and count it as sent."""
        if self.rate == 0.0:
            return True
        if self._due_ns is not None and t_ns < self._due_ns:
            return False
        period = round(1e9 / self.rate)
        # after a gap in the samples the schedule starts again: no burst of late setpoints
        is_late = self._due_ns is None or t_ns - self._due_ns > period
        self._due_ns = t_ns + period if is_late or self._due_ns is None else self._due_ns + period
        return True
