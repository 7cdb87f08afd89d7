"""What an input does between samples, read from the recording where nobody states it."""

from __future__ import annotations

import numpy as np

from labhil.signals import FloatArray, Hold, IntArray

FEWEST_LEVELS = 3
"""Jumps from which an input is held in levels: one or two may be anything."""

AT_REST = 0.5
"""Share of neighbouring samples, at least, that are equal in an input of levels …"""

ALONE = 0.8
"""… and share of its changes that have none beside them: a ramp, or a sine that is clipped, has."""


def jumps_of_levels(u: FloatArray) -> IntArray:
    """First samples of the levels of an input (n,) that is held between jumps, (k,); none of any other."""
    changed = np.r_[False, np.diff(u) != 0.0]
    jumps = np.flatnonzero(changed).astype(np.int64)
    if len(jumps) < FEWEST_LEVELS or changed[1:].mean() > 1.0 - AT_REST:
        return np.empty(0, dtype=np.int64)
    neighbour_changed = changed[np.maximum(jumps - 1, 0)] | changed[np.minimum(jumps + 1, len(u) - 1)]
    return jumps if np.mean(~neighbour_changed) >= ALONE else np.empty(0, dtype=np.int64)


def evident_hold(u: FloatArray) -> Hold | None:
    """``Hold.ZERO`` of an input (n,) that is held in levels; None where that is not evident."""
    return Hold.ZERO if len(jumps_of_levels(u)) else None
