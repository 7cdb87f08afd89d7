"""How many processor cores this process may use, and who shares work out among them."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def cores() -> int:
    """At least one; where the system restricts a process to some of the machine's, only these."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def shared_out(work: Callable[P, R]) -> Callable[P, R]:
    """Work that shares itself out among the cores, in which BLAS is to start no threads of its own.

    Its matrices are small: threads that wait for each other at every product cost more than they save, and
    the last digits of a result would depend on the machine's cores.
    """

    @wraps(work)
    def alone(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return work(*args, **kwargs)

    return alone
