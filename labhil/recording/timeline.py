"""What the stamps of a table say of its rows: which follow one another, and where a clock wraps or repeats.

Nothing here knows files or units: times are arrays in s, finite, in the order of the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.signals import FloatArray, IntArray

REACH = 100
"""Median steps: a longer one is a hole. It counts only where rows are jumped over as well."""

LONGEST_SLIP = 10
"""Rows with wrong stamps in succession: a damaged block of a log. More are a stretch of their own."""

SLOWEST = 0.25
"""Median steps per row that must have passed where rows are jumped over: else the clock was set."""

ODD_HOLE = 3
"""Rows that a hole beside wrong stamps has to save: of two readings the one with fewer oddities counts."""

NO_PAUSE = 1e6
"""Times the length of all the rest: a few stamps so far away at an end are no pause but wrong."""

COINCIDENCE = 1e-3
"""Share of a clock's period: a step back that ends so near to one period is a wrap, else chance."""


@dataclass(frozen=True)
class Wrap:
    """A clock of this ``period`` (s) began anew at the rows ``at``."""

    period: float
    at: IntArray


def median_step(times: FloatArray) -> float:
    """The median of the steps forward, s; 0 where there is none."""
    steps = np.diff(times)
    rising = steps[steps > 0]
    return float(np.median(rising)) if len(rising) else 0.0


def find_wrap(times: FloatArray, periods: Sequence[tuple[float, float | None]]) -> Wrap | None:
    """Find the clock that explains most steps back.

    ``periods`` are pairs (period, top) in s: ``top`` is the reading at which the clock begins anew, or None
    where it may do so at any reading. A wrap is a step back that is an ordinary one with the period added.
    """
    steps = np.diff(times)
    back = np.flatnonzero(steps < 0)
    usual = median_step(times)
    candidates = [
        Wrap(period, back[_wraps(times[back], steps[back], period, top, usual)] + 1)
        for period, top in (periods if len(back) else ())
    ]
    best = max(candidates, key=lambda wrap: len(wrap.at), default=None)
    return best if best is not None and len(best.at) else None


def _wraps(
    before: FloatArray, steps: FloatArray, period: float, top: float | None, usual: float
) -> np.ndarray:
    near = min(max(2.5 * usual, min(REACH * usual, COINCIDENCE * period)), period / 4.0)
    wraps = (steps + period > 0.0) & (steps + period <= near)
    return wraps if top is None else wraps & (before > top - near) & (before <= top)


def unwrap(times: FloatArray, wrap: Wrap) -> FloatArray:
    """The times of a clock that goes on where it wrapped."""
    turns = np.zeros(len(times))
    turns[wrap.at] = 1.0
    return np.asarray(times + wrap.period * np.cumsum(turns), dtype=np.float64)


def increasing_stretches(times: FloatArray) -> list[IntArray]:
    """Divide the rows into stretches of increasing times, in the order of the rows.

    Each is given by the indices of its rows. A hole in increasing times begins no stretch. Up to
    ``LONGEST_SLIP`` rows in succession with wrong stamps are jumped over and are in none; where a clock was
    set back for more rows than that, another stretch begins. ``times`` (n,) must be finite.
    """
    runs: list[IntArray] = []
    todo = [(0, len(times))]
    usual = median_step(times)
    while todo:
        first, end = todo.pop()
        run = first + _longest_run(times[first:end], usual)
        runs.append(run)
        todo += [
            side
            for side in ((first, int(run[0])), (int(run[-1]) + 1, end))
            if side[1] - side[0] > LONGEST_SLIP
        ]
        if len(runs) > 1 + len(times) // LONGEST_SLIP:
            break
    long_runs = [run for run in runs if len(run) > LONGEST_SLIP] or runs[:1]
    return sorted((_trim_far_ends(run, times) for run in long_runs), key=lambda run: int(run[0]))


def _trim_far_ends(run: IntArray, times: FloatArray) -> IntArray:
    """A stretch without a few stamps at its ends that are nowhere near the others."""
    steps = np.diff(times[run])
    for hole in np.flatnonzero(steps > REACH * np.median(steps)) if len(steps) > 2 * LONGEST_SLIP else ():
        before, after = run[: hole + 1], run[hole + 1 :]
        near, far = (before, after) if len(before) > len(after) else (after, before)
        if len(far) <= LONGEST_SLIP and steps[hole] > NO_PAUSE * (times[near[-1]] - times[near[0]]):
            return near
    return run


def _longest_run(times: FloatArray, usual: float) -> IntArray:
    """The indices of the best run of increasing times, by dynamic programming.

    Each row follows the best of the ``LONGEST_SLIP`` + 1 before it. Only rows shortly after a step back, or
    after a hole, need a look at them all; further on the row before is the best.
    """
    n = len(times)
    steps = np.diff(times)
    if (steps > 0).all():
        return np.arange(n)
    back = np.concatenate(([False], steps <= 0))
    contested = np.convolve(back, np.ones(2 * LONGEST_SLIP + 1))[LONGEST_SLIP:][:n] > 0
    score = np.ones(n)
    before = np.full(n, -1, dtype=np.int64)
    breaks = np.flatnonzero(~((steps > 0) & (steps <= REACH * usual))) + 1
    starts = np.concatenate(([0], breaks))
    ends = np.concatenate((breaks, [n]))
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        near = min(end, start + LONGEST_SLIP + 2)
        for row in range(start, near):
            _append(row, times, score, before, usual, bool(contested[row]))
        if near < end:
            score[near:end] = score[near - 1] + np.arange(1, end - near + 1)
            before[near:end] = np.arange(near - 1, end - 1)
    run = []
    row = int(np.argmax(score))
    while row >= 0:
        run.append(row)
        row = int(before[row])
    return np.array(run[::-1], dtype=np.int64)


def _append(
    row: int, times: FloatArray, score: FloatArray, before: IntArray, usual: float, contested: bool
) -> None:
    """Find the row that ``row`` follows best, and note it; ``contested`` where a step back is near."""
    first = max(0, row - LONGEST_SLIP - 1)
    if first == row:
        return
    steps = times[row] - times[first:row][::-1]  # the nearest first: of equals it wins
    jumped = np.arange(len(steps))
    possible = (steps > 0) & ((jumped == 0) | (steps >= SLOWEST * usual * (jumped + 1)))
    price = np.where((steps > REACH * usual) & contested, ODD_HOLE, 0)
    scores = np.where(possible, score[first:row][::-1] - price, 0.0)
    best = int(np.argmax(scores))
    if scores[best] > 0:
        score[row] = scores[best] + 1.0
        before[row] = row - 1 - best


@dataclass(frozen=True)
class Repeats:
    """Stamps that stand in several rows each.

    ``sizes`` (stamps,) counts the rows of each; ``spread`` (n,) are the times of the rows spread evenly
    between stamps, where there is one way to do that, else None.
    """

    sizes: IntArray
    spread: FloatArray | None

    @property
    def text(self) -> str:
        """How many rows a stamp has, for messages."""
        inner = self.sizes[1:-1] if len(self.sizes) > 2 else self.sizes
        low, high = int(inner.min()), int(inner.max())
        return f"{low} rows a stamp" if low == high else f"{low} to {high} rows a stamp"


def find_repeats(times: FloatArray) -> Repeats:
    """How often each stamp stands in succession, and the times of rows that are spread between them.

    There is one way to spread them where all stamps but the first and the last have the same number of rows,
    and stand at even steps but for holes.
    """
    starts = np.concatenate(([0], np.flatnonzero(np.diff(times) != 0) + 1))
    sizes = np.diff(np.concatenate((starts, [len(times)])))
    stamps = times[starts]
    if len(stamps) < 4:
        return Repeats(sizes, None)
    count, steps = int(sizes[1]), np.diff(stamps)
    usual = float(np.median(steps))
    same = (sizes[1:-1] == count).all() and sizes[0] <= count and sizes[-1] <= count
    # rounded stamps may differ by their last digit; a tenth is far from one row more or less
    even = (steps >= 0.9 * usual).all() and np.mean(steps <= 1.1 * usual) > 0.9
    if not (same and even and usual > 0):
        return Repeats(sizes, None)
    place = np.arange(len(times)) - np.repeat(starts, sizes)
    place[: sizes[0]] += count - sizes[0]  # the first stamp has lost its first rows
    return Repeats(sizes, np.asarray(times + place * (usual / count), dtype=np.float64))


def hole_steps(t: FloatArray) -> IntArray:
    """The rows before which a hole lies: a step that is longer than usual ones and than their scatter.

    At one and a half steps of an even clock a sample is missing; a clock that jitters needs eight robust
    standard deviations more.
    """
    steps = np.diff(t)
    if not len(steps):
        return np.zeros(0, dtype=np.int64)
    usual = float(np.median(steps))
    scatter = 1.4826 * float(np.median(np.abs(steps - usual)))
    return np.flatnonzero(steps > 1.5 * usual + 8.0 * scatter) + 1
