"""The time in which recordings are analysed, and how it lies in the host's.

A device stamps its samples with its own clock. That clock is the time of analysis, at its own rate: no
model is bent by a host whose clock is set or slewed, or whose scheduler is late. The host's stamps only say
where the device's time lies in that of the host: for events, for other devices, for Unix time.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labhil.recording.clock_map import CONGESTION, ClockMap, ClockStep, DelayLine, delay_line, steps_in
from labhil.signals import FloatArray, IntArray

OUTLIER = 4.0
"""Stamps whose delay is beyond that many robust standard deviations from the usual one are outliers."""

SMALLEST_SPREAD = 1e-6
"""s; no smaller deviation makes an outlier."""

LARGEST_DRIFT = 0.02
"""No oscillator is so far off, not even an RC one of a microcontroller: then units or the speed are wrong."""

LONGEST_PAUSES = 1.0
"""Seconds that the host may have spent more, per second of a device's clock that is even in itself: a
simulated device whose world stands still while its machine is busy."""

EVEN = 1e-3
"""Share of a period by which steps of an even clock differ from whole periods."""

STEADY = 1e-3
"""How near to its declared rate a clock has to be to be believed against the host's."""


@dataclass(frozen=True, slots=True)
class ClockFit:
    """How a device's clock runs against the host's.

    ``t`` is the time of the samples in seconds of the device's world: its own clock, set at its first sample
    to the host's time since ``origin`` (shape (n,)); the host's stamps where the device has no clock that
    can be used (``device_clock`` False). ``drift`` is the relative error of the device's clock against the
    host's (50e-6: 50 ppm fast; 0 where unknown), ``jitter`` the robust standard deviation of the stamps'
    delays, s; ``outliers`` how many are far off. ``offset_error`` (s, in the middle of the longest stretch
    without steps) and ``drift_error`` are standard errors; None where unknown. ``steps`` are jumps of the
    host's stamps against the device's clock; ``map`` leads from the one to the other. ``spread`` (s) is by
    how much the middle one of the stamps is later than the least delayed ones, on which the map lies.
    """

    t: FloatArray
    drift: float
    jitter: float
    outliers: int
    device_clock: bool
    offset_error: float | None = None
    drift_error: float | None = None
    steps: tuple[ClockStep, ...] = ()
    map: ClockMap | None = None
    spread: float = 0.0


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
    """Find the time of analysis of samples, and how it lies in the host's.

    Args:
        t_hw_ns: The device's clock at each sample, (n,).
        t_acq_ns: The host's, (n,).
        origin_ns: Where the host's time is 0.
        speed: How many seconds of the device's world pass in one second of the host.
        steady: Whether the device's clock is known to keep its declared rate (:func:`keeps_its_rate`).

    Returns:
        The device's own time. Where its clock does not advance with every sample, or runs at quite another
        rate than the host's (and neither keeps the declared one nor has only paused), the host's.
    """
    host: FloatArray = np.asarray((t_acq_ns - origin_ns) * 1e-9, dtype=np.float64)
    if len(host) < 3 or not (np.diff(t_hw_ns) > 0).all():
        return ClockFit(host * speed, 0.0, 0.0, 0, device_clock=False)
    device = (t_hw_ns - t_hw_ns[0]) * 1e-9
    x = device / speed
    delay = host - x
    steps = tuple(ClockStep(row, size) for row, size in steps_in(x, delay))
    line, clock_map = _map_clock(int(t_hw_ns[0]), origin_ns, speed, x, delay, steps)
    wrong = abs(line.slope) > LARGEST_DRIFT
    paused = wrong and 0.0 < line.slope < LONGEST_PAUSES and _is_even(device)
    if wrong and not steady and not paused:
        return ClockFit(host * speed, 0.0, 0.0, 0, device_clock=False)
    late = host - clock_map.host(x)
    jitter, outliers = _jitter(late)
    begin = float(clock_map.steady_host(np.zeros(1))[0])
    return ClockFit(
        t=np.asarray(device + speed * begin, dtype=np.float64),
        # over a few seconds, a queue that fills or drains looks like such a rate
        drift=0.0 if wrong and line.span < CONGESTION else 1.0 / (1.0 + line.slope) - 1.0,
        jitter=jitter * speed,
        outliers=outliers,
        device_clock=True,
        offset_error=None if wrong or line.level_error is None else line.level_error * speed,
        drift_error=None if wrong else line.slope_error,
        steps=steps,
        map=clock_map,
        spread=max(float(np.median(late)), 0.0) * speed,
    )


def _map_clock(
    zero_ns: int,
    origin_ns: int,
    speed: float,
    x: FloatArray,
    delay: FloatArray,
    steps: tuple[ClockStep, ...],
) -> tuple[DelayLine, ClockMap]:
    """The line of the longest stretch without steps, and the map that continues it across them."""
    edges = [0, *(step.row for step in steps), len(x)]
    stretches = [slice(first, last) for first, last in pairwise(edges) if last > first]
    longest = max(range(len(stretches)), key=lambda k: float(x[stretches[k]][-1] - x[stretches[k]][0]))
    line = delay_line(x[stretches[longest]], delay[stretches[longest]])
    stepped = np.concatenate([[0.0], np.cumsum([step.size for step in steps])])
    levels = line.level + stepped - stepped[longest]
    begins = x[[0, *(step.row for step in steps)]]
    return line, ClockMap(zero_ns, origin_ns, speed, begins, levels, line.slope, line.middle, float(x[-1]))


def _jitter(residual: FloatArray) -> tuple[float, int]:
    usual = float(np.median(residual))
    spread = max(1.4826 * float(np.median(np.abs(residual - usual))), SMALLEST_SPREAD)
    return spread, int(np.count_nonzero(np.abs(residual - usual) > OUTLIER * spread))


def _is_even(device: FloatArray) -> bool:
    """Whether a clock advances by whole periods; lost samples take several."""
    steps = np.diff(device)
    periods = steps / np.median(steps)
    return bool(np.mean(np.abs(periods - np.rint(periods)) < EVEN) > 0.99)
