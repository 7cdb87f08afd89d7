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

STEP_BEYOND = 3.0
"""A step of the zero, in largest changes elsewhere in the recording."""

MOST_STEPS = 3
ALONE = 0.2
"""What comes right before and after a step of the zero is below this share of it."""


def spikes(x: FloatArray, sigma: float, inputs: FloatArray) -> IntArray:
    """Places of single samples of a channel (n,) that stand out from both neighbours, (k,).

    ``sigma`` is the channel's noise, ``inputs`` (n, m) drive the rig.
    """
    if len(x) < 2 * REACH + 3:
        return np.empty(0, dtype=np.int64)
    change = np.diff(x)
    rises, falls = change[:-1], change[1:]
    height = np.where(rises * falls < 0.0, np.minimum(np.abs(rises), np.abs(falls)), 0.0)
    usual = local_scale(x, REACH, USUAL)
    usual = np.maximum(usual[:-1], usual[1:])
    # neighbours agree with each other: a peak of a fast motion has slopes, a spike has a floor
    floor = np.abs(rises + falls) < 0.5 * height + 3.0 * sigma
    found = (height > BEYOND_NOISE * sigma) & (height > BEYOND_MOTION * usual) & floor
    places = np.flatnonzero(found) + 1
    return places[~input_jumps(inputs)[places]]


def zero_steps(x: FloatArray, sigma: float, inputs: FloatArray) -> IntArray:
    """Places of samples at which a position (n,) has jumped and stays, (k,): a sensor that slipped."""
    change = np.abs(np.diff(x))
    if len(change) < 2 * REACH + 3:
        return np.empty(0, dtype=np.int64)
    candidates = np.argsort(change)[::-1][:MOST_STEPS]
    elsewhere = float(np.delete(change, candidates).max())
    places = []
    for i in candidates:
        beside = np.r_[change[max(i - 2, 0) : i], change[i + 1 : i + 3]]
        alone = beside.max() < ALONE * change[i]
        if alone and change[i] > max(STEP_BEYOND * elsewhere, BEYOND_NOISE * sigma):
            places.append(int(i) + 1)
    found = np.array(sorted(places), dtype=np.int64)
    return found[~input_jumps(inputs)[found]]


def input_jumps(inputs: FloatArray) -> np.ndarray:
    """Which samples (n,) follow close upon a jump of some input (n, m)."""
    near = np.zeros(len(inputs), dtype=bool)
    for column in inputs.T:
        change = np.r_[0.0, np.abs(np.diff(column))]
        recent = _largest(change, 3, 1)
        around = np.sort(sliding_window_view(np.pad(change, REACH, mode="edge"), 2 * REACH + 1), axis=1)
        # the median of what changes nearby; of an input in levels that is nothing, so every level is a jump
        usual = around[:, REACH]
        near |= (recent > SUDDEN * usual) & (recent > NOTABLE * float(np.ptp(column)))
    return near


def _largest(x: FloatArray, before: int, after: int) -> FloatArray:
    padded = np.pad(x, (before, after), mode="edge")
    return np.asarray(sliding_window_view(padded, before + after + 1).max(axis=1))
