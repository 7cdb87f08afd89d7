"""Outliers of commands: single samples that no operator or controller can have intended.

A command may stand still, jump and be clipped. So only two patterns count: a single sample off a smooth
course, and a single sample far outside the range of all others. Outliers of measured channels are in
:mod:`labhil.diagnose.jumps`.
"""

from __future__ import annotations

import numpy as np

from labhil.diagnose.hold import level_changes
from labhil.diagnose.jumps import detect_spikes
from labhil.signals import FloatArray, IntArray


def detect_command_spikes(
    u: FloatArray, *, max_share: float = 0.01, min_share_changing: float = 0.9
) -> IntArray:
    """Find single samples of a command that nobody can have intended.

    Args:
        u: command (n,).
        max_share: share of the samples above which outliers count as intended pulses.
        min_share_changing: share of the changes from sample to sample that are not zero, from which a
            command counts as smooth.

    Returns:
        Places of the outliers (k,), in order.
    """
    change = np.diff(u)
    if len(u) < 40 or not np.any(change):
        return np.empty(0, dtype=np.int64)
    places = [_far_outside_range(u, max_share)]
    if np.mean(change != 0.0) >= min_share_changing and not len(level_changes(u)):
        places.append(_off_smooth_course(u))
    outliers = np.unique(np.concatenate(places))
    return outliers if len(outliers) <= max_share * len(u) else np.empty(0, dtype=np.int64)


def _off_smooth_course(
    u: FloatArray,
    *,
    change_quantile: float = 0.98,
    min_height_in_changes: float = 5.0,
    min_height_in_range: float = 0.2,
) -> IntArray:
    """Single samples (k,) that leave a smooth course by more than the command ever moves.

    A spike makes two changes, so at most 2 % of the changes are of spikes. A controller's kicks at a
    converter's steps have all heights below five times the usual change.
    """
    # no noise is known of a command: its changes are the scale that a spike exceeds
    places = detect_spikes(u, 0.0, np.zeros((len(u), 1)))
    if not len(places):
        return places
    usual_change = float(np.quantile(np.abs(np.diff(u)), change_quantile))
    min_height = max(min_height_in_changes * usual_change, min_height_in_range * float(np.ptp(u)))
    height = np.minimum(np.abs(u[places] - u[places - 1]), np.abs(u[places + 1] - u[places]))
    return np.asarray(places[height > min_height])


def _far_outside_range(
    u: FloatArray, trimmed_share: float, *, min_distance_in_ranges: float = 5.0
) -> IntArray:
    """Single samples (k,) far outside the range of the others, ``trimmed_share`` cut off at both ends."""
    n_trimmed = max(1, int(trimmed_share * len(u)))
    ordered = np.sort(u)
    low, high = ordered[n_trimmed], ordered[-n_trimmed - 1]
    if not high > low:
        return np.empty(0, dtype=np.int64)
    margin = min_distance_in_ranges * (high - low)
    is_out = (u > high + margin) | (u < low - margin)
    is_isolated = is_out & ~np.r_[False, is_out[:-1]] & ~np.r_[is_out[1:], False]
    return np.flatnonzero(is_isolated).astype(np.int64)
