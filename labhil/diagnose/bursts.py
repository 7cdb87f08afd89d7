"""Wrong readings that come a few in a row, and readings that drop out to one value and come back.

A burst differs from motion in both of its edges: a body that is thrown off its course does not return to it
from one sample to the next. A rate may, where a part that rests slips, so a burst out of rest counts only
where there are others like it elsewhere.
"""

from __future__ import annotations

import numpy as np

from labhil.diagnose.frozen import Runs, runs_of
from labhil.diagnose.jumps import (
    AS_HIGH,
    BEYOND_MOTION,
    BEYOND_NOISE,
    ENOUGH,
    NOTABLE,
    ROUNDS,
    answers,
    jump_sizes,
    usual_change,
)
from labhil.signals import FloatArray, IntArray

WIDEST = 8
"""Samples of a burst at most. Longer ones show by their silence, as a channel that is stuck."""

END = 3
"""Samples of a burst at most with which a recording begins or ends."""

LEAP = 2.0
"""Its one edge, in largest changes elsewhere in the recording."""

REST = 4.0
"""A reading is where another is within so many standard deviations of its noise; a rate at zero rests."""

AGREE = 0.5
"""Share of a burst's height by which the readings on either side of it may differ."""

LONG = 5.0
"""A dropout lasts so many times as long as a reading usually stays: slow sensors repeat theirs."""

NO_SPANS: IntArray = np.empty((0, 2), dtype=np.int64)


def bursts(x: FloatArray, sigma: float, inputs: FloatArray, *, rate: bool) -> IntArray:
    """First and last samples of the bursts of two wrong readings or more in a channel (n,), (k, 2).

    Single spikes are to be taken out before. ``sigma`` is the channel's noise, ``inputs`` (n, m) drive the
    rig; a ``rate`` may slip, and may answer them at once.
    """
    if len(x) < 2 * WIDEST + 2:
        return NO_SPANS
    sizes, calm, certain = jump_sizes(inputs), x.copy(), []
    doubtful = []
    for _ in range(ROUNDS):
        usual = usual_change(calm)
        widths = range(2, WIDEST + 1)
        spans = _disjoint(np.concatenate([_standing_out(calm, usual, sigma, width) for width in widths]))
        if not len(spans):
            break
        near = _explained_by_inputs(sizes, spans[:, 0], spans[:, 1] + 1, rate=rate)
        near |= rate & _start_from_rest(calm, sigma, spans)
        certain += spans[~near].tolist()
        doubtful += spans[near].tolist()
        calm = without(calm, spans)
    sure = np.array(certain, dtype=np.int64).reshape(-1, 2)
    both = np.concatenate([sure, _alike(x, sure, np.array(doubtful, dtype=np.int64).reshape(-1, 2))])
    return both[np.argsort(both[:, 0])]


def without(x: FloatArray, spans: IntArray) -> FloatArray:
    """A channel (n,) with a straight line in the place of each span (k, 2), at an end its neighbour."""
    kept = np.flatnonzero(~within(spans, len(x)))
    return np.asarray(np.interp(np.arange(len(x)), kept, x[kept])) if len(kept) else x


def at_ends(x: FloatArray, sigma: float, inputs: FloatArray) -> IntArray:
    """The wrong readings that a channel (n,) begins or ends with, (k, 2).

    They have one edge only, so it has to be beyond all else that the channel does in the recording, too.
    """
    if len(x) < 2 * END + 2 * WIDEST:
        return NO_SPANS
    spans = [(0, width - 1) for width in _begins_with(x, sigma, inputs)]
    spans += [(len(x) - width, len(x) - 1) for width in _begins_with(x[::-1], sigma, inputs[::-1])]
    return np.array(spans, dtype=np.int64).reshape(-1, 2)


def _begins_with(x: FloatArray, sigma: float, inputs: FloatArray) -> list[int]:
    """How many wrong readings a channel begins with; none where it does not."""
    change = np.abs(np.diff(x))
    largest = float(change[END:].max())
    for width in range(END, 0, -1):
        edge = change[width - 1]
        jumps = np.abs(np.diff(inputs[: width + 2], axis=0)) > NOTABLE * np.ptp(inputs, axis=0)
        if edge > max(BEYOND_NOISE * sigma, LEAP * largest) and not jumps.any():
            return [width]
    return []


def within(spans: IntArray, n: int) -> np.ndarray:
    """Which of ``n`` samples lie within the spans (k, 2), (n,)."""
    marked = np.zeros(n, dtype=bool)
    for first, last in spans.tolist():
        marked[first : last + 1] = True
    return marked


def dropouts(x: FloatArray, sigma: float, inputs: FloatArray, *, rate: bool) -> Runs:
    """Runs of equal readings of a channel (n,) that it jumps into and back out of.

    A part that comes to rest, or starts from it, takes its time; what the inputs explain does not count. A
    ``rate`` may follow a held input from level to level: there only zero counts, or one value each time.
    """
    runs = runs_of(x)
    usual = float(np.median(runs.length))
    inner = (runs.first > 0) & (runs.last < len(x)) & (runs.length >= LONG * usual)
    runs = runs.select(inner)
    if not len(runs.first):
        return runs
    rise, fall = x[runs.first] - x[runs.first - 1], x[runs.last] - x[runs.first]
    smaller, larger = np.sort([np.abs(rise), np.abs(fall)], axis=0)
    least = np.maximum(BEYOND_NOISE * sigma, BEYOND_MOTION * _usual_around(x, runs.first, runs.last))
    # readings that go on by chance near the one value that stands still for the sensor leave it by little
    runs = runs.select((rise * fall < 0.0) & (larger > least) & (smaller > REST * sigma))
    value, times = np.unique(x[runs.first], return_counts=True)
    eligible = (value == 0.0) | (times > 1) | (not rate)
    runs = runs.select(eligible[np.searchsorted(value, x[runs.first])])
    return runs.select(~_explained_by_inputs(jump_sizes(inputs), runs.first, runs.last, rate=rate))


def _explained_by_inputs(sizes: FloatArray, first: IntArray, behind: IntArray, *, rate: bool) -> np.ndarray:
    """Whether jumps of an input, of :func:`jump_sizes`, may explain jumps away and back, (k,).

    A rate may jump with an input and then go on by itself; a body is thrown off its course and back by two.
    """
    behind = np.minimum(behind, len(sizes) - 1)
    edges = np.unique(np.concatenate([first, behind]))
    begins, ends = answers(sizes, first, edges), answers(sizes, behind, edges)
    return np.asarray(begins | ends if rate else begins & ends)


def _usual_around(x: FloatArray, first: IntArray, behind: IntArray) -> FloatArray:
    """How a channel usually changes around runs that begin at ``first`` and end before ``behind``, (r,)."""
    change = usual_change(x)
    return np.asarray(np.maximum(change[first - 1], change[np.minimum(behind, len(change) - 1)]))


def _standing_out(x: FloatArray, usual: FloatArray, sigma: float, width: int) -> IntArray:
    """Spans of ``width`` samples that all stand out from the line between their neighbours, (k, 2)."""
    n = len(x) - width - 1
    before, after = x[:n], x[width + 1 :]
    usual = np.maximum(usual[:n], usual[width : width + n])
    least = np.maximum(BEYOND_NOISE * sigma, BEYOND_MOTION * usual)
    height = np.minimum(np.abs(x[1 : n + 1] - before), np.abs(after - x[width : width + n]))
    for k in range(1, width + 1):
        line = before + (after - before) * k / (width + 1)
        height = np.minimum(height, np.abs(x[k : k + n] - line))
    before_first = np.flatnonzero((height > least) & (np.abs(after - before) < AGREE * height + 3.0 * sigma))
    return np.column_stack([before_first + 1, before_first + width]).astype(np.int64)


def _disjoint(spans: IntArray) -> IntArray:
    """Those spans (k, 2) that touch none before them, the narrower first."""
    chosen: list[list[int]] = []
    for first, last in spans.tolist():
        if all(last < a - 1 or first > b + 1 for a, b in chosen):
            chosen.append([first, last])
    return np.array(chosen, dtype=np.int64).reshape(-1, 2)


def _start_from_rest(x: FloatArray, sigma: float, spans: IntArray) -> np.ndarray:
    """Which spans have readings of nothing on both sides, (k,)."""
    neighbours = np.maximum(np.abs(x[spans[:, 0] - 1]), np.abs(x[spans[:, 1] + 1]))
    return np.asarray(neighbours <= REST * sigma)


def _alike(x: FloatArray, sure: IntArray, doubtful: IntArray) -> IntArray:
    """Those of the ``doubtful`` spans (k, 2) that are as high as the ``sure`` ones, and not more of them."""
    if len(sure) < ENOUGH or len(doubtful) > len(sure):
        return NO_SPANS
    heights = [np.abs(x[spans[:, 0]] - x[spans[:, 0] - 1]) for spans in (sure, doubtful)]
    return np.asarray(doubtful[heights[1] >= AS_HIGH * np.median(heights[0])])
