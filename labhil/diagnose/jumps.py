"""Single spikes of a channel, and steps of a sensor's zero: changes that no motion makes.

A change counts against three scales: the changes of the channel nearby, its noise, and the inputs, since a
current or a speed may follow a jump of an input at once. Spikes of several samples are in
:mod:`labhil.diagnose.bursts`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from labhil.diagnose.frozen import local_change_quantile
from labhil.signals import BoolArray, FloatArray, IntArray

REACH = 15
"""Changes on either side of a change that make up its neighbourhood."""


@dataclass(frozen=True, slots=True)
class SpikeOptions:
    """Limits between a spike or burst and what a healthy channel does.

    Chosen on simulated recordings, clean and with faults; see ``tests/analysis/test_intake.py`` and the files
    beside it.

    Attributes:
        min_height_in_noise: height of each edge of a spike in standard deviations of the noise, at least.
        min_height_in_changes: the same in usual changes of the channel nearby, at least.
        max_passes: passes over a channel: spikes that stand close together hide each other.
        min_input_jump_in_range: share of an input's range below which none of its changes is a jump, since
            a measured input has noise.
        min_certain: spikes away from jumps of the inputs from which one near a jump may count as another
            of them …
        min_relative_height: … where it has at least this share of their median height …
        max_relative_rate: … and such ones come at most this many times as often near jumps as elsewhere.
    """

    min_height_in_noise: float = 12.0
    min_height_in_changes: float = 4.0
    max_passes: int = 3
    min_input_jump_in_range: float = 0.02
    min_certain: int = 3
    min_relative_height: float = 0.5
    max_relative_rate: float = 3.0


SPIKE_OPTIONS = SpikeOptions()
"""The limits that the intake works with."""


def detect_spikes(
    x: FloatArray,
    sigma: float,
    inputs: FloatArray,
    *,
    any_jump: bool = False,
    options: SpikeOptions = SPIKE_OPTIONS,
) -> IntArray:
    """Find single samples of a channel that stand out from both neighbours.

    Args:
        x: readings of the channel (n,).
        sigma: standard deviation of its noise, in its unit.
        inputs: inputs that drive the rig (n, m).
        any_jump: whether every jump of an input explains what follows it, since more than these inputs
            drives the channel.
        options: limits of a spike.

    Returns:
        Places of the spikes (k,), in order.
    """
    if len(x) < 2 * REACH + 3:
        return np.empty(0, dtype=np.int64)
    sizes, cleaned = input_jump_sizes(inputs, options.min_input_jump_in_range), x.copy()
    near_jump = np.asarray((sizes > 0.0).any(axis=1))
    accepted: list[int] = []
    for _ in range(options.max_passes):
        places = _spike_candidates(cleaned, sigma, options)
        places = places[~(near_jump[places] if any_jump else may_be_responses(sizes, places, places))]
        if not len(places):
            break
        # spikes that stand close together hide each other
        cleaned[places] = 0.5 * (cleaned[places - 1] + cleaned[places + 1])
        accepted += places.tolist()
    certain = np.array(sorted(accepted), dtype=np.int64)
    candidates = _spike_candidates(cleaned, sigma, options)
    return np.sort(np.concatenate([certain, _similar_near_jumps(x, certain, candidates, near_jump, options)]))


def detect_zero_steps(
    x: FloatArray,
    sigma: float,
    inputs: FloatArray,
    *,
    max_steps: int = 3,
    min_height_ratio: float = 3.0,
    max_neighbour_share: float = 0.2,
    options: SpikeOptions = SPIKE_OPTIONS,
) -> IntArray:
    """Find samples at which a position jumps and stays: a sensor that slipped, or whose zero was set again.

    Args:
        x: position (n,).
        sigma: standard deviation of its noise, in its unit.
        inputs: inputs that drive the rig (n, m).
        max_steps: largest number of steps that are found.
        min_height_ratio: height of a step over the largest change elsewhere in the recording, at least.
        max_neighbour_share: largest change right before or after a step, as a share of the step.
        options: limits that steps share with spikes.

    Returns:
        First sample behind each step (k,), in order.
    """
    change = np.abs(np.diff(x))
    if len(change) < 2 * REACH + 3:
        return np.empty(0, dtype=np.int64)
    candidates = np.argsort(change)[::-1][:max_steps]
    elsewhere = float(np.delete(change, candidates).max())
    places = []
    for i in candidates:
        neighbours = np.r_[change[max(i - 2, 0) : i], change[i + 1 : i + 3]]
        is_isolated = neighbours.max() < max_neighbour_share * change[i]
        if is_isolated and change[i] > max(min_height_ratio * elsewhere, options.min_height_in_noise * sigma):
            places.append(int(i) + 1)
    steps = np.array(sorted(places), dtype=np.int64)
    sizes = input_jump_sizes(inputs, options.min_input_jump_in_range)
    near_jump = np.asarray((sizes > 0.0).any(axis=1))
    return steps[~near_jump[steps]]


def usual_change(x: FloatArray, *, quantile: float = 0.85) -> FloatArray:
    """Return the usual size of changes in the neighbourhood of each change of a channel.

    Args:
        x: readings (n,).
        quantile: quantile of the sizes nearby: below one, so that a few other spikes there hide none.

    Returns:
        The usual change (n − 1,), in the unit of the channel.
    """
    return local_change_quantile(x, REACH, quantile)


def input_jump_sizes(
    inputs: FloatArray,
    min_jump_in_range: float,
    *,
    min_height_ratio: float = 3.0,
    response_samples: int = 3,
) -> FloatArray:
    """Return the size of the input jump that each sample follows closely.

    Args:
        inputs: inputs (n, m).
        min_jump_in_range: size of a jump as a share of the input's range, at least.
        min_height_ratio: size of a jump over the median change nearby, at least. The median is zero for a
            piecewise constant input, so each of its steps is a jump.
        response_samples: samples after a jump in which a change of a channel may be the response to it.

    Returns:
        Size of the jump, zero for samples that follow none, (n, m).
    """
    sizes = np.zeros(inputs.shape)
    for j, column in enumerate(inputs.T):
        change = np.r_[0.0, np.abs(np.diff(column))]
        recent = _windowed_maximum(change, response_samples, 1)
        nearby = np.sort(sliding_window_view(np.pad(change, REACH, mode="edge"), 2 * REACH + 1), axis=1)
        median = nearby[:, REACH]
        near_jump = (recent > min_height_ratio * median) & (
            recent > min_jump_in_range * float(np.ptp(column))
        )
        sizes[near_jump, j] = recent[near_jump]
    return sizes


def may_be_responses(
    sizes: FloatArray,
    places: IntArray,
    all_places: IntArray,
    *,
    min_relative_size: float = 0.8,
    min_unanswered: int = 3,
) -> BoolArray:
    """Return which jumps of a channel may be responses to jumps of an input.

    An input jump explains a jump of the channel only where most input jumps of that size are followed by one.

    Args:
        sizes: result (n, m) of :func:`input_jump_sizes`.
        places: samples (k,) at which the channel jumps.
        all_places: all samples at which it jumps.
        min_relative_size: share of an input jump's size from which others count as being as large.
        min_unanswered: input jumps of that size without a jump of the channel, from which they can be the
            majority.

    Returns:
        Marks (k,) of the jumps that may be responses.
    """
    is_response = np.zeros(len(places), dtype=bool)
    for size in sizes.T:
        begins = np.flatnonzero((size > 0.0) & ~np.r_[False, size[:-1] > 0.0])
        largest = np.maximum.reduceat(size, begins) if len(begins) else np.empty(0)
        answered_jumps = np.searchsorted(begins, all_places[size[all_places] > 0.0], side="right") - 1
        is_answered = np.isin(np.arange(len(begins)), answered_jumps)
        for i in np.flatnonzero(size[places] > 0.0):
            as_large = largest >= min_relative_size * size[places[i]]
            n_unanswered = int(np.sum(as_large & ~is_answered))
            is_response[i] |= n_unanswered < max(min_unanswered, int(np.sum(as_large & is_answered)))
    return is_response


def _spike_candidates(x: FloatArray, sigma: float, options: SpikeOptions) -> IntArray:
    """Single samples (k,) that stand out from both neighbours, whatever the inputs do."""
    change = np.diff(x)
    rises, falls = change[:-1], change[1:]
    height = np.where(rises * falls < 0.0, np.minimum(np.abs(rises), np.abs(falls)), 0.0)
    usual = usual_change(x)
    usual = np.maximum(usual[:-1], usual[1:])
    # both neighbours of a spike agree, those of a fast motion's peak need not
    neighbours_agree = np.abs(rises + falls) < 0.5 * height + 3.0 * sigma
    stands_out = (
        (height > options.min_height_in_noise * sigma)
        & (height > options.min_height_in_changes * usual)
        & neighbours_agree
    )
    return np.flatnonzero(stands_out).astype(np.int64) + 1


def _similar_near_jumps(
    x: FloatArray, certain: IntArray, candidates: IntArray, near_jump: BoolArray, options: SpikeOptions
) -> IntArray:
    """The ``candidates`` near jumps of an input that are as high as the ``certain`` spikes elsewhere.

    None where they are more frequent near jumps than elsewhere: spikes fall anywhere.
    """
    if len(certain) < options.min_certain:
        return np.empty(0, dtype=np.int64)
    height = np.abs(x - 0.5 * (np.roll(x, 1) + np.roll(x, -1)))
    candidates = candidates[near_jump[candidates]]
    n_by_chance = len(certain) / float(np.sum(~near_jump)) * float(np.sum(near_jump))
    if len(candidates) > max(options.max_relative_rate * n_by_chance, 1.0):
        return np.empty(0, dtype=np.int64)
    return candidates[height[candidates] >= options.min_relative_height * np.median(height[certain])]


def _windowed_maximum(x: FloatArray, before: int, after: int) -> FloatArray:
    """Maximum of ``x`` (n,) over a window from ``before`` to ``after`` samples around each sample, (n,)."""
    padded = np.pad(x, (before, after), mode="edge")
    return np.asarray(sliding_window_view(padded, before + after + 1).max(axis=1))
