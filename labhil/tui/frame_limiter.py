"""A limit on how often plots are drawn, so that they leave the processor to others."""

from __future__ import annotations

import time
from collections.abc import Callable

Clock = Callable[[], float]


class FrameLimiter:
    """Decide at each tick whether to draw.

    A frame of three charts takes some 5 ms on an idle machine, and four times that under load; then every
    second tick is skipped.

    Args:
        clock: Time, s.
        cpu_time: CPU time of the calling thread, s.
        max_share: Largest share of one core for drawing.
        max_interval: Longest time between two frames, s, whatever they cost.
    """

    def __init__(
        self,
        clock: Clock = time.monotonic,
        cpu_time: Clock = time.thread_time,
        *,
        max_share: float = 0.1,
        max_interval: float = 0.5,
    ) -> None:
        self._clock, self._cpu_time = clock, cpu_time
        self._max_share, self._max_interval = max_share, max_interval
        self._last_time = self._last_cpu_time = float("-inf")

    def due(self) -> bool:
        """Return whether to draw now."""
        now, cpu_time = self._clock(), self._cpu_time()
        elapsed = now - self._last_time
        if cpu_time - self._last_cpu_time > self._max_share * elapsed and elapsed < self._max_interval:
            return False
        self._last_time, self._last_cpu_time = now, cpu_time
        return True
