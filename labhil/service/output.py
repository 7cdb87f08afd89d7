"""What is asked of a device and what it is sent: clipped, sent again in time, and written down."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

from labhil.driver import Driver
from labhil.rig import Limit
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

    ``unheard`` is how long nobody has asked for anything, as the watchdog counts it.
    """

    def __init__(self, driver: Driver, limits: Mapping[str, Limit], speed: float) -> None:
        self._driver, self._speed = driver, speed
        self._safe = safe_values(driver.spec)
        self._sample_period = 1 / (driver.spec.stream.rate * speed)
        self.limits = CommandLimits(driver.spec.commands, limits)
        self.clock = Clock(0, time.time_ns())
        self.requested, self.applied = dict(self._safe), dict(self._safe)
        self.unheard = 0.0
        self.sent_at = 0.0
        self._count = 0

    def begin(self, now: float) -> None:
        """The next command is the first: it may move as far as one sample allows, not as a pause was long."""
        self.sent_at = now - self._sample_period

    def take(self, values: Mapping[str, float]) -> None:
        """Note what somebody asks for; the values must be finite and known."""
        self.requested.update(values)
        self.unheard = 0.0

    def send(self, now: float) -> Batch:
        """Send what is asked for as far as the limits allow, and return the row that says both."""
        elapsed = (now - self.sent_at) * self._speed
        self.applied = {
            name: self.limits.clipped(name, value, self.applied[name], elapsed)
            for name, value in self.requested.items()
        }
        self.sent_at = now
        self._driver.command(self.applied)
        t_ns = time.time_ns()
        row = [value for name in self.requested for value in (self.requested[name], self.applied[name])]
        self._count += 1
        t_hw_ns = self.clock.at(t_ns, self._speed)
        return Batch.of([(self._count - 1, t_ns, t_hw_ns, row)], len(row))

    def make_safe(self) -> None:
        """Bring the device to its safe state; nothing is asked of it any more."""
        self._driver.safe()
        self.requested, self.applied = dict(self._safe), dict(self._safe)
