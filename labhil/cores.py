"""How many processor cores this process may use, and by what."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import lru_cache
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


POOL_NAME = "side-by-side"
"""What names of threads begin with that stay as long as the process."""

_share = 1
"""How many processes like this one share the machine."""

_thread = threading.local()
"""``is_worker`` where a thread already is one of several that work side by side."""


def share_cores(processes: int) -> None:
    """Tell this process that so many like it work at the same time: each uses its part of the cores."""
    global _share  # noqa: PLW0603 - a fact about the process, as the limit of the system is
    _share = processes


def cores() -> int:
    """At least one; where the system restricts a process to some of the machine's, only these."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)) // _share)
    return max(1, (os.cpu_count() or 1) // _share)


def side_by_side(function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """What ``function`` makes of each item, in their order, on all cores; each as soon as it is there.

    Worth it for what simulates for longer than some milliseconds each: kernels release the interpreter, and
    around them threads wait for each other. Within one of the items, further ones follow each other.
    """
    workers = cores()
    if min(workers, len(items)) < 2 or getattr(_thread, "is_worker", False):
        yield from map(function, items)
        return
    futures = [_pool(workers).submit(function, item) for item in items]
    try:
        for future in futures:
            yield future.result()
    finally:  # after an error nothing goes on behind the caller's back
        for future in futures:
            future.cancel()
        wait(futures)


@lru_cache
def _pool(workers: int) -> ThreadPoolExecutor:
    """Threads that stay, as starting them takes as long as a short simulation."""
    return ThreadPoolExecutor(workers, POOL_NAME, _become_worker)


def _become_worker() -> None:
    _thread.is_worker = True


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork


@contextmanager
def linear_algebra_in_one_thread() -> Iterator[None]:
    """Within it, linear algebra runs in the thread that asks for it, as far as ``threadpoolctl`` can say so.

    Matrices of a fit have some thousand rows and some ten columns. Shared out, each of thousands of products
    waits for threads that spin: on two busy cores a least-squares solution of 6000 × 60 numbers took 440 ms
    of processor time instead of 7, and a diagnosis of an arm 37 s instead of 13.
    """
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        yield
        return
    with threadpool_limits(limits=1, user_api="blas"):
        yield
