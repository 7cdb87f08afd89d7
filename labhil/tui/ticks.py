"""Limits and ticks of an axis, at round numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from labhil.signals import FloatArray

Limits = tuple[float, float]


def round_ticks(low: float, high: float, most: int = 4) -> list[float]:
    """Choose ticks at round numbers.

    Args:
        low: Lower limit of the axis.
        high: Upper limit of the axis.
        most: About how many ticks.

    Returns:
        The ticks, at least two where the limits differ.
    """
    if not (math.isfinite(high - low) and high > low):
        return []
    step = round_step((high - low) / max(1, most))
    values = _multiples(step, low, high)
    for _ in range(3):
        if len(values) < 2:  # a single tick gives no scale
            step = round_step(step / 2.6)
            values = _multiples(step, low, high)
    return values


def tick_labels(values: Sequence[float]) -> list[str]:
    """Return the labels of ticks, with as many decimals as their step needs."""
    if not values:
        return []
    step = values[1] - values[0] if len(values) > 1 else abs(values[0]) or 1.0
    largest = max(abs(tick) for tick in values)
    if largest >= 1e5 or (0 < largest < 1e-3):
        return [f"{tick:.1e}".replace("e-0", "e-").replace("e+0", "e") for tick in values]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return [f"{tick + 0.0:.{decimals}f}".replace("-", "−") for tick in values]


def _multiples(step: float, low: float, high: float) -> list[float]:
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [number * step for number in range(first, last + 1)]


def round_step(step: float) -> float:
    """Return the smallest of 1, 2, 5 times a power of ten that is not smaller than ``step``."""
    if not step > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(step))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= step * (1 - 1e-9))


def axis_limits(values: Sequence[FloatArray]) -> Limits:
    """Return round limits around all finite values, with a margin.

    A constant is in the middle of an axis as wide as itself: there is no scale for a small change.

    Args:
        values: Arrays of values.

    Returns:
        The limits; (−1, 1) where no value is finite.
    """
    finite = [v[np.isfinite(v)] for v in values]
    finite = [v for v in finite if len(v)]
    if not finite:
        return -1.0, 1.0
    low, high = min(float(v.min()) for v in finite), max(float(v.max()) for v in finite)
    middle, half = (low + high) / 2, (high - low) / 2
    half = half * 1.05 if half > abs(middle) * 1e-9 else abs(middle) or 1.0
    step = round_step(half / 2.5)
    return math.floor((middle - half) / step) * step, math.ceil((middle + half) / step) * step
