"""Channels that stand still where they should not: stuck at one value, or clipped at the end of a range.

A body at rest, and a plunger at its stop, hold still too, and so may a coarse converter's reading of them.
What gives a fault away is noise that vanishes, or a jump at the end of the silence: a body cannot jump.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import stats

from labhil.identify.quantiser import converter_step
from labhil.signals import FloatArray, IntArray

CHANCE = 1e-5
"""Probability per channel that noise by itself holds a reading for as long as a run that counts."""

SHORTEST = 8
"""Samples in a run that counts at least."""

UNUSUAL = 5.0
"""A run that counts is this many times as long as what is usual in its channel (slow sensors repeat)."""

CAUTION = 0.7
"""Share of the channel's calmest noise that is relied upon: noise may be less where nothing moves."""

STAIRS = 0.25
"""Variance, in squared steps of the converter, that slow motion alone can leave in third differences."""

CALM = 0.1
"""Quantile of the blocks' variances that stands for the noise at rest."""

FAINTEST = 1e-9
"""Share of a channel's range under which its noise is a computer's rounding."""

ABRUPT = 6.0
"""Steps that a channel moves within two samples of a run that begins or ends at speed."""

SUDDEN_END = 0.7
"""Share of the motion in the next two samples; a constant acceleration from rest makes it a third."""

TREMBLING = 4
FEWEST_TREMBLINGS = 10
BLOCK = 32
LEAP = 2.0
"""The jump that ends a stuck run, in largest changes from sample to sample elsewhere."""

PILED = 4.0
"""A clipped channel's last value is met this many times as often as any of the next three."""

FEWEST_PILED = 20


@dataclass(frozen=True, slots=True)
class Runs:
    """Stretches of equal neighbours: each covers the samples first … last − 1, (r,)."""

    first: IntArray
    last: IntArray

    @property
    def length(self) -> IntArray:
        """Samples of each, (r,)."""
        return self.last - self.first

    def select(self, which: np.ndarray) -> Runs:
        """Those that ``which`` (r,) marks."""
        return Runs(self.first[which], self.last[which])


def runs_of(x: FloatArray) -> Runs:
    """All runs of equal neighbours in a channel (n,), single samples too."""
    edges = np.flatnonzero(np.diff(x)) + 1
    return Runs(np.r_[0, edges].astype(np.int64), np.r_[edges, len(x)].astype(np.int64))


def stuck_runs(x: FloatArray, inputs: FloatArray, *, rests: bool = False) -> Runs:
    """Runs in which a measured channel (n,) is frozen, while ``inputs`` (n, k) drive the rig.

    Either its noise vanishes for longer than chance, or it ends in a jump that nothing else in the channel
    comes near and the inputs do not explain. A channel that ``rests`` may be silent at any value, as an
    encoder of a joint that is held.
    """
    runs = runs_of(x)
    usual = _usual_length(runs)
    long = runs.select(runs.length >= max(SHORTEST, UNUSUAL * usual))
    if not len(long.first):
        return long
    silent = (long.length >= _longest_by_chance(x, long, usual)) & (not rests)
    # an encoder at rest is silent too, and so is what is derived from it: at zero, or between gentle ends
    step = converter_step(x)
    silent &= np.abs(x[long.first]) > 3.0 * step
    if step:
        silent &= _have_abrupt_ends(x, long, step)
    return long.select(silent | _end_in_leaps(x, inputs, long))


def clipped_values(x: FloatArray) -> tuple[float, ...]:
    """Extreme values at which a noisy channel (n,) piles up although its noise should scatter it beyond."""
    step = converter_step(x)
    limits = []
    for side in (-1.0, 1.0):
        y = side * x
        top = float(y.max())
        at = y == top
        if at.sum() < (FEWEST_PILED if step else SHORTEST) or at.all():
            continue
        runs = _runs_at(at)
        # a channel that has not moved yet: uneven stamps make its motion afterwards look noisy
        if len(runs.first) == 1 and runs.first[0] == 0:
            continue
        if _noise_at_rest(x, step, runs) <= 0.0:
            continue
        near = [int(np.sum(np.abs(top - k * step - y) < 0.5 * step)) for k in (1, 2, 3)] if step else [1]
        if at.sum() > PILED * max(near):
            limits.append(side * top)
    return tuple(limits)


def _runs_at(marked: np.ndarray) -> Runs:
    edges = np.flatnonzero(np.diff(np.r_[False, marked, False].astype(np.int8)))
    return Runs(edges[::2].astype(np.int64), edges[1::2].astype(np.int64))


def _usual_length(runs: Runs) -> float:
    """Length of the run in which the median change falls: 1, or the repetitions of a slow sensor."""
    return float(np.median(runs.length))


def _longest_by_chance(x: FloatArray, runs: Runs, usual: float) -> float:
    """Samples from which a run is no chance: noise leaves the step of the converter too easily."""
    step = converter_step(x)
    noise = CAUTION * _noise_at_rest(x, step, runs)
    if noise <= 0.0:
        return float("inf")
    if not step:
        return SHORTEST
    # the reading stays most easily where the true value lies in the middle of a step
    stays = 1.0 - 2.0 * float(stats.norm.sf(0.5 * step / noise))
    return float(usual * np.log(CHANCE / len(x)) / np.log(min(stays, 1.0 - 1e-12)))


def _noise_at_rest(x: FloatArray, step: float, without: Runs) -> float:
    """Noise (standard deviation) in the calmest parts of a channel, ``without`` the runs in doubt.

    Zero where none is certain: third differences that look like motion, or like the stairs that motion
    makes of a converter's steps.
    """
    third = np.diff(x, n=3)
    if len(third) < 4 * BLOCK:
        return 0.0
    doubtful = np.zeros(len(x), dtype=bool)
    for first, last in zip(without.first, without.last, strict=True):
        doubtful[max(first - 1, 0) : last + 1] = True
    if step and _tremblings(x[~doubtful]) < FEWEST_TREMBLINGS:
        return 0.0
    doubtful = doubtful[3:] | doubtful[:-3]
    count = len(third) // BLOCK
    blocks = third[: count * BLOCK].reshape(count, BLOCK)
    clean = blocks[~doubtful[: count * BLOCK].reshape(count, BLOCK).any(axis=1)]
    if len(clean) < 4:
        return 0.0
    power = np.mean(clean**2, axis=1)
    calm = clean[power <= np.quantile(power, 3.0 * CALM)]
    # white noise gives third differences a correlation of −0.75 between neighbours, smooth motion +1
    if np.sum(calm[:, 1:] * calm[:, :-1]) > -0.3 * np.sum(calm**2):
        return 0.0
    variance = float(np.quantile(power, CALM)) / 20.0
    # rounding adds step²/12; what could be all stairs is no noise, and what is little more not much
    certain = min(variance - step**2 / 12.0, 4.0 * (variance - STAIRS * step**2))
    noise = float(np.sqrt(max(certain, 0.0)))
    return noise if noise > FAINTEST * float(np.ptp(x)) else 0.0


def _tremblings(x: FloatArray) -> int:
    """How often a reading (n,) turns back twice within ``TREMBLING`` samples.

    Noise makes it do so wherever it is slow; a smooth motion's stairs never do, however large the third
    differences they leave at a steady speed.
    """
    change = np.diff(x)
    moved = np.flatnonzero(change)
    turns = moved[1:][np.diff(np.sign(change[moved])) != 0.0]
    return int(np.sum(np.diff(turns) <= TREMBLING))


def _have_abrupt_ends(x: FloatArray, runs: Runs, step: float) -> np.ndarray:
    """Which runs (r,) begin or end at speed: a body that stops or starts takes its time."""
    abrupt = np.zeros(len(runs.first), dtype=bool)
    for r, (first, last) in enumerate(zip(runs.first, runs.last, strict=True)):
        for path in (x[max(first - 4, 0) : first + 1][::-1], x[last - 1 : last + 4]):
            if len(path) == 5:
                near, far = abs(path[2] - path[0]), abs(path[4] - path[2])
                abrupt[r] |= near > ABRUPT * step and near > SUDDEN_END * far
    return abrupt


def _end_in_leaps(x: FloatArray, inputs: FloatArray, runs: Runs) -> np.ndarray:
    """Which runs (r,) end in a jump beyond all other changes, with inputs that moved before and not then."""
    change = np.abs(np.diff(x))
    elsewhere = change.copy()
    for ends in (runs.first[runs.first > 0] - 1, runs.last[runs.last < len(x)] - 1):
        elsewhere[ends] = 0.0
    largest = float(elsewhere.max(initial=0.0))
    leaps = []
    for first, last in zip(runs.first, runs.last, strict=True):
        leaped = last < len(x) and largest > 0.0 and change[last - 1] > LEAP * largest
        leaps.append(bool(leaped) and _inputs_explain_leap(inputs, int(first), int(last)))
    return np.array(leaps, dtype=bool)


def _inputs_explain_leap(inputs: FloatArray, first: int, last: int) -> bool:
    """Whether some input moved more during a run than it jumps in the three samples around its end."""
    during = np.ptp(inputs[first : last - 2], axis=0)
    around = np.abs(np.diff(inputs[max(last - 3, 0) : last + 2], axis=0)).max(axis=0)
    return bool(np.any((during > 0.0) & (during >= around)) and np.all((around <= during) | (around == 0.0)))


def local_scale(x: FloatArray, reach: int, quantile: float) -> FloatArray:
    """Quantile of the changes from sample to sample within ``reach`` samples of each change, (n − 1,)."""
    change = np.abs(np.diff(x))
    padded = np.pad(change, reach, mode="reflect" if len(change) > reach else "edge")
    return np.asarray(np.quantile(sliding_window_view(padded, 2 * reach + 1), quantile, axis=1))


__all__ = ["Runs", "clipped_values", "converter_step", "local_scale", "runs_of", "stuck_runs"]
