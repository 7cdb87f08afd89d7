"""Which rows of a table follow one another in time, where some time stamps are wrong."""

from __future__ import annotations

import numpy as np

from labhil.signals import FloatArray, IntArray

REACH = 100
"""Neighbours in a run are at most that many median steps, and that many rows, apart."""

SLOWEST = 0.25
"""Median steps per row that must have passed where rows are jumped over: else the clock was set."""


def longest_run(times: FloatArray) -> IntArray:
    """Return the indices of the longest run of plausible increasing times.

    Neighbours in a run increase, by at most ``REACH`` median steps. Single wrong stamps are jumped over;
    a clock that was set back, or far ahead, begins another run. ``times`` (n,) must be finite.
    """
    if len(times) < 2:
        return np.arange(len(times))
    steps = np.diff(times)
    rising = steps[steps > 0]
    median = float(np.median(rising)) if len(rising) else 0.0
    breaks = np.flatnonzero(~((steps > 0) & (steps <= REACH * median))) + 1
    if len(breaks) == 0:
        return np.arange(len(times))
    return _longest_path(times, breaks, median)


def _longest_path(times: FloatArray, breaks: IntArray, median: float) -> IntArray:
    """The longest run by dynamic programming: each row follows the best of the ``REACH`` before it.

    Only rows shortly after a break need a look at them all; further on the row before is the best.
    """
    n = len(times)
    length = np.ones(n, dtype=np.int64)
    before = np.full(n, -1, dtype=np.int64)
    starts = np.concatenate(([0], breaks))
    ends = np.concatenate((breaks, [n]))
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        near = min(end, start + REACH + 1)
        for row in range(start, near):
            _append(row, times, length, before, median)
        if near < end:
            length[near:end] = length[near - 1] + np.arange(1, end - near + 1)
            before[near:end] = np.arange(near - 1, end - 1)
    run = np.empty(int(length.max()), dtype=np.int64)
    row = int(np.argmax(length))
    for place in range(len(run) - 1, -1, -1):
        run[place] = row
        row = int(before[row])
    return run


def _append(row: int, times: FloatArray, length: IntArray, before: IntArray, median: float) -> None:
    """Find the row that ``row`` follows best, and note it."""
    first = max(0, row - REACH)
    if first == row:
        return
    steps = times[row] - times[first:row][::-1]  # the nearest first: of equals it wins
    jumped = np.arange(len(steps))
    possible = (steps > 0) & (steps <= REACH * median)
    possible &= (jumped == 0) | (steps >= SLOWEST * median * (jumped + 1))
    lengths = np.where(possible, length[first:row][::-1], 0)
    best = int(np.argmax(lengths))
    if lengths[best] > 0:
        length[row] = lengths[best] + 1
        before[row] = row - 1 - best
