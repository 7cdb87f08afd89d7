"""The newest samples of a stream, and their reduction to the columns of a plot."""

from __future__ import annotations

import threading
from itertools import pairwise

import numpy as np

from labhil.signals import Batch, FloatArray, IntArray


class RingBuffer:
    """Keep at least the newest ``capacity`` samples of ``width`` columns; two threads may use it.

    Rows are appended to arrays of twice that length, so that the newest are a slice. At the end of the
    arrays, once in ``capacity`` samples, they are moved to the front.
    """

    def __init__(self, width: int, capacity: int) -> None:
        self._capacity = capacity
        self._t_acq_ns = np.empty(2 * capacity, dtype=np.int64)
        self._t_hw_ns = np.empty(2 * capacity, dtype=np.int64)
        self._values = np.empty((2 * capacity, width))
        self._end = 0
        self._lock = threading.Lock()

    def append(self, batch: Batch) -> None:
        """Append samples; of more than ``capacity`` at once only the newest are kept."""
        newest = slice(max(0, len(batch) - self._capacity), len(batch))
        count = newest.stop - newest.start
        with self._lock:
            if self._end + count > len(self._t_acq_ns):
                self._compact()
            target = slice(self._end, self._end + count)
            self._t_acq_ns[target] = batch.t_acq_ns[newest]
            self._t_hw_ns[target] = batch.t_hw_ns[newest]
            self._values[target] = batch.values[newest]
            self._end += count

    def _compact(self) -> None:
        newest = slice(max(0, self._end - self._capacity), self._end)
        count = newest.stop - newest.start
        for array in (self._t_acq_ns, self._t_hw_ns, self._values):
            array[:count] = array[newest].copy()
        self._end = count

    def newest(self, seconds: float) -> tuple[IntArray, IntArray, FloatArray]:
        """Copy the newest samples.

        Args:
            seconds: How far back from the newest sample, s of the host's clock.

        Returns:
            t_acq_ns and t_hw_ns (n,), and values (n, width); empty where there are no samples.
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
    """Reduce samples to the smallest and the largest in each of equal parts, in their order.

    So a peak of one sample stays visible.

    Args:
        x: (n,)
        y: (n,)
        columns: Number of parts.

    Returns:
        x and y (2·columns,); unchanged where there are no more points than that.
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
    """Return the slices of samples between which no step of ``t`` is longer than ``longest_step``."""
    breaks = np.flatnonzero(np.diff(t) > longest_step) + 1
    ends = [0, *breaks.tolist(), len(t)]
    return [slice(a, b) for a, b in pairwise(ends) if b > a]
