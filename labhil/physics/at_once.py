"""Windows of a recording, simulated by all cores that have nothing else to do.

Windows do not know of each other, so that the result is the same to the last bit.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import numpy as np

from labhil.cores import cores
from labhil.physics.model import Windows
from labhil.signals import FloatArray, IntArray

WORTH_A_CORE = 4000
"""Rows that take a kernel much longer than it takes to hand them over."""

Kernel = Callable[[IntArray, IntArray, FloatArray, FloatArray], object]
"""Simulates windows (first and last samples, states) into their rows of an output."""


def at_once(kernel: Kernel, windows: Windows, states: FloatArray, out: FloatArray) -> None:
    """Simulate ``windows`` from their ``states`` (W, states) into the rows of ``out`` (N, …).

    ``kernel`` may be called several times at once, each time with some of the windows and their rows only.
    """
    own, *others = _parts(windows)

    def simulate(part: Part) -> None:
        chosen, rows = part
        kernel(windows.first[chosen], windows.last[chosen], states[chosen], out[rows])

    handed: list[tuple[Future[None], Part]] = [(_helpers().submit(simulate, part), part) for part in others]
    simulate(own)
    for future, part in reversed(handed):
        # cores that are busy with something else have not begun with it
        if future.cancel():
            simulate(part)
        else:
            future.result()


Part = tuple[slice, slice]
"""Some windows, and their rows."""


def _parts(windows: Windows) -> list[Part]:
    """Neighbouring windows, of about as many rows for each core."""
    total = len(windows.rows)
    count = min(cores(), total // WORTH_A_CORE, len(windows))
    if count < 2:
        return [(slice(None), slice(None))]
    ends = np.cumsum(windows.last - windows.first)
    wanted = np.searchsorted(ends, total * np.arange(1, count) / count) + 1
    edges = sorted({0, *(int(edge) for edge in wanted), len(windows)})
    rows = [0, *(int(ends[edge - 1]) for edge in edges[1:])]
    return [
        (slice(*windows_of), slice(*rows_of))
        for windows_of, rows_of in zip(pairwise(edges), pairwise(rows), strict=True)
    ]


@cache
def _helpers() -> ThreadPoolExecutor:
    """As many threads as there are further cores; made when they are first asked for."""
    return ThreadPoolExecutor(max(1, cores() - 1), thread_name_prefix="windows at once")


# a forked process has none of its parent's threads
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.cache_clear)
