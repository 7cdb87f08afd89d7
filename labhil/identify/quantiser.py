"""Quantisation of a channel, estimated from its readings: the step, and samples held at one value.

``rounding`` has the errors that quantisation causes.
"""

from __future__ import annotations

import numpy as np

from labhil.signals import FloatArray


def converter_step(x: FloatArray, *, tolerance: float = 0.02) -> float:
    """Find the quantisation step whose multiples all readings are.

    It compares gaps between readings, not the number of different ones: readings of a fast motion may all
    differ although they are rounded.

    Args:
        x: (n,) readings.
        tolerance: Share of the step by which a gap may differ from a whole multiple, since files round again.

    Returns:
        The step in the unit of ``x``; 0 where there is none.
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
        if np.all(np.abs(gaps - counts * step) < np.maximum(tolerance * step, rounding)):
            return step
    return 0.0


def run_lengths(x: FloatArray) -> FloatArray:
    """Length (n,) of the run of equal readings that each sample of a channel (n,) belongs to."""
    edges = np.flatnonzero(np.r_[True, np.diff(x) != 0.0, True])
    lengths = np.diff(edges)
    return np.repeat(lengths, lengths).astype(np.float64)


def held_samples(x: FloatArray, *, min_samples: int = 8, min_length_ratio: float = 5.0) -> np.ndarray:
    """Mark samples in runs of one value that are long for their channel.

    A part at rest gives such runs where its sensor has little noise, and so does a saturated sensor.

    Args:
        x: (n,) readings of a channel.
        min_samples: Shortest run that counts.
        min_length_ratio: Shortest run that counts, in lengths of the median run: slow sensors repeat
            readings, and coarse ones often read the same.

    Returns:
        (n,) of bool.
    """
    if len(x) < min_samples:
        return np.zeros(len(x), dtype=bool)
    lengths = run_lengths(x)
    # each run counts once: a sample of a run of k counts as 1/k
    order = np.argsort(lengths)
    runs = np.cumsum(1.0 / lengths[order])
    median = float(lengths[order][np.searchsorted(runs, 0.5 * runs[-1])])
    return np.asarray(lengths >= max(min_samples, min_length_ratio * median))


def uneven_step(
    x: FloatArray,
    *,
    max_count: int = 6,
    tolerance: float = 0.1,
    max_outliers: float = 0.05,
    min_readings: int = 20,
    min_toggles: int = 10,
) -> float:
    """Find the mean quantisation step of a speed that is computed from encoder counts over uneven periods.

    Readings are c/Δtᵢ with whole counts c and periods Δtᵢ that vary a little, so that steps spread with the
    count. Only readings of few counts show them; at rest a reading is exactly 0.

    Args:
        x: (n,) readings.
        max_count: Counts up to which steps are distinct: 5 % of jitter is a third of a step at six counts.
        tolerance: Distance from a whole count, in steps; by chance a fifth of readings would be so close.
        max_outliers: Share of readings of few counts that may be further away.
        min_readings: Readings of few counts that are needed: by chance all of 20 would be near whole counts
            once in 1e14.
        min_toggles: Times that a reading has to go a step up and down again within a few samples, which
            levels of a motion do not.

    Returns:
        The step in the unit of ``x``; 0 where there is none.
    """
    size = np.abs(x[x != 0.0])
    if len(size) == len(x) or len(size) < min_readings or not np.isfinite(size).all():
        return 0.0
    smallest = float(np.median(size[size <= 1.2 * np.quantile(size, 0.01)]))
    for count in (1, 2, 3):
        step = smallest / count
        few = np.sort(size[size < (max_count + 0.5) * step]) / step
        if len(few) < min_readings:
            continue
        counts = np.maximum(np.rint(few), 1.0)
        step *= float(np.median(few / counts))
        few = few * (smallest / count) / step
        outliers = np.mean(np.abs(few - np.rint(few)) > tolerance)
        if (
            outliers <= max_outliers
            and len(np.unique(np.rint(few))) >= 2
            and _count_toggles(x, step) >= min_toggles
        ):
            return step
    return 0.0


def _count_toggles(x: FloatArray, step: float, *, max_samples: int = 4) -> int:
    """Count how often a reading goes by some steps and back again within ``max_samples`` samples."""
    change = np.rint(np.diff(x) / step)
    moved = np.flatnonzero(change)
    back = change[moved[1:]] == -change[moved[:-1]]
    return int(np.sum(back & (np.diff(moved) <= max_samples)))
