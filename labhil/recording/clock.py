"""The device's clock mapped onto the host's: the time in which recordings are analysed.

A device stamps its samples with its own clock, which is steady but drifts by some parts in a million;
the host's stamps are right on average but jump by what wire and scheduler add. A robust straight line
through both gives times that have the device's steadiness and the host's rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labhil.signals import FloatArray, IntArray

BLOCKS = 64
ERROR_BLOCKS = 16
ROUNDS = 6
OUTLIER = 4.0
"""Residuals beyond that many robust standard deviations are thrown out."""

SMALLEST_SPREAD = 1e-6
"""s; no smaller deviation makes an outlier."""

SHORTEST_FIT = 1.0
"""s; a recording shorter than that tells nothing about the drift."""

LARGEST_DRIFT = 0.02
"""A fitted rate further off than that is no drift of a crystal: the stamps are not of one clock."""

LONGEST_PAUSES = 1.0
"""Seconds that the host may have spent more, per second of a device's clock that is even in itself: a
simulated device whose world stands still while its machine is busy. Its own time is the right one."""

EVEN = 1e-3
"""Share of a period by which steps of an even clock differ from whole periods."""


@dataclass(frozen=True, slots=True)
class ClockFit:
    """How a device's clock runs against the host's.

    ``t`` is the time of the samples, in seconds of the device's world, from the host's ``origin``
    (shape (n,)). ``drift`` is the relative error of the device's clock (50e-6: 50 ppm fast; 0 where it
    could not be told), ``jitter`` the robust standard deviation of the host's stamps about the line, s;
    ``outliers`` how many were thrown out; ``device_clock`` whether the device's clock could be used.
    ``offset_error`` (s, in the middle) and ``drift_error`` are standard errors from the means of blocks,
    for what disturbs one stamp often disturbs the next; None where they could not be told.
    """

    t: FloatArray
    drift: float
    jitter: float
    outliers: int
    device_clock: bool
    offset_error: float | None = None
    drift_error: float | None = None


STEADY = 1e-3
"""How near to its declared rate a clock has to be to be believed against the host's."""


def keeps_its_rate(t_hw_ns: IntArray, seq: IntArray, rate: float) -> bool:
    """Tell whether nearly all samples are as far apart by the device's clock as ``rate`` (Hz) says.

    A simulated device on a machine that has no time for it falls behind the host's clock by any amount,
    but its own clock is the one that its world lives by.
    """
    steps = np.diff(t_hw_ns) * 1e-9 * rate
    numbers = np.diff(seq)
    return len(steps) > 0 and bool(np.mean(np.abs(steps - numbers) <= STEADY * numbers) > 0.99)


def fit_clock(
    t_hw_ns: IntArray, t_acq_ns: IntArray, origin_ns: int, speed: float = 1.0, steady: bool = False
) -> ClockFit:
    """Map the stamps of a device's clock onto the host's.

    ``speed`` is how many seconds of the device's world pass in one second of the host: host times are
    multiplied by it. Where the device's clock does not advance with every sample, or runs at quite
    another rate, the host's stamps are used as they are; where the device is ``steady``, or its world has
    paused now and then, its own clock is.
    """
    host: FloatArray = np.asarray((t_acq_ns - origin_ns) * (1e-9 * speed), dtype=np.float64)
    if len(host) < 3 or not (np.diff(t_hw_ns) > 0).all():
        return ClockFit(host, 0.0, 0.0, 0, device_clock=False)
    device = (t_hw_ns - t_hw_ns[0]) * 1e-9
    delay = host - device  # small numbers: the line through them is nearly level
    if device[-1] < SHORTEST_FIT:
        return ClockFit(device + float(np.median(delay)), 0.0, 0.0, 0, device_clock=True)
    slope, level = _median_line(device, delay)
    good = np.ones(len(delay), dtype=bool)
    spread = 0.0
    for _ in range(ROUNDS):
        residual = delay - (level + slope * device)
        spread = max(1.4826 * float(np.median(np.abs(residual[good]))), SMALLEST_SPREAD)
        kept = np.abs(residual) <= OUTLIER * spread
        slope, level = _straight_line(device[kept], delay[kept], slope)
        if np.array_equal(kept, good):
            break
        good = kept
    paused = LARGEST_DRIFT < slope < LONGEST_PAUSES and _is_even(device)
    if paused or (abs(slope) > LARGEST_DRIFT and steady):
        return ClockFit(device + float(np.median(delay)), 0.0, 0.0, 0, device_clock=True)
    if abs(slope) > LARGEST_DRIFT:
        return ClockFit(host, 0.0, 0.0, 0, device_clock=False)
    outliers = int(np.count_nonzero(~good))
    t: FloatArray = np.asarray(level + (1.0 + slope) * device, dtype=np.float64)
    # what was thrown out counts here: where much is late, the line is not as sure as its points say
    edge = OUTLIER * spread
    errors = _errors(device, np.clip(delay - (level + slope * device), -edge, edge))
    return ClockFit(t, 1.0 / (1.0 + slope) - 1.0, spread, outliers, True, *errors)


def _errors(x: FloatArray, residual: FloatArray) -> tuple[float | None, float | None]:
    """Standard errors of a line's level in the middle and of its slope, from the means of blocks."""
    if len(x) < 2 * ERROR_BLOCKS:
        return None, None
    means = np.array([block.mean() for block in np.array_split(residual, ERROR_BLOCKS)])
    places = np.array([block.mean() for block in np.array_split(x, ERROR_BLOCKS)])
    spread = float(np.sqrt(means @ means / (ERROR_BLOCKS - 2)))
    reach = float(np.sqrt(np.sum((places - places.mean()) ** 2)))
    return spread / ERROR_BLOCKS**0.5, spread / reach if reach > 0 else None


def _is_even(device: FloatArray) -> bool:
    """Whether a clock advances by whole periods; lost samples take several."""
    steps = np.diff(device)
    periods = steps / np.median(steps)
    return bool(np.mean(np.abs(periods - np.rint(periods)) < EVEN) > 0.99)


def _median_line(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """A line through medians of blocks: the median of the slopes of all pairs (Theil and Sen)."""
    count = min(BLOCKS, len(x))
    edges = np.linspace(0, len(x), count + 1).astype(int)
    blocks = [slice(start, end) for start, end in pairwise(edges)]
    bx = np.array([np.median(x[block]) for block in blocks])
    by = np.array([np.median(y[block]) for block in blocks])
    first, second = np.triu_indices(count, k=1)
    slope = float(np.median((by[second] - by[first]) / (bx[second] - bx[first])))
    return slope, float(np.median(by - slope * bx))


def _straight_line(x: FloatArray, y: FloatArray, slope: float) -> tuple[float, float]:
    """Least squares; ``slope`` is kept where the points do not tell one."""
    dx = x - x.mean()
    scale = float(dx @ dx)
    if scale > 0:
        slope = float(dx @ (y - y.mean())) / scale
    return slope, float(y.mean() - slope * x.mean())
