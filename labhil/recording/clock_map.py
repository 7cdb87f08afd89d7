"""What two clocks say of each other, where the one is read late: the line of least delay, and steps in it.

A sample is stamped by the device when it is taken and by the host when it comes in, which is late by what
wire and scheduler add: never by less than nothing, now and then by much, and for many samples in a row. So
the line between the clocks lies along the smallest delays, as in NTP's clock filter and in Moon, Skelly and
Towsley (INFOCOM 1999): here the low quantile of the smallest delay of each of many blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from labhil.signals import FloatArray, IntArray

BLOCKS = 64
FEWEST_BLOCKS = 8
FEWEST_PER_BLOCK = 4
BLOCK = 0.25
"""s of the host at least in a block: longer than a busy scheduler lets a process wait, so that some sample of
most blocks is in time."""

QUANTILE = 0.1
"""So large a share of the blocks' smallest delays lies below the line: a few that are too early do no
harm."""

GROUPS = 8
"""The errors come from leaving out so many stretches, one after the other (jackknife): what delays one stamp
delays its neighbours, so single stamps would tell of errors that are far too small."""

FEWEST = 32
"""Samples; with less, no errors are stated."""

SHORTEST_FIT = 1.0
"""s; shorter stretches tell nothing about a rate."""

SMALLEST_ERROR = 1e-6
"""s; stamps of wires and operating systems are not better than that."""

CELL = 0.25
FEWEST_PER_CELL = 4
REACH = 8
"""A step is looked for between the smallest delays of so many cells of ``CELL`` s on either side: of 2 s
each."""

SMALLEST_STEP = 0.02
"""s; smaller steps are within what a busy machine adds for as long as ``REACH`` cells."""

STEP_IN_NOISE = 8.0
"""A step is larger than so many robust standard deviations of a cell's smallest delay."""

LATEST = 2.0
"""s; a host that takes samples later than that has given its device up. Larger jumps show in any few
samples."""

CONGESTION = 10.0
"""s; queues may stay full for so long: delays that fall back within it, and no stamp before the one ahead of
it, are of a busy machine and not of a clock."""

MOST_STEPS = 1000


@dataclass(frozen=True, slots=True)
class ClockStep:
    """A jump of the host's stamps against the device's clock.

    ``row`` is the first sample after it, ``size`` by how much the host's stamps jump ahead (s of the host;
    negative: back).
    """

    row: int
    size: float


@dataclass(frozen=True, slots=True)
class DelayLine:
    """The least delay is ``level + slope * (x - middle)``, s; errors are standard errors, None if unknown.

    ``span`` (s) is how long the stretch was that the line is of.
    """

    middle: float
    level: float
    slope: float
    level_error: float | None
    slope_error: float | None
    span: float

    def at(self, x: FloatArray) -> FloatArray:
        """The least delay at ``x`` (s of the device's clock), s."""
        return np.asarray(self.level + self.slope * (x - self.middle), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class ClockMap:
    """Which moment of the host a moment of the device's clock was, and back.

    Between steps of the host's stamps the least delay lies on lines of one ``slope`` about ``middle``;
    ``begins`` (k,) are where these begin and ``levels`` (k,) how high they are, all in s of the host since
    the device's first sample at ``zero_ns`` of its clock, as is ``end``, where the last sample is. Host
    times are s since ``origin_ns``.
    """

    zero_ns: int
    origin_ns: int
    speed: float
    begins: FloatArray
    levels: FloatArray
    slope: float
    middle: float
    end: float

    def elapsed(self, t_hw_ns: IntArray) -> FloatArray:
        """Return what passed on the device's clock since its first sample, s of the host, (n,)."""
        return np.asarray((t_hw_ns - self.zero_ns) * (1e-9 / self.speed), dtype=np.float64)

    def host(self, x: FloatArray) -> FloatArray:
        """Return the host's time at ``x`` s of the host since the device's first sample, with its steps."""
        segment = np.maximum(np.searchsorted(self.begins, x, side="right") - 1, 0)
        return np.asarray(x + self.levels[segment] + self.slope * (x - self.middle), dtype=np.float64)

    def steady_host(self, x: FloatArray) -> FloatArray:
        """As :meth:`host` by the host's clock as it ran in the end: without steps."""
        return np.asarray(x + self.levels[-1] + self.slope * (x - self.middle), dtype=np.float64)

    def device(self, host: float) -> float:
        """Return the ``x`` of a host's time; where a clock that was set back shows it twice, the later
        one."""
        ends = np.append(self.begins[1:], self.end)
        first, last = (x + self.levels + self.slope * (x - self.middle) for x in (self.begins, ends))
        away = np.maximum(np.maximum(first - host, host - last), 0.0)
        segment = int(np.flatnonzero(away == away.min())[-1])
        x = float(host - self.levels[segment] + self.slope * self.middle) / (1.0 + self.slope)
        # between the end of a stretch and the begin of the next the device stood still
        return min(x, float(ends[segment])) if segment + 1 < len(ends) else x


def fit_delay_line(x: FloatArray, delay: FloatArray) -> DelayLine:
    """Return the line along the smallest delays.

    Args:
        x: The device's clock, s, increasing, shape (n,) with n ≥ 1.
        delay: The host's clock less the device's, s, shape (n,).
    """
    middle, span = float(0.5 * (x[0] + x[-1])), float(x[-1] - x[0])
    if len(x) < 3 or span < SHORTEST_FIT:
        return DelayLine(middle, float(delay.min()), 0.0, None, None, span)
    count = min(BLOCKS, max(FEWEST_BLOCKS, int(span / BLOCK)))
    bx, by = _block_minima(x - middle, delay, min(count, max(3, len(x) // FEWEST_PER_BLOCK)))
    level, slope = _quantile_line(bx, by)
    if len(x) < FEWEST:
        return DelayLine(middle, level, slope, None, None, span)
    return DelayLine(middle, level, slope, *_errors(bx, by, level, slope), span)


def _block_minima(x: FloatArray, y: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    starts = np.linspace(0, len(x), count, endpoint=False).astype(int)
    ends = np.append(starts[1:], len(x))
    rows = [start + int(np.argmin(y[start:end])) for start, end in zip(starts, ends, strict=True)]
    return x[rows], y[rows]


def _quantile_line(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """The line of the low quantile, exactly: it goes through two of the points."""
    first, second = np.triu_indices(len(x), k=1)
    slope = (y[second] - y[first]) / (x[second] - x[first])
    level = y[first] - slope * x[first]
    above = y - level[:, None] - slope[:, None] * x
    loss = np.sum(np.where(above > 0.0, QUANTILE * above, (QUANTILE - 1.0) * above), axis=1)
    best = int(np.argmin(loss))
    return float(level[best]), float(slope[best])


def _errors(x: FloatArray, y: FloatArray, level: float, slope: float) -> tuple[float, float]:
    """Standard errors in the middle and of the slope.

    The jackknife sees what lasts; beside it stands what the blocks' smallest delays scatter about the line,
    for a line that happens to go through two lone points does not move when others are left out.
    """
    groups = np.array_split(np.arange(len(x)), min(GROUPS, len(x)))
    without = np.array(
        [_quantile_line(np.delete(x, g), np.delete(y, g)) for g in groups if len(x) - len(g) > 2]
    )
    share = (len(groups) - 1) / len(groups)
    level_jack, slope_jack = np.sqrt(share * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
    # one-sided: of an exponential distribution, whose mean is its median over ln 2; of each stretch by
    # itself, for where half of them are busy the median of all says nothing of that half
    residual = np.abs(y - level - slope * x)
    typical = float(np.quantile([np.median(residual[group]) for group in groups], 0.75))
    scatter = typical / np.log(2.0) / np.sqrt(len(x))
    reach = float(np.std(x))
    return (
        float(np.hypot(level_jack, scatter) + SMALLEST_ERROR),
        float(np.hypot(slope_jack, scatter / reach) + SMALLEST_ERROR / reach),
    )


def steps_in(x: FloatArray, delay: FloatArray) -> list[tuple[int, float]]:
    """Return where the least delay jumps for good: the first row after it and by how much (s), in order.

    What comes late for a while and then in time again is no step. Arguments as of :func:`fit_delay_line`.
    """
    per_cell = _per_cell(x)
    if len(x) < 2 * per_cell:
        return []
    starts = np.arange(0, len(x) - per_cell + 1, per_cell)
    lows = np.minimum.reduceat(delay, starts)
    lows = lows - _local_slope(x[starts], lows) * (x[starts] - x[0])
    level = np.concatenate([[0.0], np.diff(lows)])
    noise = 1.4826 * float(np.median(np.abs(level))) / np.sqrt(2.0)
    smallest = max(SMALLEST_STEP, STEP_IN_NOISE * noise)
    jumps = _jumps(lows, smallest)
    steps: list[tuple[int, float]] = []
    while len(steps) < MOST_STEPS:
        cell = int(np.argmax(np.abs(jumps)))
        if abs(jumps[cell]) < smallest:
            break
        row = _row_of(delay, starts, cell, float(jumps[cell]))
        steps.append((row, _size(delay, row, per_cell, float(jumps[cell]))))
        begin = row // per_cell
        jumps[max(0, min(begin, cell) - REACH) : max(begin, cell) + REACH] = 0.0
    return _drop_congestion(sorted(steps), x, delay, smallest)


def _per_cell(x: FloatArray) -> int:
    period = float(np.median(np.diff(x))) if len(x) > 1 else 1.0
    return max(FEWEST_PER_CELL, round(CELL / period)) if period > 0.0 else FEWEST_PER_CELL


def _local_slope(x: FloatArray, lows: FloatArray) -> float:
    """The usual rate at which delays change, which a few steps do not move."""
    lag = min(REACH, len(x) // 2)
    if lag < 1:
        return 0.0
    return float(np.median((lows[lag:] - lows[:-lag]) / (x[lag:] - x[:-lag])))


def _jumps(lows: FloatArray, smallest: float) -> FloatArray:
    """By how much the least delay differs between the cells before and after each cell's begin; 0: nothing.

    The second smallest of several cells stands for them, so that one stamp that is too early is no step.
    """
    count = len(lows)
    padded = np.concatenate([np.full(REACH, np.inf), lows, np.full(REACH, np.inf)])
    windows = np.sort(sliding_window_view(padded, REACH), axis=1)[:, :2]
    cells = np.arange(count)
    before = np.where(cells > 2, windows[:count, 1], windows[:count, 0])
    after = np.where(count - cells > 2, windows[REACH : REACH + count, 1], windows[REACH : REACH + count, 0])
    jumps = np.zeros(count)
    jumps[1:] = after[1:] - before[1:]
    # a few that come late at either end are of a busy machine
    late = np.where(jumps < 0.0, cells <= 2, count - cells < REACH)
    jumps[late & (np.abs(jumps) < LATEST)] = 0.0
    jumps[np.abs(jumps) < smallest] = 0.0
    return jumps


def _row_of(delay: FloatArray, starts: IntArray, cell: int, jump: float) -> int:
    """The first row after a jump: all delays on its high side lie above the middle between both levels."""
    first = int(starts[max(0, cell - REACH)])
    last = int(starts[cell + REACH]) if cell + REACH < len(starts) else len(delay)
    here = delay[first:last]
    low = float(here.min())
    below = np.flatnonzero(here < low + 0.5 * abs(jump))
    row = first + (int(below[-1]) + 1 if jump > 0.0 else int(below[0]))
    return min(max(row, 1), len(delay) - 1)


def _size(delay: FloatArray, row: int, per_cell: int, jump: float) -> float:
    """The jump at ``row``: between the delays of half a second on either side where it is sharp there."""
    sharp = float(delay[row] - delay[row - 1]) / jump
    before, after = delay[max(row - 2 * per_cell, 0) : row], delay[row : row + 2 * per_cell]
    near = float(after.min() - before.min())
    return near if sharp > 0.5 and 0.5 < near / jump < 2.0 else jump


def _drop_congestion(
    steps: list[tuple[int, float]], x: FloatArray, delay: FloatArray, smallest: float
) -> list[tuple[int, float]]:
    """Leave out rises that fall back, and falls from a late begin, where no host stamp goes back."""
    host = x + delay
    kept: list[tuple[int, float]] = []
    for row, size in steps:
        near = slice(max(row - 2, 0), row + 2)
        goes_back = size < 0.0 and bool((np.diff(host[near]) < 0.0).any())
        if size > 0.0 or goes_back or abs(size) > LATEST:
            kept.append((row, size))
            continue
        if kept and kept[-1][1] > 0.0 and x[row] - x[kept[-1][0]] < CONGESTION:
            net = kept[-1][1] + size
            rise = kept.pop()
            if abs(net) > smallest:
                kept.append((rise[0] if net > 0.0 else row, net))
        elif x[row] - x[0] >= CONGESTION:
            kept.append((row, size))
    return kept
