"""Positions that begin anew: an encoder that counts a turn, or a power of two of its steps, and starts again.

All readings of such a sensor lie within one period, and every wrap is a step of one period less or more what
the body moved meanwhile. A sensor that slips knows neither.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.identify.quantiser import converter_step
from labhil.signals import FloatArray, IntArray

STANDS_OUT = 3.0
"""A wrap is this many times as large as any other change from sample to sample."""

MOST_WRAPS = 0.1
"""Of the samples: of a body that turns within ten samples direction and wraps are hard to separate."""

AGAIN_AND_AGAIN = 4
"""Steps of one size from which they need no known period: a sensor does not slip so often by the same."""

SMALLEST_COUNTER = 6
"""Bits of the smallest counter: a power of two of fewer steps is met by chance."""

TURNS = (2.0 * np.pi, 360.0, 1.0)
"""A turn in rad, in degrees, and in turns."""

NEAR = 0.01
"""Share of a turn by which a period may be off that is read from a few wraps of a moving body."""


@dataclass(frozen=True, slots=True)
class Wraps:
    """A position that wraps: the ``places`` (k,) of the first samples behind a wrap, and the ``period``."""

    places: IntArray
    period: float


def wraps_of(x: FloatArray) -> Wraps | None:
    """Where a position (n,) begins anew; None where it does not."""
    change = np.diff(x)
    size = np.abs(change)
    most = int(MOST_WRAPS * len(size))
    if most < 1 or not np.isfinite(x).all():
        return None
    order = np.argsort(size)[::-1]
    falls = size[order[:most]] / np.maximum(size[order[1 : most + 1]], 1e-300)
    count = int(np.argmax(falls)) + 1
    if falls[count - 1] < STANDS_OUT:
        return None
    places = np.sort(order[:count])
    if _is_dropout(x, places):
        return None
    usual = float(size[order[count]])
    motion = 0.5 * (change[np.maximum(places - 1, 0)] + change[np.minimum(places + 1, len(change) - 1)])
    clean = ~np.isin(np.maximum(places - 1, 0), places) & ~np.isin(places + 1, places)
    periods = np.abs(change[places] - motion)[clean]
    if not len(periods) or np.ptp(periods) > 2.0 * usual:
        return None
    period = float(np.median(periods))
    named = _known_period(period, converter_step(x), usual)
    if named is None and count < AGAIN_AND_AGAIN:
        return None
    period = period if named is None else named
    return Wraps(places + 1, period) if np.ptp(x) <= period + usual else None


def _is_dropout(x: FloatArray, places: IntArray) -> bool:
    """Whether a reading (n,) goes away and comes back each time, and is one and the same value meanwhile.

    What turns on through the end of a turn reads something else there every time.
    """
    if len(places) % 2:
        return False
    away = np.concatenate([x[first + 1 : last + 1] for first, last in places.reshape(-1, 2)])
    return bool(np.ptp(away) == 0.0)


def _known_period(period: float, step: float, slack: float) -> float | None:
    """The turn or the power of two of a resolution that a period is, within ``slack``; None of others."""
    for turn in TURNS:
        if abs(period - turn) <= max(NEAR * turn, min(slack, 3.0 * NEAR * turn)):
            return turn
    if step > 0.0:
        bits = round(float(np.log2(period / step)))
        counter = step * 2.0**bits
        if bits >= SMALLEST_COUNTER and abs(period - counter) <= max(NEAR * counter, step):
            return counter
    return None
