"""The output of a host: requested commands, clipped to the limits, sent to the device and recorded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from labhil.driver import Driver, FaultReportingDriver, TimedDriver
from labhil.host_clock import unix_ns
from labhil.rig_sections import Limit
from labhil.service.declared import safe_values
from labhil.service.limits import CommandLimits
from labhil.signals import Batch


@dataclass(slots=True)
class Clock:
    """The device's clock at its newest sample (``t_hw_ns``) and when that came (``t_acq_ns``), ns."""

    t_hw_ns: int = 0
    t_acq_ns: int = 0

    def at(self, t_ns: int, speed: float) -> int:
        """Return the device's clock at Unix time ``t_ns``."""
        return self.t_hw_ns + round((t_ns - self.t_acq_ns) * speed)


class Output:
    """The commands of one device; times of the host are s of the monotonic clock.

    Args:
        driver: The driver of the device.
        limits: The limits of the rig file.
        speed: Seconds of the device's clock per second of the host.

    Attributes:
        requested: Requested values, by column.
        applied: Values that were sent, by column.
        unheard: How long no request has come, s, as the watchdog counts it.
        sent_at: When the last command was sent, s.
    """

    def __init__(self, driver: Driver, limits: Mapping[str, Limit], speed: float) -> None:
        self._driver, self._speed = driver, speed
        self._timed = driver if isinstance(driver, TimedDriver) else None
        self._reporting = driver if isinstance(driver, FaultReportingDriver) else None
        self._sent_for_ns: int | None = None
        self._safe = safe_values(driver.spec)
        self._sample_period = 1 / (driver.spec.stream.rate * speed)
        self.limits = CommandLimits(driver.spec.commands, limits, driver.spec.ranges)
        self.clock = Clock(0, unix_ns())
        self.requested, self.applied = dict(self._safe), dict(self._safe)
        self.unheard = 0.0
        self.sent_at = 0.0
        self._count = 0

    def begin(self, now: float) -> None:
        """Prepare the first command, which may change as much as in one sample period after any pause."""
        self.sent_at = now - self._sample_period

    def begin_from_safe(self, now: float) -> None:
        """The device went to its safe output by itself: the next command starts from there."""
        self.begin(now)
        self.applied = dict(self._safe)

    def take(self, values: Mapping[str, float]) -> None:
        """Note requested values; they must be finite and known."""
        self.requested.update(values)
        self.unheard = 0.0

    def send(self, now: float, t_hw_ns: int | None = None) -> Batch:
        """Send the requested values, clipped to the limits.

        Args:
            now: Time, s of the monotonic clock.
            t_hw_ns: Time of the device's clock that they belong to, ns, where they are part of a path.

        Returns:
            The row of the command stream with requested and applied values.
        """
        elapsed = self._elapsed(now, t_hw_ns)
        self.applied = {
            name: self.limits.clip(name, value, self.applied.get(name), elapsed)
            for name, value in self.requested.items()
        }
        self.sent_at = now
        if self._timed is not None and t_hw_ns is not None:
            self._sent_for_ns = t_hw_ns
            self._timed.command_at(self.applied, t_hw_ns)
        else:
            self._driver.command(self.applied)
        return self._row()

    def _elapsed(self, now: float, t_hw_ns: int | None) -> float:
        """Return how long the previous command has been in effect, s of the device's clock."""
        if self._timed is None:
            return (now - self.sent_at) * self._speed
        if t_hw_ns is None or self._sent_for_ns is None:
            return math.inf  # the driver limits the rate by itself
        return (t_hw_ns - self._sent_for_ns) * 1e-9

    def fault(self) -> str | None:
        """Return why the driver takes no commands; None where it does."""
        return (self._reporting.fault() or None) if self._reporting is not None else None

    def is_transient(self) -> bool:
        """Return whether the driver recovers from that fault by itself."""
        return self._reporting is not None and self._reporting.is_transient()

    def _row(self) -> Batch:
        t_ns = unix_ns()
        row = [
            values.get(column, math.nan)
            for signal in self._driver.spec.commands
            for values in (self.requested, self.applied)
            for column in signal.columns()
        ]
        self._count += 1
        t_hw_ns = self.clock.at(t_ns, self._speed)
        return Batch.of([(self._count - 1, t_ns, t_hw_ns, row)], len(row))

    def make_safe(self) -> None:
        """Bring the device to its safe state and clear the requested values."""
        self._driver.safe()
        self._sent_for_ns = None
        self.requested, self.applied = dict(self._safe), dict(self._safe)
