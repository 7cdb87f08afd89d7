"""Relation between two clocks when one of them is read late: line of the least delay, and its steps.

The device stamps a sample when it takes it. The host stamps it on arrival, after the delay of wire and
scheduler, which is never negative, sometimes large, and often large for many samples in a row. The line
between the clocks therefore follows the smallest delays, as in NTP's clock filter and in Moon, Skelly and
Towsley (INFOCOM 1999): here a low quantile of the smallest delays of many blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from labhil.signals import FloatArray, IntArray

MIN_STEP = 0.02
"""Smallest step of a clock, s. A busy machine delays samples by less for ``REACH_CELLS`` cells."""

MAX_CONGESTION = 10.0
"""Longest time for which queues stay full, s.

A delay that decreases again within it, without a stamp before its predecessor, is of a busy machine, not of
a clock.
"""

MAX_DELAY = 2.0
"""Longest delay of a sample, s. A host gives its device up after it, so a larger jump is a step."""

CELL, REACH_CELLS, MIN_CELL_SAMPLES = 0.25, 8, 4
"""Length of a cell, s, cells on either side of a step (2 s each), and samples in a cell.

A step is the difference of the smallest delays on both sides.
"""


@dataclass(frozen=True, slots=True)
class ClockStep:
    """A step of the host's stamps against the device's clock.

    Attributes:
        row: the first sample after it.
        size: s of the host; positive where the host's stamps jump ahead.
    """

    row: int
    size: float


@dataclass(frozen=True, slots=True)
class DelayLine:
    """Least delay of the host's stamps, ``level + slope * (x - middle)``, s.

    Attributes:
        middle: middle of the fitted stretch, s of the device's clock.
        level: least delay there, s.
        slope: its rate of change.
        level_error: standard error of ``level``, s; None if unknown.
        slope_error: standard error of ``slope``; None if unknown.
        span: length of the fitted stretch, s.
    """

    middle: float
    level: float
    slope: float
    level_error: float | None
    slope_error: float | None
    span: float

    def at(self, x: FloatArray) -> FloatArray:
        """Least delay (n,), s, at times ``x`` (n,) of the device's clock, s."""
        return np.asarray(self.level + self.slope * (x - self.middle), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class ClockMap:
    """Piecewise linear map between a device's clock and the host's.

    ``x`` is the time since the device's first sample, in s of the host. The least delay is a line between
    steps of the host's stamps.

    Attributes:
        zero_ns: the device's clock at its first sample.
        origin_ns: Unix time from which host times are measured, in s.
        speed: seconds of the device's world per second of the host.
        begins: ``x`` where each line begins, (k,).
        levels: height of each line at ``middle``, (k,) s.
        slope: slope of all lines.
        middle: ``x`` in the middle of the longest line.
        end: ``x`` of the last sample.
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
        """Time ``x`` (n,) since the device's first sample, s of the host."""
        return np.asarray((t_hw_ns - self.zero_ns) * (1e-9 / self.speed), dtype=np.float64)

    def host(self, x: FloatArray) -> FloatArray:
        """Host times (n,), s, at ``x`` (n,), with the steps of the host's clock."""
        segment = np.maximum(np.searchsorted(self.begins, x, side="right") - 1, 0)
        return np.asarray(x + self.levels[segment] + self.slope * (x - self.middle), dtype=np.float64)

    def steady_host(self, x: FloatArray) -> FloatArray:
        """Host times (n,), s, at ``x`` (n,), by the host's clock as it ran after its last step."""
        return np.asarray(x + self.levels[-1] + self.slope * (x - self.middle), dtype=np.float64)

    def device(self, host: float) -> float:
        """Time ``x`` of a host time, s; the later one where a clock that was set back shows it twice."""
        ends = np.append(self.begins[1:], self.end)
        first, last = (x + self.levels + self.slope * (x - self.middle) for x in (self.begins, ends))
        away = np.maximum(np.maximum(first - host, host - last), 0.0)
        segment = int(np.flatnonzero(away == away.min())[-1])
        x = float(host - self.levels[segment] + self.slope * self.middle) / (1.0 + self.slope)
        # the device stood still between the end of a line and the begin of the next
        return min(x, float(ends[segment])) if segment + 1 < len(ends) else x


def fit_delay_line(
    x: FloatArray,
    delay: FloatArray,
    *,
    min_span: float = 1.0,
    min_error_samples: int = 32,
    block: float = 0.25,
    max_blocks: int = 64,
) -> DelayLine:
    """Fit a line along the smallest delays.

    Args:
        x: the device's clock, s, increasing, (n,) with n ≥ 1.
        delay: the host's clock minus the device's, s, (n,).
        min_span: shortest stretch from which a rate can be estimated, s.
        min_error_samples: samples from which standard errors are estimated.
        block: shortest block, s of the host. A busy scheduler delays a process by less, so most blocks have
            a sample without delay.
        max_blocks: largest number of blocks.

    Returns:
        The line.
    """
    middle, span = float(0.5 * (x[0] + x[-1])), float(x[-1] - x[0])
    if len(x) < 3 or span < min_span:
        return DelayLine(middle, float(delay.min()), 0.0, None, None, span)
    count = min(max_blocks, max(8, int(span / block)), max(3, len(x) // 4))
    bx, by = _block_minima(x - middle, delay, count)
    level, slope = _quantile_line(bx, by)
    if len(x) < min_error_samples:
        return DelayLine(middle, level, slope, None, None, span)
    return DelayLine(middle, level, slope, *_standard_errors(bx, by, level, slope), span)


def _block_minima(x: FloatArray, y: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    starts = np.linspace(0, len(x), count, endpoint=False).astype(int)
    ends = np.append(starts[1:], len(x))
    rows = [start + int(np.argmin(y[start:end])) for start, end in zip(starts, ends, strict=True)]
    return x[rows], y[rows]


def _quantile_line(x: FloatArray, y: FloatArray, quantile: float = 0.1) -> tuple[float, float]:
    """Level and slope of the quantile regression line of points (n,), which passes through two of them.

    A few points below it, which are too early, do not move it.
    """
    first, second = np.triu_indices(len(x), k=1)
    slope = (y[second] - y[first]) / (x[second] - x[first])
    level = y[first] - slope * x[first]
    above = y - level[:, None] - slope[:, None] * x
    loss = np.sum(np.where(above > 0.0, quantile * above, (quantile - 1.0) * above), axis=1)
    best = int(np.argmin(loss))
    return float(level[best]), float(slope[best])


def _standard_errors(
    x: FloatArray, y: FloatArray, level: float, slope: float, n_groups: int = 8, min_error: float = 1e-6
) -> tuple[float, float]:
    """Standard errors of level and slope; ``min_error`` (s) is the accuracy of stamps.

    The jackknife leaves out groups of consecutive points, since delays of neighbours are correlated. The
    scatter of the points about the line is added: a line through two outliers does not move when other
    points are left out.
    """
    groups = np.array_split(np.arange(len(x)), min(n_groups, len(x)))
    without = np.array(
        [_quantile_line(np.delete(x, g), np.delete(y, g)) for g in groups if len(x) - len(g) > 2]
    )
    share = (len(groups) - 1) / len(groups)
    level_jack, slope_jack = np.sqrt(share * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
    # delays are one-sided: mean of an exponential distribution, median / ln 2. One median per group, since
    # the median of all ignores a busy half of the recording
    residual = np.abs(y - level - slope * x)
    typical = float(np.quantile([np.median(residual[group]) for group in groups], 0.75))
    scatter = typical / np.log(2.0) / np.sqrt(len(x))
    spread = float(np.std(x))
    return (
        float(np.hypot(level_jack, scatter) + min_error),
        float(np.hypot(slope_jack, scatter / spread) + min_error / spread),
    )


def find_steps(
    x: FloatArray, delay: FloatArray, *, min_noise_ratio: float = 8.0, max_steps: int = 1000
) -> list[tuple[int, float]]:
    """Find lasting jumps of the least delay; samples that are late for a while are none.

    Args:
        x: the device's clock, s, increasing, (n,).
        delay: the host's clock minus the device's, s, (n,).
        min_noise_ratio: smallest step, in robust standard deviations of a cell's smallest delay.
        max_steps: steps after which the search ends.

    Returns:
        The first row after each step and its size (s), by row.
    """
    per_cell = _samples_per_cell(x)
    if len(x) < 2 * per_cell:
        return []
    starts = np.arange(0, len(x) - per_cell + 1, per_cell)
    lows = np.minimum.reduceat(delay, starts)
    lows = lows - _local_slope(x[starts], lows) * (x[starts] - x[0])
    level = np.concatenate([[0.0], np.diff(lows)])
    noise = 1.4826 * float(np.median(np.abs(level))) / np.sqrt(2.0)
    smallest = max(MIN_STEP, min_noise_ratio * noise)
    jumps = _jumps(lows, smallest)
    steps: list[tuple[int, float]] = []
    while len(steps) < max_steps:
        cell = int(np.argmax(np.abs(jumps)))
        if abs(jumps[cell]) < smallest:
            break
        row = _locate_step(delay, starts, cell, float(jumps[cell]))
        steps.append((row, _measure_step(delay, row, per_cell, float(jumps[cell]))))
        begin = row // per_cell
        jumps[max(0, min(begin, cell) - REACH_CELLS) : max(begin, cell) + REACH_CELLS] = 0.0
    return _drop_congestion(sorted(steps), x, delay, smallest)


def _samples_per_cell(x: FloatArray) -> int:
    period = float(np.median(np.diff(x))) if len(x) > 1 else 1.0
    return max(MIN_CELL_SAMPLES, round(CELL / period)) if period > 0.0 else MIN_CELL_SAMPLES


def _local_slope(x: FloatArray, lows: FloatArray) -> float:
    """Median rate of change of the delays, which a few steps do not move."""
    lag = min(REACH_CELLS, len(x) // 2)
    if lag < 1:
        return 0.0
    return float(np.median((lows[lag:] - lows[:-lag]) / (x[lag:] - x[:-lag])))


def _jumps(lows: FloatArray, smallest: float) -> FloatArray:
    """Difference of the least delays after and before each cell's begin, s; 0 below ``smallest``.

    Where there are several cells, their second smallest delay counts, so a single early stamp is no step.
    """
    count, width = len(lows), REACH_CELLS
    padded = np.concatenate([np.full(width, np.inf), lows, np.full(width, np.inf)])
    windows = np.sort(sliding_window_view(padded, width), axis=1)[:, :2]
    cells = np.arange(count)
    before = np.where(cells > 2, windows[:count, 1], windows[:count, 0])
    after = np.where(count - cells > 2, windows[width : width + count, 1], windows[width : width + count, 0])
    jumps = np.zeros(count)
    jumps[1:] = after[1:] - before[1:]
    # a few late samples at either end are of a busy machine
    late = np.where(jumps < 0.0, cells <= 2, count - cells < width)
    jumps[late & (np.abs(jumps) < MAX_DELAY)] = 0.0
    jumps[np.abs(jumps) < smallest] = 0.0
    return jumps


def _locate_step(delay: FloatArray, starts: IntArray, cell: int, jump: float) -> int:
    """The first row after a step: delays on its high side lie above the mean of both levels."""
    first = int(starts[max(0, cell - REACH_CELLS)])
    last = int(starts[cell + REACH_CELLS]) if cell + REACH_CELLS < len(starts) else len(delay)
    nearby = delay[first:last]
    low = float(nearby.min())
    below = np.flatnonzero(nearby < low + 0.5 * abs(jump))
    row = first + (int(below[-1]) + 1 if jump > 0.0 else int(below[0]))
    return min(max(row, 1), len(delay) - 1)


def _measure_step(delay: FloatArray, row: int, per_cell: int, jump: float) -> float:
    """Size of the step at ``row``, s; of a sharp one between the delays of half a second on either side."""
    sharp = float(delay[row] - delay[row - 1]) / jump
    before, after = delay[max(row - 2 * per_cell, 0) : row], delay[row : row + 2 * per_cell]
    near = float(after.min() - before.min())
    return near if sharp > 0.5 and 0.5 < near / jump < 2.0 else jump


def _drop_congestion(
    steps: list[tuple[int, float]], x: FloatArray, delay: FloatArray, smallest: float
) -> list[tuple[int, float]]:
    """Drop rises that fall back and falls after a late begin, unless a host stamp goes back."""
    host = x + delay
    lasting: list[tuple[int, float]] = []
    for row, size in steps:
        near = slice(max(row - 2, 0), row + 2)
        goes_back = size < 0.0 and bool((np.diff(host[near]) < 0.0).any())
        if size > 0.0 or goes_back or abs(size) > MAX_DELAY:
            lasting.append((row, size))
            continue
        if lasting and lasting[-1][1] > 0.0 and x[row] - x[lasting[-1][0]] < MAX_CONGESTION:
            net = lasting[-1][1] + size
            rise = lasting.pop()
            if abs(net) > smallest:
                lasting.append((rise[0] if net > 0.0 else row, net))
        elif x[row] - x[0] >= MAX_CONGESTION:
            lasting.append((row, size))
    return lasting
