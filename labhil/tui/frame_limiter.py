"""How often plots are drawn: as often as they may, as long as that leaves the machine to others."""

from __future__ import annotations

import time
from collections.abc import Callable

SHARE = 0.1
"""Of one core, for the thread that draws."""
SLOWEST = 0.5
"""Longest time between two pictures, however costly, s."""

Clock = Callable[[], float]


class FrameLimiter:
    """Decides at each tick whether to draw; ``spent`` is the CPU time of the calling thread, s.

    A picture of three charts takes some 5 ms on a machine of its own and four times that where others
    compete for its cores and caches: then every second tick goes by without one.
    """

    def __init__(self, clock: Clock = time.monotonic, spent: Clock = time.thread_time) -> None:
        self._clock, self._spent = clock, spent
        self._drawn_at = self._spent_then = float("-inf")

    def due(self) -> bool:
        """Whether to draw now: the thread has used less than its share since the last time."""
        now, spent = self._clock(), self._spent()
        passed = now - self._drawn_at
        if spent - self._spent_then > SHARE * passed and passed < SLOWEST:
            return False
        self._drawn_at, self._spent_then = now, spent
        return True
