"""The clock of the screen; a test can replace it."""

from __future__ import annotations

import time


def clock_ns() -> int:
    """Return the Unix time, ns."""
    return time.time_ns()
