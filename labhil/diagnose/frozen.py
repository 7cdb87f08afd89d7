"""Channels that stand still where they should not: stuck at one value, or clipped at the end of a range.

A body at rest stands still too, and so may a coarse converter's reading of it. Two signs show a fault: the
channel's noise vanishes, or the channel jumps when it comes loose, which no body does. Runs of equal readings
that a channel jumps into *and* out of are in :mod:`labhil.diagnose.bursts`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import stats

from labhil.identify.quantiser import converter_step
from labhil.signals import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class ConstantRuns:
    """Stretches of equal neighbours in a channel: each covers the samples ``start`` … ``stop`` − 1, (r,)."""

    start: IntArray
    stop: IntArray

    @property
    def length(self) -> IntArray:
        """Number of samples in each run, (r,)."""
        return self.stop - self.start

    def select(self, which: BoolArray) -> ConstantRuns:
        """Return the runs that ``which`` (r,) marks."""
        return ConstantRuns(self.start[which], self.stop[which])


def constant_runs(x: FloatArray) -> ConstantRuns:
    """Return all runs of equal neighbours in a channel (n,), single readings included."""
    edges = np.flatnonzero(np.diff(x)) + 1
    return ConstantRuns(np.r_[0, edges].astype(np.int64), np.r_[edges, len(x)].astype(np.int64))


def detect_stuck_runs(
    x: FloatArray,
    inputs: FloatArray,
    *,
    may_rest: bool = False,
    min_samples: int = 8,
    min_length_ratio: float = 5.0,
) -> ConstantRuns:
    """Find the runs in which a measured channel is stuck although the inputs drive the rig.

    Either the noise of the channel vanishes for longer than chance explains, or the run ends in a jump that
    is larger than all other changes of the channel and that no input explains.

    Args:
        x: readings of the channel (n,).
        inputs: inputs that drive the rig (n, m).
        may_rest: whether the channel may stand still at any value, as the encoder of a joint that is held.
        min_samples: samples in a run that counts, at least.
        min_length_ratio: length of a run that counts over the usual length in its channel, at least: slow
            sensors repeat their readings.

    Returns:
        The runs that are stuck.
    """
    runs = constant_runs(x)
    usual_length = _usual_length(runs)
    long = runs.select(runs.length >= max(min_samples, min_length_ratio * usual_length))
    if not len(long.start):
        return long
    is_silent = (long.length >= _min_improbable_length(x, long, usual_length, min_samples)) & (not may_rest)
    # an encoder at rest is silent too, and so is what is derived from it: at zero, or between gentle ends
    step = converter_step(x)
    is_silent &= np.abs(x[long.start]) > 3.0 * step
    if step:
        is_silent &= _have_abrupt_ends(x, long, step)
    return long.select(is_silent | _end_in_unexplained_jumps(x, inputs, long))


def detect_clipping_levels(
    x: FloatArray,
    *,
    min_samples: int = 8,
    min_samples_of_quantised: int = 20,
    min_count_ratio: float = 4.0,
) -> tuple[float, ...]:
    """Find the extreme values at which a noisy channel accumulates although noise should scatter it.

    Args:
        x: readings of the channel (n,).
        min_samples: readings at the extreme value, at least.
        min_samples_of_quantised: the same for a channel that is quantised.
        min_count_ratio: readings at the extreme value over those at any of the next three steps of the
            converter, at least.

    Returns:
        The lower and the upper end of the range, where the channel is clipped there.
    """
    step = converter_step(x)
    levels = []
    for sign in (-1.0, 1.0):
        y = sign * x
        top = float(y.max())
        at_top = y == top
        if at_top.sum() < (min_samples_of_quantised if step else min_samples) or at_top.all():
            continue
        runs = _runs_of_marked(at_top)
        # a channel that has not moved yet: uneven stamps make its motion afterwards look noisy
        if len(runs.start) == 1 and runs.start[0] == 0:
            continue
        if _noise_at_rest(x, step, runs) <= 0.0:
            continue
        near = [int(np.sum(np.abs(top - k * step - y) < 0.5 * step)) for k in (1, 2, 3)] if step else [1]
        if at_top.sum() > min_count_ratio * max(near):
            levels.append(sign * top)
    return tuple(levels)


def local_change_quantile(x: FloatArray, reach: int, quantile: float) -> FloatArray:
    """Return how much a channel changes from sample to sample in the neighbourhood of each change.

    Args:
        x: readings (n,).
        reach: changes on either side that belong to the neighbourhood.
        quantile: quantile (0 to 1) of their sizes.

    Returns:
        That quantile around each change (n − 1,), in the unit of the channel.
    """
    change = np.abs(np.diff(x))
    padded = np.pad(change, reach, mode="reflect" if len(change) > reach else "edge")
    return np.asarray(np.quantile(sliding_window_view(padded, 2 * reach + 1), quantile, axis=1))


def _runs_of_marked(marked: BoolArray) -> ConstantRuns:
    """Runs of neighbouring samples that ``marked`` (n,) marks."""
    edges = np.flatnonzero(np.diff(np.r_[False, marked, False].astype(np.int8)))
    return ConstantRuns(edges[::2].astype(np.int64), edges[1::2].astype(np.int64))


def _usual_length(runs: ConstantRuns) -> float:
    """Median length of the runs in samples: 1, or the repetitions of a slow sensor."""
    return float(np.median(runs.length))


def _min_improbable_length(
    x: FloatArray,
    runs: ConstantRuns,
    usual_length: float,
    min_samples: int,
    *,
    alpha: float = 1e-5,
    noise_factor: float = 0.7,
) -> float:
    """Samples from which noise holds a reading with a probability below ``alpha`` per channel.

    Only ``noise_factor`` of the noise at rest counts: noise may be less where nothing moves.
    """
    step = converter_step(x)
    noise = noise_factor * _noise_at_rest(x, step, runs)
    if noise <= 0.0:
        return float("inf")
    if not step:
        return min_samples
    # the reading stays most easily where the true value lies in the middle of a step
    stay_probability = 1.0 - 2.0 * float(stats.norm.sf(0.5 * step / noise))
    return float(usual_length * np.log(alpha / len(x)) / np.log(min(stay_probability, 1.0 - 1e-12)))


def _noise_at_rest(
    x: FloatArray,
    step: float,
    excluded: ConstantRuns,
    *,
    block_samples: int = 32,
    calm_quantile: float = 0.1,
    min_reversals: int = 10,
    motion_variance_in_steps: float = 0.25,
    min_share_of_range: float = 1e-9,
) -> float:
    """Noise (standard deviation) in the calmest blocks of a channel, without the ``excluded`` runs.

    Zero where no noise is certain: third differences may come from motion, or from the stairs that a
    converter with this ``step`` makes of motion. Slow motion alone leaves a variance of at most
    ``motion_variance_in_steps``·step² in them. Noise below ``min_share_of_range`` is rounding of floats.
    """
    third = np.diff(x, n=3)
    if len(third) < 4 * block_samples:
        return 0.0
    is_excluded = np.zeros(len(x), dtype=bool)
    for start, stop in zip(excluded.start, excluded.stop, strict=True):
        is_excluded[max(start - 1, 0) : stop + 1] = True
    if step and _count_quick_reversals(x[~is_excluded]) < min_reversals:
        return 0.0
    is_excluded = is_excluded[3:] | is_excluded[:-3]
    count = len(third) // block_samples
    blocks = third[: count * block_samples].reshape(count, block_samples)
    clean = blocks[~is_excluded[: count * block_samples].reshape(count, block_samples).any(axis=1)]
    if len(clean) < 4:
        return 0.0
    power = np.mean(clean**2, axis=1)
    calm = clean[power <= np.quantile(power, 3.0 * calm_quantile)]
    # white noise gives third differences a correlation of −0.75 between neighbours, smooth motion +1
    if np.sum(calm[:, 1:] * calm[:, :-1]) > -0.3 * np.sum(calm**2):
        return 0.0
    # third differences of white noise have 1 + 9 + 9 + 1 = 20 times its variance
    variance = float(np.quantile(power, calm_quantile)) / 20.0
    # rounding adds step²/12; what motion's stairs may have made is not counted
    certain = min(variance - step**2 / 12.0, 4.0 * (variance - motion_variance_in_steps * step**2))
    noise = float(np.sqrt(max(certain, 0.0)))
    return noise if noise > min_share_of_range * float(np.ptp(x)) else 0.0


def _count_quick_reversals(x: FloatArray, *, max_samples: int = 4) -> int:
    """How often a reading (n,) reverses twice within ``max_samples`` samples.

    Noise reverses a slow reading so. The stairs of a smooth motion never do, however large the third
    differences that they leave at a steady speed.
    """
    change = np.diff(x)
    moved = np.flatnonzero(change)
    reversals = moved[1:][np.diff(np.sign(change[moved])) != 0.0]
    return int(np.sum(np.diff(reversals) <= max_samples))


def _have_abrupt_ends(
    x: FloatArray,
    runs: ConstantRuns,
    step: float,
    *,
    min_motion_in_steps: float = 6.0,
    min_motion_ratio: float = 0.7,
) -> BoolArray:
    """Which runs (r,) begin or end at speed: a body does not start or stop at once.

    At speed a channel moves at least ``min_motion_in_steps`` of the converter within two samples of the run,
    and at least ``min_motion_ratio`` of the motion in the next two; constant acceleration makes that 1/3.
    """
    abrupt = np.zeros(len(runs.start), dtype=bool)
    for r, (start, stop) in enumerate(zip(runs.start, runs.stop, strict=True)):
        for path in (x[max(start - 4, 0) : start + 1][::-1], x[stop - 1 : stop + 4]):
            if len(path) == 5:
                near, far = abs(path[2] - path[0]), abs(path[4] - path[2])
                abrupt[r] |= near > min_motion_in_steps * step and near > min_motion_ratio * far
    return abrupt


def _end_in_unexplained_jumps(
    x: FloatArray, inputs: FloatArray, runs: ConstantRuns, *, min_height_ratio: float = 2.0
) -> BoolArray:
    """Which runs (r,) end in a jump beyond all other changes, while no input moves more than during the run.

    ``min_height_ratio`` is the height of the jump over the largest change elsewhere.
    """
    change = np.abs(np.diff(x))
    elsewhere = change.copy()
    for edges in (runs.start[runs.start > 0] - 1, runs.stop[runs.stop < len(x)] - 1):
        elsewhere[edges] = 0.0
    largest = float(elsewhere.max(initial=0.0))
    jumps = []
    for start, stop in zip(runs.start, runs.stop, strict=True):
        has_jump = stop < len(x) and largest > 0.0 and change[stop - 1] > min_height_ratio * largest
        jumps.append(bool(has_jump) and _inputs_move_more_during(inputs, int(start), int(stop)))
    return np.array(jumps, dtype=bool)


def _inputs_move_more_during(inputs: FloatArray, start: int, stop: int) -> bool:
    """Whether some input moves during a run, and none jumps more at its end than it moved during it."""
    during = np.ptp(inputs[start : stop - 2], axis=0)
    around = np.abs(np.diff(inputs[max(stop - 3, 0) : stop + 2], axis=0)).max(axis=0)
    return bool(np.any((during > 0.0) & (during >= around)) and np.all((around <= during) | (around == 0.0)))
