"""Positions that wrap: an encoder that counts one turn, or 2ⁿ of its steps, and then starts again.

All readings of such a sensor lie within one period, and every wrap is a step of one period, give or take the
motion of the body meanwhile. A sensor that slips has neither property.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.identify.quantiser import converter_step
from labhil.signals import FloatArray, IntArray

TURNS = (2.0 * np.pi, 360.0, 1.0)
"""One turn in rad, in degrees, and in turns."""


@dataclass(frozen=True, slots=True)
class Wraps:
    """Wraps of a position.

    Attributes:
        places: first sample behind each wrap (k,).
        period: height of a wrap, in the unit of the position.
    """

    places: IntArray
    period: float


def detect_wraps(
    x: FloatArray,
    *,
    min_height_ratio: float = 3.0,
    max_share: float = 0.1,
    min_wraps_of_unknown_period: int = 4,
) -> Wraps | None:
    """Find where a position wraps, and its period.

    Args:
        x: position (n,).
        min_height_ratio: height of a wrap over the largest other change from sample to sample, at least.
        max_share: share of the samples that may be wraps. Where a body turns once in fewer than ten
            samples, direction and wraps cannot be separated.
        min_wraps_of_unknown_period: steps of equal height from which the period need not be a known one:
            a sensor does not slip so often by the same amount.

    Returns:
        Places and period of the wraps; None for a position that does not wrap.
    """
    change = np.diff(x)
    size = np.abs(change)
    max_wraps = int(max_share * len(size))
    if max_wraps < 1 or not np.isfinite(x).all():
        return None
    order = np.argsort(size)[::-1]
    ratios = size[order[:max_wraps]] / np.maximum(size[order[1 : max_wraps + 1]], 1e-300)
    count = int(np.argmax(ratios)) + 1
    if ratios[count - 1] < min_height_ratio:
        return None
    places = np.sort(order[:count])
    if _is_dropout(x, places):
        return None
    largest_motion = float(size[order[count]])
    motion = 0.5 * (change[np.maximum(places - 1, 0)] + change[np.minimum(places + 1, len(change) - 1)])
    isolated = ~np.isin(np.maximum(places - 1, 0), places) & ~np.isin(places + 1, places)
    periods = np.abs(change[places] - motion)[isolated]
    if not len(periods) or np.ptp(periods) > 2.0 * largest_motion:
        return None
    period = float(np.median(periods))
    known_period = _known_period(period, converter_step(x), largest_motion)
    if known_period is None and count < min_wraps_of_unknown_period:
        return None
    period = period if known_period is None else known_period
    return Wraps(places + 1, period) if np.ptp(x) <= period + largest_motion else None


def _is_dropout(x: FloatArray, places: IntArray) -> bool:
    """Whether a channel (n,) jumps to one and the same value each time and back.

    A body that turns on through the end of a turn has another reading there each time.
    """
    if len(places) % 2:
        return False
    away = np.concatenate([x[first + 1 : last + 1] for first, last in places.reshape(-1, 2)])
    return bool(np.ptp(away) == 0.0)


def _known_period(
    period: float,
    resolution: float,
    slack: float,
    *,
    turns: Sequence[float] = TURNS,
    tolerance: float = 0.01,
    min_bits: int = 6,
) -> float | None:
    """The turn, or the 2ⁿ steps of a ``resolution``, that a ``period`` is within ``slack``; else None.

    A period that is read from a few wraps of a moving body may be off by ``tolerance`` of a turn. A counter
    of fewer than ``min_bits`` bits fits by chance.
    """
    for turn in turns:
        if abs(period - turn) <= max(tolerance * turn, min(slack, 3.0 * tolerance * turn)):
            return turn
    if resolution > 0.0:
        bits = round(float(np.log2(period / resolution)))
        counter = resolution * 2.0**bits
        if bits >= min_bits and abs(period - counter) <= max(tolerance * counter, resolution):
            return counter
    return None
