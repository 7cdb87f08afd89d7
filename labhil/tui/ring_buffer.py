"""The newest samples of a stream: one thread appends, another reads."""

from __future__ import annotations

import threading
from itertools import pairwise

import numpy as np

from labhil.signals import Batch, FloatArray, IntArray


class RingBuffer:
    """Keeps at least the newest ``capacity`` samples of ``width`` columns.

    Rows are written one after another into arrays twice as long, so that the newest are a slice:
    only when the end is reached, once in ``capacity`` samples, are they moved to the front.
    """

    def __init__(self, width: int, capacity: int) -> None:
        self._capacity = capacity
        self._t_acq_ns = np.empty(2 * capacity, dtype=np.int64)
        self._t_hw_ns = np.empty(2 * capacity, dtype=np.int64)
        self._values = np.empty((2 * capacity, width))
        self._end = 0
        self._lock = threading.Lock()

    def append(self, batch: Batch) -> None:
        """Take samples in; of more than ``capacity`` at once only the newest are kept."""
        taken = slice(max(0, len(batch) - self._capacity), len(batch))
        count = taken.stop - taken.start
        with self._lock:
            if self._end + count > len(self._t_acq_ns):
                self._compact()
            place = slice(self._end, self._end + count)
            self._t_acq_ns[place] = batch.t_acq_ns[taken]
            self._t_hw_ns[place] = batch.t_hw_ns[taken]
            self._values[place] = batch.values[taken]
            self._end += count

    def _compact(self) -> None:
        kept = slice(max(0, self._end - self._capacity), self._end)
        count = kept.stop - kept.start
        for array in (self._t_acq_ns, self._t_hw_ns, self._values):
            array[:count] = array[kept].copy()
        self._end = count

    def newest(self, seconds: float) -> tuple[IntArray, IntArray, FloatArray]:
        """Return copies of t_acq_ns, t_hw_ns (n,) and values (n, width) of the newest ``seconds``.

        Seconds of the host's clock, counted back from the newest sample; empty arrays when there is none.
        """
        with self._lock:
            t = self._t_acq_ns[: self._end]
            if not len(t):
                return t.copy(), t.copy(), self._values[:0].copy()
            # stamps of a host whose clock was set back are not sorted; such a sample comes late, not never
            start = int(np.searchsorted(t, t[-1] - round(seconds * 1e9)))
            rows = slice(start, self._end)
            return t[start:].copy(), self._t_hw_ns[rows].copy(), self._values[rows].copy()


def envelope(x: FloatArray, y: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """Reduce samples (n,) to the smallest and the largest in each of ``columns`` parts, in their order.

    A peak of one sample stays visible, which it would not if every n-th sample were taken. A short line is
    returned unchanged.
    """
    if len(x) <= 2 * columns:
        return x, y
    edges = np.linspace(0, len(x), columns + 1).astype(np.int64)
    starts = edges[:-1]
    low, high = np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)
    first_is_low = y[starts] <= y[edges[1:] - 1]
    pairs = np.where(first_is_low[:, None], np.column_stack([low, high]), np.column_stack([high, low]))
    middles = np.column_stack([x[starts], x[edges[1:] - 1]])
    return middles.ravel(), pairs.ravel()


def split_at_gaps(t: FloatArray, longest_step: float) -> list[slice]:
    """Where to lift the pen: runs of samples between which no step is longer than ``longest_step`` (s)."""
    breaks = np.flatnonzero(np.diff(t) > longest_step) + 1
    ends = [0, *breaks.tolist(), len(t)]
    return [slice(a, b) for a, b in pairwise(ends) if b > a]
