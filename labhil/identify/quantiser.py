"""What readings show of the quantiser behind them: its step, and samples that it holds at one value."""

from __future__ import annotations

import numpy as np

from labhil.signals import FloatArray

STRAY = 0.02
"""Share of a converter's step by which what is rounded to it may stray: files round again."""

SHORTEST_HOLD = 8
"""Equal readings in a row, at least, of a channel that is held …"""

UNUSUAL_HOLD = 5.0
"""… and so many times what is usual in its channel: slow sensors repeat readings, coarse ones stay."""

COUNTS = 6
"""Counts up to which uneven steps are distinct: 5 % of jitter is a third of a step at six of them."""

NEAR_A_COUNT = 0.1
"""Steps within which readings of few counts lie about whole ones; by chance a fifth of them would."""

FEWEST_COUNTED = 20
"""Readings of few counts, at least: by chance all of so many would be near whole counts once in 1e14."""

OFF_COUNT = 0.05
"""Share of them that may lie elsewhere."""

TOGGLES = 10
"""Times that a reading goes a step up and down again within a few samples: levels of a motion do not."""

TOGGLE = 4
"""Samples within which it does."""


def converter_step(x: FloatArray) -> float:
    """The step whose multiples all readings (n,) are, or 0 when there is none.

    Readings of a fast motion may all differ although they are rounded, so it is not their number that counts.
    """
    gaps = np.diff(np.unique(x))
    rounding = 64.0 * np.finfo(np.float64).eps * float(np.abs(x).max(initial=0.0))
    gaps = gaps[gaps > rounding]
    if not len(gaps):
        return 0.0
    for parts in (1, 2, 3, 4):
        step = float(gaps.min()) / parts
        counts = np.rint(gaps / step)
        step = float(gaps.sum() / counts.sum())
        if np.all(np.abs(gaps - counts * step) < np.maximum(STRAY * step, rounding)):
            return step
    return 0.0


def run_lengths(x: FloatArray) -> FloatArray:
    """For every sample of a channel (n,) the number of equal readings in a row that it is one of, (n,)."""
    edges = np.flatnonzero(np.r_[True, np.diff(x) != 0.0, True])
    lengths = np.diff(edges)
    return np.repeat(lengths, lengths).astype(np.float64)


def held_samples(x: FloatArray) -> np.ndarray:
    """Which samples (n,) stand in runs of one value that are long for their channel.

    A part at rest reads so where its sensor is quiet, and so does a sensor at the end of its range.
    """
    if len(x) < SHORTEST_HOLD:
        return np.zeros(len(x), dtype=bool)
    lengths = run_lengths(x)
    # each run counts once: a sample of a run of k is a k-th of it
    order = np.argsort(lengths)
    runs = np.cumsum(1.0 / lengths[order])
    usual = float(lengths[order][np.searchsorted(runs, 0.5 * runs[-1])])
    return np.asarray(lengths >= max(SHORTEST_HOLD, UNUSUAL_HOLD * usual))


def uneven_step(x: FloatArray) -> float:
    """The step of readings (n,) that are counts over periods that vary a little, or 0 when they are none.

    Such as an encoder's counts in a loop that is not quite periodic: c/Δtᵢ, with steps that spread with the
    periods. Only readings of few counts show them; there a reading at rest is exactly 0.
    """
    size = np.abs(x[x != 0.0])
    if len(size) == len(x) or len(size) < FEWEST_COUNTED or not np.isfinite(size).all():
        return 0.0
    smallest = float(np.median(size[size <= 1.2 * np.quantile(size, 0.01)]))
    for count in (1, 2, 3):
        step = smallest / count
        few = np.sort(size[size < (COUNTS + 0.5) * step]) / step
        if len(few) < FEWEST_COUNTED:
            continue
        counts = np.maximum(np.rint(few), 1.0)
        step *= float(np.median(few / counts))
        few = few * (smallest / count) / step
        stray_share = np.mean(np.abs(few - np.rint(few)) > NEAR_A_COUNT)
        if stray_share <= OFF_COUNT and len(np.unique(np.rint(few))) >= 2 and _toggles(x, step) >= TOGGLES:
            return step
    return 0.0


def _toggles(x: FloatArray, step: float) -> int:
    """How often a reading goes some step up or down and back again within ``TOGGLE`` samples."""
    change = np.rint(np.diff(x) / step)
    moved = np.flatnonzero(change)
    back = change[moved[1:]] == -change[moved[:-1]]
    return int(np.sum(back & (np.diff(moved) <= TOGGLE)))
