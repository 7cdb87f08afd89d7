"""Bursts of a few wrong readings in a row, and dropouts: readings that jump to one value and come back.

A burst differs from motion at both of its edges: a disturbed body does not return to its course from one
sample to the next. A rate may do so where a body at rest slips, so a burst out of rest counts only where
there are others like it elsewhere. Single spikes are in :mod:`labhil.diagnose.jumps`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.diagnose.frozen import ConstantRuns, constant_runs
from labhil.diagnose.jumps import (
    SPIKE_OPTIONS,
    SpikeOptions,
    input_jump_sizes,
    may_be_responses,
    usual_change,
)
from labhil.signals import BoolArray, FloatArray, IntArray

NO_SPANS: IntArray = np.empty((0, 2), dtype=np.int64)
"""First and last samples (k, 2) of no span at all."""


@dataclass(frozen=True, slots=True)
class BurstOptions:
    """Limits between a burst or dropout and what a healthy channel does.

    Chosen on simulated recordings, clean and with faults; see ``tests/analysis/test_intake_bursts.py``.

    Attributes:
        max_samples: samples of a burst at most. A longer fault shows as a channel that is stuck.
        max_end_samples: samples of a burst at most with which a recording begins or ends.
        min_end_height_ratio: height of the one edge of such a burst over the largest change elsewhere in the
            recording, at least.
        max_rest_in_noise: largest distance, in standard deviations of the noise, at which two readings count
            as equal and a rate as zero.
        max_neighbour_difference: difference of the readings on either side of a burst at most, as a share of
            its height.
        min_dropout_length_ratio: length of a dropout over the usual length of runs of equal readings, at
            least: slow sensors repeat readings.
        min_edge_in_steps: height of the smaller edge of a dropout over the steps before and after it, at
            least: the motion itself, read in steps of a converter, changes by up to twice its usual step.
        spike: limits that bursts share with single spikes.
    """

    max_samples: int = 8
    max_end_samples: int = 3
    min_end_height_ratio: float = 2.0
    max_rest_in_noise: float = 4.0
    max_neighbour_difference: float = 0.5
    min_dropout_length_ratio: float = 5.0
    min_edge_in_steps: float = 2.0
    spike: SpikeOptions = SPIKE_OPTIONS


BURST_OPTIONS = BurstOptions()
"""The limits that the intake works with."""


def detect_bursts(
    x: FloatArray, sigma: float, inputs: FloatArray, *, is_rate: bool, options: BurstOptions = BURST_OPTIONS
) -> IntArray:
    """Find bursts of two or more wrong readings in a row in a channel.

    Args:
        x: readings (n,), with single spikes already replaced.
        sigma: standard deviation of the noise, in the unit of the channel.
        inputs: inputs that drive the rig (n, m).
        is_rate: whether the channel is no position: it may slip, and may follow the inputs at once.
        options: limits of a burst.

    Returns:
        First and last sample of each burst (k, 2), in order.
    """
    if len(x) < 2 * options.max_samples + 2:
        return NO_SPANS
    sizes = input_jump_sizes(inputs, options.spike.min_input_jump_in_range)
    cleaned, accepted = x.copy(), []
    in_doubt = []
    for _ in range(options.spike.max_passes):
        usual = usual_change(cleaned)
        widths = range(2, options.max_samples + 1)
        spans = _disjoint(
            np.concatenate([_burst_candidates(cleaned, usual, sigma, width, options) for width in widths])
        )
        if not len(spans):
            break
        is_doubtful = _explained_by_inputs(sizes, spans[:, 0], spans[:, 1] + 1, is_rate=is_rate)
        is_doubtful |= is_rate & _start_from_rest(cleaned, sigma, spans, options.max_rest_in_noise)
        accepted += spans[~is_doubtful].tolist()
        in_doubt += spans[is_doubtful].tolist()
        cleaned = interpolate_over(cleaned, spans)
    certain = np.array(accepted, dtype=np.int64).reshape(-1, 2)
    doubtful = np.array(in_doubt, dtype=np.int64).reshape(-1, 2)
    bursts = np.concatenate([certain, _similar_bursts(x, certain, doubtful, options.spike)])
    return bursts[np.argsort(bursts[:, 0])]


def detect_bursts_at_ends(
    x: FloatArray, sigma: float, inputs: FloatArray, *, options: BurstOptions = BURST_OPTIONS
) -> IntArray:
    """Find the wrong readings with which a channel begins or ends.

    They have one edge only, so it also has to be larger than all other changes of the channel.

    Args:
        x: readings (n,), with spikes and bursts already replaced.
        sigma: standard deviation of the noise, in the unit of the channel.
        inputs: inputs that drive the rig (n, m).
        options: limits of a burst.

    Returns:
        First and last sample of each burst, (k, 2) with k ≤ 2.
    """
    if len(x) < 2 * options.max_end_samples + 2 * options.max_samples:
        return NO_SPANS
    spans = [(0, width - 1) for width in _wrong_first_samples(x, sigma, inputs, options)]
    spans += [
        (len(x) - width, len(x) - 1) for width in _wrong_first_samples(x[::-1], sigma, inputs[::-1], options)
    ]
    return np.array(spans, dtype=np.int64).reshape(-1, 2)


def detect_dropouts(
    x: FloatArray, sigma: float, inputs: FloatArray, *, is_rate: bool, options: BurstOptions = BURST_OPTIONS
) -> ConstantRuns:
    """Find runs of equal readings that a channel jumps into and back out of.

    A body comes to rest and leaves it gradually. What the inputs explain does not count.

    Args:
        x: readings (n,), with spikes and bursts already replaced.
        sigma: standard deviation of the noise, in the unit of the channel.
        inputs: inputs that drive the rig (n, m).
        is_rate: whether the channel is no position. Such a channel may follow a piecewise constant input
            from level to level, so only runs at zero, or at one value several times, count.
        options: limits of a dropout.

    Returns:
        The dropouts.
    """
    runs = constant_runs(x)
    usual_length = float(np.median(runs.length))
    is_inner = (runs.start > 0) & (runs.stop < len(x))
    runs = runs.select(is_inner & (runs.length >= options.min_dropout_length_ratio * usual_length))
    if not len(runs.start):
        return runs
    change = np.diff(x)
    rise, fall = change[runs.start - 1], change[runs.stop - 1]
    # a sensor that freezes during a motion was reached by a step as large as the one before
    steps = change[np.maximum(runs.start - 2, 0)], change[np.minimum(runs.stop, len(change) - 1)]
    smaller, larger = np.sort([np.abs(rise), np.abs(fall)], axis=0)
    beyond_motion = smaller - options.min_edge_in_steps * np.abs(steps).max(axis=0)
    min_height = np.maximum(
        options.spike.min_height_in_noise * sigma,
        options.spike.min_height_in_changes * _usual_change_around(x, runs.start, runs.stop),
    )
    # a reading that goes on by chance near the value of the run leaves it by little
    runs = runs.select(
        (rise * fall < 0.0) & (larger > min_height) & (beyond_motion > options.max_rest_in_noise * sigma)
    )
    value, count = np.unique(x[runs.start], return_counts=True)
    is_eligible = (value == 0.0) | (count > 1) | (not is_rate)
    runs = runs.select(is_eligible[np.searchsorted(value, x[runs.start])])
    sizes = input_jump_sizes(inputs, options.spike.min_input_jump_in_range)
    return runs.select(~_explained_by_inputs(sizes, runs.start, runs.stop, is_rate=is_rate))


def interpolate_over(x: FloatArray, spans: IntArray) -> FloatArray:
    """Replace spans of a channel by a straight line between the readings on either side.

    Args:
        x: readings (n,).
        spans: first and last sample of each span (k, 2). At an end of the channel the one neighbour is kept.

    Returns:
        The channel (n,) with the spans replaced.
    """
    kept = np.flatnonzero(~span_mask(spans, len(x)))
    return np.asarray(np.interp(np.arange(len(x)), kept, x[kept])) if len(kept) else x


def span_mask(spans: IntArray, n: int) -> BoolArray:
    """Return which of ``n`` samples lie within the spans (k, 2) of first and last samples, (n,)."""
    mask = np.zeros(n, dtype=bool)
    for first, last in spans.tolist():
        mask[first : last + 1] = True
    return mask


def _wrong_first_samples(x: FloatArray, sigma: float, inputs: FloatArray, options: BurstOptions) -> list[int]:
    """The number of wrong readings with which a channel begins; empty where it begins with none."""
    change = np.abs(np.diff(x))
    largest = float(change[options.max_end_samples :].max())
    min_height = max(options.spike.min_height_in_noise * sigma, options.min_end_height_ratio * largest)
    min_input_jump = options.spike.min_input_jump_in_range * np.ptp(inputs, axis=0)
    for width in range(options.max_end_samples, 0, -1):
        input_jumps = np.abs(np.diff(inputs[: width + 2], axis=0)) > min_input_jump
        if change[width - 1] > min_height and not input_jumps.any():
            return [width]
    return []


def _explained_by_inputs(sizes: FloatArray, first: IntArray, after: IntArray, *, is_rate: bool) -> BoolArray:
    """Whether input jumps of these ``sizes`` (n, m) may explain jumps away and back, (k,).

    ``first`` are the first samples away, ``after`` the first samples back. A rate may jump with an input and
    then return by itself; a position needs an input jump at both edges.
    """
    after = np.minimum(after, len(sizes) - 1)
    edges = np.unique(np.concatenate([first, after]))
    begins, ends = may_be_responses(sizes, first, edges), may_be_responses(sizes, after, edges)
    return np.asarray(begins | ends if is_rate else begins & ends)


def _usual_change_around(x: FloatArray, start: IntArray, stop: IntArray) -> FloatArray:
    """How a channel usually changes around the runs ``start`` … ``stop`` − 1, (r,)."""
    change = usual_change(x)
    return np.asarray(np.maximum(change[start - 1], change[np.minimum(stop, len(change) - 1)]))


def _burst_candidates(
    x: FloatArray, usual: FloatArray, sigma: float, width: int, options: BurstOptions
) -> IntArray:
    """Spans of ``width`` samples that all stand out from the line between their neighbours, (k, 2)."""
    n = len(x) - width - 1
    before, after = x[:n], x[width + 1 :]
    usual = np.maximum(usual[:n], usual[width : width + n])
    min_height = np.maximum(
        options.spike.min_height_in_noise * sigma, options.spike.min_height_in_changes * usual
    )
    height = np.minimum(np.abs(x[1 : n + 1] - before), np.abs(after - x[width : width + n]))
    for k in range(1, width + 1):
        line = before + (after - before) * k / (width + 1)
        height = np.minimum(height, np.abs(x[k : k + n] - line))
    neighbours_agree = np.abs(after - before) < options.max_neighbour_difference * height + 3.0 * sigma
    sample_before = np.flatnonzero((height > min_height) & neighbours_agree)
    return np.column_stack([sample_before + 1, sample_before + width]).astype(np.int64)


def _disjoint(spans: IntArray) -> IntArray:
    """The spans (k, 2) that touch no span earlier in the list, which begins with the narrowest."""
    chosen: list[list[int]] = []
    for first, last in spans.tolist():
        if all(last < a - 1 or first > b + 1 for a, b in chosen):
            chosen.append([first, last])
    return np.array(chosen, dtype=np.int64).reshape(-1, 2)


def _start_from_rest(x: FloatArray, sigma: float, spans: IntArray, max_rest_in_noise: float) -> BoolArray:
    """Which spans have readings of zero, up to noise, on both sides, (k,)."""
    neighbours = np.maximum(np.abs(x[spans[:, 0] - 1]), np.abs(x[spans[:, 1] + 1]))
    return np.asarray(neighbours <= max_rest_in_noise * sigma)


def _similar_bursts(x: FloatArray, certain: IntArray, doubtful: IntArray, options: SpikeOptions) -> IntArray:
    """The ``doubtful`` spans (k, 2) that are as high as the ``certain`` ones; none where they are more."""
    if len(certain) < options.min_certain or len(doubtful) > len(certain):
        return NO_SPANS
    heights = [np.abs(x[spans[:, 0]] - x[spans[:, 0] - 1]) for spans in (certain, doubtful)]
    return np.asarray(doubtful[heights[1] >= options.min_relative_height * np.median(heights[0])])
