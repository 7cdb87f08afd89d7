"""Faults of commands: samples that nobody can have intended.

A command may stand still, jump and be clipped as it likes. Faults are single samples that leave a smooth
course, and values far outside of all other commands.
"""

from __future__ import annotations

import numpy as np

from labhil.diagnose.hold import jumps_of_levels
from labhil.diagnose.jumps import spikes
from labhil.signals import FloatArray, IntArray

FAR_OUTSIDE = 5.0
"""A lone sample is no command where it leaves the range of all others by this many times that range."""

MOST_LONE = 0.01
"""Of the samples: more of them are pulses, which somebody intended."""

SMOOTH = 0.9
"""Share of the changes of a smooth command that differ from zero."""

USUAL = 0.98
"""Quantile of a smooth command's changes that stands for them: a spike makes two, of spikes at most 2 %."""

BEYOND_USUAL = 5.0
"""A spike is so many times as large; a controller's kicks at a converter's steps come in all sizes below."""

OF_RANGE = 0.2
"""Share of the command's range that a spike has at least."""


def spikes_of_commands(u: FloatArray) -> IntArray:
    """Places of single samples of a command (n,) that nobody can have intended, (k,)."""
    change = np.diff(u)
    if len(u) < 40 or not np.any(change):
        return np.empty(0, dtype=np.int64)
    places = [_far_outside(u)]
    if np.mean(change != 0.0) >= SMOOTH and not len(jumps_of_levels(u)):
        places.append(_off_course(u))
    lone = np.unique(np.concatenate(places))
    return lone if len(lone) <= MOST_LONE * len(u) else np.empty(0, dtype=np.int64)


def _off_course(u: FloatArray) -> IntArray:
    """Single samples that leave a smooth course by more than it ever moves, (k,)."""
    # no noise is known of a command: its changes are what a spike has to stand out of
    places = spikes(u, 0.0, np.zeros((len(u), 1)))
    if not len(places):
        return places
    least = max(BEYOND_USUAL * float(np.quantile(np.abs(np.diff(u)), USUAL)), OF_RANGE * float(np.ptp(u)))
    height = np.minimum(np.abs(u[places] - u[places - 1]), np.abs(u[places + 1] - u[places]))
    return np.asarray(places[height > least])


def _far_outside(u: FloatArray) -> IntArray:
    """Single samples far outside the range of all that are not of their kind, (k,)."""
    few = max(1, int(MOST_LONE * len(u)))
    ordered = np.sort(u)
    low, high = ordered[few], ordered[-few - 1]
    if not high > low:
        return np.empty(0, dtype=np.int64)
    reach = FAR_OUTSIDE * (high - low)
    out = (u > high + reach) | (u < low - reach)
    alone = out & ~np.r_[False, out[:-1]] & ~np.r_[out[1:], False]
    return np.flatnonzero(alone).astype(np.int64)
