"""Order of the rows of a table by their times: stretches, wraps of a clock, repeated times and holes.

Times are finite arrays in s, in the order of the rows. ``time_column.py`` reads them from a table.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.signals import FloatArray, IntArray

MAX_STEP = 100
"""Largest step, in median steps; a larger one is a hole where rows with wrong times are skipped."""

MAX_WRONG_ROWS = 10
"""Largest number of consecutive rows with wrong times (a damaged block of a log); more are a stretch."""


@dataclass(frozen=True)
class Wrap:
    """Wraps of a clock.

    Attributes:
        period: period of the clock, s.
        at: rows at which it restarts.
    """

    period: float
    at: IntArray


def median_step(times: FloatArray) -> float:
    """Median of the positive steps of times (n,), s; 0 without one."""
    steps = np.diff(times)
    rising = steps[steps > 0]
    return float(np.median(rising)) if len(rising) else 0.0


def find_wrap(times: FloatArray, periods: Sequence[tuple[float, float | None]]) -> Wrap | None:
    """Find the clock whose wraps explain the most negative steps.

    Args:
        times: times (n,), s.
        periods: period of each possible clock and reading at which it restarts (None: any), s.

    Returns:
        The wraps, negative steps that are ordinary ones if the period is added; None without one.
    """
    steps = np.diff(times)
    back = np.flatnonzero(steps < 0)
    typical = median_step(times)
    candidates = [
        Wrap(period, back[_is_wrap(times[back], steps[back], period, top, typical)] + 1)
        for period, top in (periods if len(back) else ())
    ]
    best = max(candidates, key=lambda wrap: len(wrap.at), default=None)
    return best if best is not None and len(best.at) else None


def _is_wrap(
    before: FloatArray,
    steps: FloatArray,
    period: float,
    top: float | None,
    typical: float,
    max_period_error: float = 1e-3,
) -> np.ndarray:
    """Whether each step is a wrap, with an error of the period below ``max_period_error``."""
    tolerance = min(max(2.5 * typical, min(MAX_STEP * typical, max_period_error * period)), period / 4.0)
    wraps = (steps + period > 0.0) & (steps + period <= tolerance)
    return wraps if top is None else wraps & (before > top - tolerance) & (before <= top)


def unwrap(times: FloatArray, wrap: Wrap) -> FloatArray:
    """Times (n,) without the wraps, s."""
    turns = np.zeros(len(times))
    turns[wrap.at] = 1.0
    return np.asarray(times + wrap.period * np.cumsum(turns), dtype=np.float64)


def increasing_stretches(times: FloatArray) -> list[IntArray]:
    """Divide rows into stretches of increasing times.

    A hole does not end a stretch. Up to ``MAX_WRONG_ROWS`` consecutive rows with wrong times are skipped and
    are in no stretch. If a clock was set back for more rows, another stretch begins.

    Args:
        times: times (n,), s, finite.

    Returns:
        Rows of each stretch, in order.
    """
    stretches: list[IntArray] = []
    remaining = [(0, len(times))]
    typical = median_step(times)
    while remaining:
        first, stop = remaining.pop()
        stretch = first + _longest_increasing(times[first:stop], typical)
        stretches.append(stretch)
        remaining += [
            side
            for side in ((first, int(stretch[0])), (int(stretch[-1]) + 1, stop))
            if side[1] - side[0] > MAX_WRONG_ROWS
        ]
        if len(stretches) > 1 + len(times) // MAX_WRONG_ROWS:
            break
    long_ones = [stretch for stretch in stretches if len(stretch) > MAX_WRONG_ROWS] or stretches[:1]
    return sorted((_trim_far_ends(stretch, times) for stretch in long_ones), key=lambda rows: int(rows[0]))


def longest_increase(times: FloatArray) -> IntArray:
    """Find the most rows of which each is later than those before it, whatever lies between them.

    Args:
        times: times (n,), s, finite.

    Returns:
        The rows, in order.
    """
    ends: list[float] = []
    end_rows: list[int] = []
    before = np.full(len(times), -1, dtype=np.int64)
    for row, time in enumerate(times.tolist()):
        length = bisect_left(ends, time)
        before[row] = end_rows[length - 1] if length else -1
        ends[length : length + 1] = [time]
        end_rows[length : length + 1] = [row]
    rows = end_rows[-1:]
    while rows and before[rows[-1]] >= 0:
        rows.append(int(before[rows[-1]]))
    return np.array(rows[::-1], dtype=np.int64)


def _trim_far_ends(stretch: IntArray, times: FloatArray, max_pause: float = 1e6) -> IntArray:
    """The stretch without a few times at an end that are further away than ``max_pause`` durations."""
    steps = np.diff(times[stretch])
    if len(steps) <= 2 * MAX_WRONG_ROWS:
        return stretch
    for hole in np.flatnonzero(steps > MAX_STEP * np.median(steps)):
        before, after = stretch[: hole + 1], stretch[hole + 1 :]
        near, far = (before, after) if len(before) > len(after) else (after, before)
        if len(far) <= MAX_WRONG_ROWS and steps[hole] > max_pause * (times[near[-1]] - times[near[0]]):
            return near
    return stretch


def _longest_increasing(times: FloatArray, typical: float) -> IntArray:
    """Rows of the best increasing subsequence, by dynamic programming.

    The predecessor of a row is the best of the ``MAX_WRONG_ROWS`` + 1 rows before it. All of these are
    compared only shortly after a negative step or a hole; further on it is the row before.
    """
    n = len(times)
    steps = np.diff(times)
    if (steps > 0).all():
        return np.arange(n)
    back = np.concatenate(([False], steps <= 0))
    near_step_back = np.convolve(back, np.ones(2 * MAX_WRONG_ROWS + 1))[MAX_WRONG_ROWS:][:n] > 0
    score = np.ones(n)
    predecessor = np.full(n, -1, dtype=np.int64)
    breaks = np.flatnonzero(~((steps > 0) & (steps <= MAX_STEP * typical))) + 1
    starts = np.concatenate(([0], breaks))
    ends = np.concatenate((breaks, [n]))
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        near = min(end, start + MAX_WRONG_ROWS + 2)
        for row in range(start, near):
            _link_row(row, times, score, predecessor, typical, bool(near_step_back[row]))
        if near < end:
            score[near:end] = score[near - 1] + np.arange(1, end - near + 1)
            predecessor[near:end] = np.arange(near - 1, end - 1)
    rows = []
    row = int(np.argmax(score))
    while row >= 0:
        rows.append(row)
        row = int(predecessor[row])
    return np.array(rows[::-1], dtype=np.int64)


def _link_row(
    row: int,
    times: FloatArray,
    score: FloatArray,
    predecessor: IntArray,
    typical: float,
    near_step_back: bool,
    min_step_per_row: float = 0.25,
    hole_cost: int = 3,
) -> None:
    """Store the best predecessor of a row and its score.

    Skipped rows must have taken ``min_step_per_row`` median steps each; otherwise the clock was set. A hole
    near a step back costs ``hole_cost`` rows, since of two explanations the simpler one counts.
    """
    first = max(0, row - MAX_WRONG_ROWS - 1)
    if first == row:
        return
    steps = times[row] - times[first:row][::-1]  # the nearest row first, which wins a tie
    skipped = np.arange(len(steps))
    possible = (steps > 0) & ((skipped == 0) | (steps >= min_step_per_row * typical * (skipped + 1)))
    cost = np.where((steps > MAX_STEP * typical) & near_step_back, hole_cost, 0)
    scores = np.where(possible, score[first:row][::-1] - cost, 0.0)
    best = int(np.argmax(scores))
    if scores[best] > 0:
        score[row] = scores[best] + 1.0
        predecessor[row] = row - 1 - best


@dataclass(frozen=True)
class Repeats:
    """Times that several consecutive rows share.

    Attributes:
        sizes: rows of each time, (times,).
        spread: times (n,) of the rows, spread evenly; None if that is ambiguous.
    """

    sizes: IntArray
    spread: FloatArray | None

    @property
    def text(self) -> str:
        """Number of rows per time, for messages."""
        inner = self.sizes[1:-1] if len(self.sizes) > 2 else self.sizes
        low, high = int(inner.min()), int(inner.max())
        return f"{low} rows a stamp" if low == high else f"{low} to {high} rows a stamp"


def find_repeats(times: FloatArray) -> Repeats:
    """Count the rows of each time, and spread them evenly.

    That is possible if all times but the first and last have the same number of rows, and equal steps except
    for holes.

    Args:
        times: times (n,), s.

    Returns:
        The repeated times.
    """
    starts = np.concatenate(([0], np.flatnonzero(np.diff(times) != 0) + 1))
    sizes = np.diff(np.concatenate((starts, [len(times)])))
    stamps = times[starts]
    if len(stamps) < 4:
        return Repeats(sizes, None)
    count, steps = int(sizes[1]), np.diff(stamps)
    typical = float(np.median(steps))
    same = (sizes[1:-1] == count).all() and sizes[0] <= count and sizes[-1] <= count
    # rounded times differ by their last digit; 10 % is much less than one row
    even = (steps >= 0.9 * typical).all() and np.mean(steps <= 1.1 * typical) > 0.9
    if not (same and even and typical > 0):
        return Repeats(sizes, None)
    position = np.arange(len(times)) - np.repeat(starts, sizes)
    position[: sizes[0]] += count - sizes[0]  # the first rows of the first time are missing
    return Repeats(sizes, np.asarray(times + position * (typical / count), dtype=np.float64))


def rows_after_holes(t: FloatArray) -> IntArray:
    """Rows after holes, steps of over 1.5 median steps and 8 robust standard deviations of times (n,)."""
    steps = np.diff(t)
    if not len(steps):
        return np.zeros(0, dtype=np.int64)
    typical = float(np.median(steps))
    scatter = 1.4826 * float(np.median(np.abs(steps - typical)))
    return np.flatnonzero(steps > 1.5 * typical + 8.0 * scatter) + 1
