"""Whether a host and its device hear each other."""

from __future__ import annotations

import math
import time

from labhil.driver import Driver
from labhil.errors import DeviceSilentError
from labhil.host_clock import SuspendWatch
from labhil.service.messages import HostConfig

MAX_SILENCE = 1.0
"""How long a connected device may send no samples, s of the host's clock."""


class Contact:
    """Notes when samples come in, whether the device hears commands, and whether this machine was suspended.

    Args:
        config: Of the host.
        driver: Of the device.
        rate: Expected samples per second of the host's clock.

    Attributes:
        has_samples: Whether samples came in since the device was connected.
    """

    def __init__(self, config: HostConfig, driver: Driver, rate: float) -> None:
        self._address, self._watchdog = config.address, config.watchdog
        self._reconnects = config.reconnect
        self._driver, self._rate = driver, rate
        self._suspends = SuspendWatch()
        self.restart()

    def restart(self) -> None:
        """Begin anew with a device that was just connected."""
        self.has_samples = False
        self._last_sample_at = self._checked_at = time.monotonic()
        self._resumed_at = -math.inf
        self._unheard = self._driver.counters.unheard
        self._suspends.slept()

    def note_samples(self, now: float) -> None:
        """Note that samples came in."""
        if self._paused(now):
            self._resumed_at = now
        self._last_sample_at, self.has_samples = now, True

    def silence(self, now: float) -> float:
        """Return the time since the last sample, s."""
        return now - self._last_sample_at

    def check_silence(self, now: float) -> None:
        """Raise DeviceSilentError where a connected device sends no samples."""
        if self.silence(now) > MAX_SILENCE:
            raise DeviceSilentError(
                f"{self._address}: the device said nothing for {MAX_SILENCE:g} s; "
                f"expected {self._rate:g} samples per second"
            )

    def check_standstill(self) -> None:
        """Raise DeviceSilentError where the machine was suspended, or this process stopped for a while.

        The device has made itself safe meanwhile, and what waits on its wire and on the bus is old. A busy
        machine stops processes, too: that ends no run that does not reconnect lost devices.
        """
        if (slept := self._suspends.slept()) > MAX_SILENCE:
            raise DeviceSilentError(f"{self._address}: this machine was suspended for {slept:.3g} s")
        previous, self._checked_at = self._checked_at, time.monotonic()
        stopped = self._checked_at - previous
        if stopped > MAX_SILENCE and self._reconnects:
            raise DeviceSilentError(f"{self._address}: the process of its host stopped for {stopped:.3g} s")

    def lost_commands(self) -> str:
        """Describe that the device made itself safe without commands since the last call; "" otherwise."""
        before, self._unheard = self._unheard, self._driver.counters.unheard
        if self._unheard <= before:
            return ""
        return f"{self._address}: the device heard no command for so long that it made itself safe"

    def explains_pause(self, now: float) -> bool:
        """Whether commands pause because samples do.

        A controller that answers samples sends nothing when there are none, and needs a moment when they
        resume.
        """
        return self._paused(now) or now - self._resumed_at < self._watchdog

    def _paused(self, now: float) -> bool:
        return self.silence(now) > self._watchdog / 2
