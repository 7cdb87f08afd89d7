"""Samples that no motion leads to: single spikes, and steps of a sensor's zero.

Both are held against how the channel changes from sample to sample nearby, against its noise, and
against the inputs: where an input jumps, a current or a speed may follow at once.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from labhil.diagnose.frozen import local_scale
from labhil.signals import FloatArray, IntArray

REACH = 15
"""Samples on either side that say how the channel changes nearby."""

USUAL = 0.85
"""Quantile of these changes: a few other spikes among them do not hide one."""

BEYOND_NOISE = 12.0
BEYOND_MOTION = 4.0
SUDDEN = 3.0
"""An input jumps where it changes this many times as much as anywhere else nearby."""

NOTABLE = 0.02
"""Share of an input's range under which none of its changes is a jump: a measured input has noise."""

AFTER_JUMP = 3
"""Samples from a jump of an input in which what happens may be its answer."""

AS_LARGE = 0.8
"""Share of a jump's size from which others count as being as large."""

UNANSWERED = 3
"""Jumps as large that nothing followed, at least, before one explains nothing either."""

ROUNDS = 3

ENOUGH = 3
"""Spikes elsewhere from which one close upon a jump of an input is known for another of them …"""

AS_HIGH = 0.5
"""… where it has this share of their median height …"""

OFTEN = 3.0
"""… and such ones come at most this many times as often there as elsewhere."""

STEP_BEYOND = 3.0
"""A step of the zero, in largest changes elsewhere in the recording."""

MOST_STEPS = 3
ALONE = 0.2
"""What comes right before and after a step of the zero is below this share of it."""


def spikes(x: FloatArray, sigma: float, inputs: FloatArray, *, any_jump: bool = False) -> IntArray:
    """Places of single samples of a channel (n,) that stand out from both neighbours, (k,).

    ``sigma`` is the channel's noise, ``inputs`` (n, m) drive the rig. Where more than these drives the
    channel, ``any_jump`` of an input explains what is close upon it.
    """
    if len(x) < 2 * REACH + 3:
        return np.empty(0, dtype=np.int64)
    sizes, calm = jump_sizes(inputs), x.copy()
    near = np.asarray((sizes > 0.0).any(axis=1))
    certain: list[int] = []
    for _ in range(ROUNDS):
        places = _standing_out(calm, sigma)
        places = places[~(near[places] if any_jump else answers(sizes, places, places))]
        if not len(places):
            break
        # spikes that stand close together hide each other
        calm[places] = 0.5 * (calm[places - 1] + calm[places + 1])
        certain += places.tolist()
    sure = np.array(sorted(certain), dtype=np.int64)
    return np.sort(np.concatenate([sure, _alike(x, sure, _standing_out(calm, sigma), near)]))


def _standing_out(x: FloatArray, sigma: float) -> IntArray:
    """The same, also where an input jumps."""
    change = np.diff(x)
    rises, falls = change[:-1], change[1:]
    height = np.where(rises * falls < 0.0, np.minimum(np.abs(rises), np.abs(falls)), 0.0)
    usual = usual_change(x)
    usual = np.maximum(usual[:-1], usual[1:])
    # neighbours agree with each other: a peak of a fast motion has slopes, a spike has a floor
    floor = np.abs(rises + falls) < 0.5 * height + 3.0 * sigma
    stands_out = (height > BEYOND_NOISE * sigma) & (height > BEYOND_MOTION * usual) & floor
    return np.flatnonzero(stands_out).astype(np.int64) + 1


def usual_change(x: FloatArray) -> FloatArray:
    """How a channel (n,) usually changes from sample to sample around each of its changes, (n − 1,)."""
    return local_scale(x, REACH, USUAL)


def _alike(x: FloatArray, sure: IntArray, candidates: IntArray, near: np.ndarray) -> IntArray:
    """Those of ``candidates``, close upon jumps of an input, that are as high as the ``sure`` ones elsewhere.

    None where they come with the jumps: spikes fall anywhere.
    """
    if len(sure) < ENOUGH:
        return np.empty(0, dtype=np.int64)
    height = np.abs(x - 0.5 * (np.roll(x, 1) + np.roll(x, -1)))
    candidates = candidates[near[candidates]]
    by_chance = len(sure) / float(np.sum(~near)) * float(np.sum(near))
    if len(candidates) > max(OFTEN * by_chance, 1.0):
        return np.empty(0, dtype=np.int64)
    return candidates[height[candidates] >= AS_HIGH * np.median(height[sure])]


def zero_steps(x: FloatArray, sigma: float, inputs: FloatArray) -> IntArray:
    """Places of samples at which a position (n,) has jumped and stays, (k,): a sensor that slipped."""
    change = np.abs(np.diff(x))
    if len(change) < 2 * REACH + 3:
        return np.empty(0, dtype=np.int64)
    candidates = np.argsort(change)[::-1][:MOST_STEPS]
    elsewhere = float(np.delete(change, candidates).max())
    places = []
    for i in candidates:
        neighbours = np.r_[change[max(i - 2, 0) : i], change[i + 1 : i + 3]]
        alone = neighbours.max() < ALONE * change[i]
        if alone and change[i] > max(STEP_BEYOND * elsewhere, BEYOND_NOISE * sigma):
            places.append(int(i) + 1)
    steps = np.array(sorted(places), dtype=np.int64)
    return steps[~input_jumps(inputs)[steps]]


def input_jumps(inputs: FloatArray) -> np.ndarray:
    """Which samples (n,) follow close upon a jump of some input (n, m)."""
    return np.asarray((jump_sizes(inputs) > 0.0).any(axis=1))


def jump_sizes(inputs: FloatArray) -> FloatArray:
    """For samples close upon a jump of an input (n, m) its size, else 0, (n, m)."""
    sizes = np.zeros(inputs.shape)
    for j, column in enumerate(inputs.T):
        change = np.r_[0.0, np.abs(np.diff(column))]
        recent = _largest(change, AFTER_JUMP, 1)
        around = np.sort(sliding_window_view(np.pad(change, REACH, mode="edge"), 2 * REACH + 1), axis=1)
        # the median of what changes nearby; of an input in levels that is nothing, so every level is a jump
        usual = around[:, REACH]
        near = (recent > SUDDEN * usual) & (recent > NOTABLE * float(np.ptp(column)))
        sizes[near, j] = recent[near]
    return sizes


def answers(sizes: FloatArray, places: IntArray, every: IntArray) -> np.ndarray:
    """Which of the ``places`` (k,) where a channel jumps may be its answers to jumps of an input.

    ``sizes`` (n, m) are those of :func:`jump_sizes`, ``every`` are all places where the channel jumps. What
    most jumps as large do not do to it, one does not do either.
    """
    answering = np.zeros(len(places), dtype=bool)
    for size in sizes.T:
        begins = np.flatnonzero((size > 0.0) & ~np.r_[False, size[:-1] > 0.0])
        largest = np.maximum.reduceat(size, begins) if len(begins) else np.empty(0)
        answered_jumps = np.searchsorted(begins, every[size[every] > 0.0], side="right") - 1
        answered = np.isin(np.arange(len(begins)), answered_jumps)
        for i in np.flatnonzero(size[places] > 0.0):
            alike = largest >= AS_LARGE * size[places[i]]
            quiet = int(np.sum(alike & ~answered))
            answering[i] |= quiet < max(UNANSWERED, int(np.sum(alike & answered)))
    return answering


def _largest(x: FloatArray, before: int, after: int) -> FloatArray:
    padded = np.pad(x, (before, after), mode="edge")
    return np.asarray(sliding_window_view(padded, before + after + 1).max(axis=1))
