"""Log times of samples: Unix times at which they were taken, which other programs plot them over.

All samples of a burst have one acquisition time, and only the device's clock separates them. The shortest
delay of the last one or two seconds relates this clock to the host's.
"""

from __future__ import annotations

import numpy as np

from labhil.signals import IntArray

SECOND_NS = 1_000_000_000
MAX_ELAPSED_NS = 4.0e18
"""Bound that fits into int64."""


class LogTimes:
    """Log times of one stream, increasing, and never later than the acquisition.

    Args:
        speed: seconds of the device's world per second of the host.
        window_ns: shortest time for which a delay counts. A device's clock that is slow by 0.5 % puts a
            sample too early by 2 · ``window_ns`` · 0.5 % at most.
        largest_delay_ns: longest delay; beyond it a clock was set.

    Example:
        >>> burst = np.array([0, 1_000_000, 2_000_000])
        >>> LogTimes().of(np.full(3, 50_000_000), burst).tolist()
        [48000000, 49000000, 50000000]
    """

    def __init__(
        self, speed: float = 1.0, *, window_ns: int = SECOND_NS, largest_delay_ns: int = SECOND_NS
    ) -> None:
        self._speed, self._window_ns, self._largest_delay_ns = speed, window_ns, largest_delay_ns
        self._origin_ns = self._last_hw_ns = 0
        self._offsets: list[int] = []
        self._window_ends_ns = self._last_ns = 0

    def of(self, t_acq_ns: IntArray, t_hw_ns: IntArray) -> IntArray:
        """Compute the log times of the next samples.

        Args:
            t_acq_ns: Unix times of acquisition, (n,) with n ≥ 1, not negative.
            t_hw_ns: the device's clock, (n,).

        Returns:
            Unix times, ns, (n,) int64.
        """
        restarts = np.flatnonzero(np.diff(t_hw_ns) < 0) + 1
        parts = zip(np.split(t_acq_ns, restarts), np.split(t_hw_ns, restarts), strict=True)
        return np.concatenate([self._of_one_run(acquired, device) for acquired, device in parts])

    def _of_one_run(self, t_acq_ns: IntArray, t_hw_ns: IntArray) -> IntArray:
        if not self._offsets or t_hw_ns[0] < self._last_hw_ns:
            self._origin_ns, self._offsets = int(t_hw_ns[0]), []
        self._last_hw_ns = int(t_hw_ns[-1])
        elapsed = self._elapsed(t_hw_ns)
        delays = t_acq_ns - elapsed
        shortest = int(delays.min())
        offset = self._offset(shortest, int(t_acq_ns[-1]))
        if int(delays.max()) - offset > self._largest_delay_ns:
            self._offsets, offset = [shortest], shortest
        log_ns = elapsed + offset
        log_ns = np.where(t_acq_ns - log_ns > self._largest_delay_ns, t_acq_ns, log_ns)
        if t_acq_ns[-1] < self._last_ns - self._largest_delay_ns:
            self._last_ns = 0  # the host's clock was set back
        moved = _spread_after(self._last_ns, np.maximum.accumulate(log_ns))
        log_ns = np.maximum(np.maximum.accumulate(np.minimum(moved, t_acq_ns)), self._last_ns)
        self._last_ns = int(log_ns[-1])
        return log_ns

    def _elapsed(self, t_hw_ns: IntArray) -> IntArray:
        elapsed = t_hw_ns - self._origin_ns
        if self._speed == 1.0:
            return elapsed
        return np.rint(np.minimum(elapsed / self._speed, MAX_ELAPSED_NS)).astype(np.int64)

    def _offset(self, shortest: int, now_ns: int) -> int:
        """Shortest delay of this window and the one before, ns."""
        if not self._offsets or now_ns >= self._window_ends_ns:
            self._offsets = [shortest, *self._offsets[:1]]
            self._window_ends_ns = now_ns + self._window_ns
        else:
            self._offsets[0] = min(self._offsets[0], shortest)
        return min(self._offsets)


def _spread_after(last_ns: int, log_ns: IntArray) -> IntArray:
    """Spread times before the last sample, which a shorter delay makes too early, evenly up to the next."""
    early = int(np.searchsorted(log_ns, last_ns))
    if early == 0:
        return log_ns
    end_ns = max(int(log_ns[min(early, len(log_ns) - 1)]), last_ns + early + 1)
    moved = log_ns.copy()
    moved[:early] = last_ns + np.arange(1, early + 1) * ((end_ns - last_ns) // (early + 1))
    return np.maximum.accumulate(moved)
