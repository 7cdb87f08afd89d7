"""How many processor cores this process may use."""

from __future__ import annotations

import os


def cores() -> int:
    """At least one; where the system restricts a process to some of the machine's, only these."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
