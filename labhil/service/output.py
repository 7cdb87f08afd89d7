"""What is requested of a device and what it is sent: clipped, sent again in time, and written down."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from labhil.driver import Driver, TimedDriver
from labhil.host_clock import unix_ns
from labhil.rig_sections import Limit
from labhil.service.declared import safe_values
from labhil.service.limits import CommandLimits
from labhil.signals import Batch


@dataclass(slots=True)
class Clock:
    """The device's clock at its newest sample, and when that came; ns."""

    t_hw_ns: int = 0
    t_acq_ns: int = 0

    def at(self, t_ns: int, speed: float) -> int:
        """Return the device's clock at Unix time ``t_ns``."""
        return self.t_hw_ns + round((t_ns - self.t_acq_ns) * speed)


class Output:
    """The commands of one device; host times on the monotonic clock, s.

    ``unheard`` is how long no request has come, as the watchdog counts it.
    """

    def __init__(self, driver: Driver, limits: Mapping[str, Limit], speed: float) -> None:
        self._driver, self._speed = driver, speed
        self._timed = driver if isinstance(driver, TimedDriver) else None
        self._sent_for_ns: int | None = None
        self._safe = safe_values(driver.spec)
        self._sample_period = 1 / (driver.spec.stream.rate * speed)
        self.limits = CommandLimits(driver.spec.commands, limits)
        self.clock = Clock(0, unix_ns())
        self.requested, self.applied = dict(self._safe), dict(self._safe)
        self.unheard = 0.0
        self.sent_at = 0.0
        self._count = 0

    def begin(self, now: float) -> None:
        """The next command is the first: it may move as far as one sample allows, not as a pause was long."""
        self.sent_at = now - self._sample_period

    def begin_from_safe(self, now: float) -> None:
        """The device went to its safe output by itself: the next command starts from there."""
        self.begin(now)
        self.applied = dict(self._safe)

    def take(self, values: Mapping[str, float]) -> None:
        """Note what somebody asks for; the values must be finite and known."""
        self.requested.update(values)
        self.unheard = 0.0

    def send(self, now: float, t_hw_ns: int | None = None) -> Batch:
        """Send the requested values as far as the limits allow, and return the row that holds both.

        ``t_hw_ns`` is the time of the device's clock that it belongs to, where it is part of a path.
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
        """How long what was sent before has had its effect, s of the device's clock."""
        if self._timed is None:
            return (now - self.sent_at) * self._speed
        if t_hw_ns is None or self._sent_for_ns is None:
            return math.inf  # the driver takes its own time to get there
        return (t_hw_ns - self._sent_for_ns) * 1e-9

    def fault(self) -> str | None:
        """Return what keeps the device from being commanded, where its driver says so."""
        return (self._timed.fault() or None) if self._timed is not None else None

    def is_transient(self) -> bool:
        """Whether the driver mends that by itself."""
        return self._timed is not None and self._timed.is_transient()

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
        """Bring the device to its safe state; nothing is requested of it any more."""
        self._driver.safe()
        self._sent_for_ns = None
        self.requested, self.applied = dict(self._safe), dict(self._safe)
