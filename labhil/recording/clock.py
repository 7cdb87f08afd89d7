"""Time base in which recordings are analysed, and its relation to the host's time.

A device stamps its samples with its own clock, whose time is the time of analysis. Steps or slews of the
host's clock and delays of its scheduler do not distort it. The host's stamps only map it to Unix time, for
events and other devices. ``clock_map.py`` contains the map.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labhil.recording.clock_map import (
    MAX_CONGESTION,
    ClockMap,
    ClockStep,
    DelayLine,
    find_steps,
    fit_delay_line,
)
from labhil.signals import FloatArray, IntArray

MAX_DRIFT = 0.02
"""Largest relative error of an oscillator (a microcontroller's RC oscillator); beyond it units are wrong."""


@dataclass(frozen=True, slots=True)
class ClockFit:
    """Time of samples by a device's clock, and how this clock runs against the host's.

    Attributes:
        t: time of the samples, (n,), s of the device's world: its own clock, set to the host's time at its
            first sample; the host's stamps if the device has no usable clock.
        drift: relative error of the device's clock (50e-6: 50 ppm fast); 0 if unknown.
        jitter: robust standard deviation of the stamps' delays, s.
        outliers: number of stamps with unusual delays.
        device_clock: whether ``t`` is from the device's clock.
        offset_error: standard error of the map in the middle of its longest line, s; None if unknown.
        drift_error: standard error of ``drift``; None if unknown.
        steps: steps of the host's stamps against the device's clock.
        map: map between both clocks. ``spread`` (s) is by
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


def keeps_declared_rate(
    t_hw_ns: IntArray, seq: IntArray, rate: float, *, max_rate_error: float = 1e-3
) -> bool:
    """Check whether 99 % of the samples have the declared period by the device's clock.

    Such a clock counts even where it disagrees with the host's: a simulated device falls behind the host's
    clock by any amount on a busy machine, and its own clock is the time of its world.

    Args:
        t_hw_ns: the device's clock at each sample, (n,).
        seq: sequence numbers of the samples, (n,).
        rate: declared sampling rate, Hz.
        max_rate_error: largest relative error of a period.

    Returns:
        Whether the clock keeps its rate.
    """
    steps = np.diff(t_hw_ns) * 1e-9 * rate
    numbers = np.diff(seq)
    return len(steps) > 0 and bool(np.mean(np.abs(steps - numbers) <= max_rate_error * numbers) > 0.99)


def fit_clock(
    t_hw_ns: IntArray,
    t_acq_ns: IntArray,
    origin_ns: int,
    speed: float = 1.0,
    steady: bool = False,
    *,
    max_pauses: float = 1.0,
) -> ClockFit:
    """Determine the time of analysis of samples, and its relation to the host's time.

    Args:
        t_hw_ns: the device's clock at each sample, (n,).
        t_acq_ns: the host's clock at each sample, (n,).
        origin_ns: Unix time at which the host's time is 0.
        speed: seconds of the device's world per second of the host.
        steady: whether the device's clock keeps its declared rate (:func:`keeps_declared_rate`).
        max_pauses: longest time, in s per second of an even device clock, for which a simulated device may
            have stood still on a busy machine.

    Returns:
        The device's own time. The host's time if the device's clock does not advance with every sample, or
        if its rate is wrong: beyond ``MAX_DRIFT``, not declared and not explained by pauses.
    """
    host: FloatArray = np.asarray((t_acq_ns - origin_ns) * 1e-9, dtype=np.float64)
    if len(host) < 3 or not (np.diff(t_hw_ns) > 0).all():
        return ClockFit(host * speed, 0.0, 0.0, 0, device_clock=False)
    device = (t_hw_ns - t_hw_ns[0]) * 1e-9
    x = device / speed
    delay = host - x
    steps = tuple(ClockStep(row, size) for row, size in find_steps(x, delay))
    line, clock_map = _map_clock(int(t_hw_ns[0]), origin_ns, speed, x, delay, steps)
    implausible = abs(line.slope) > MAX_DRIFT
    paused = implausible and 0.0 < line.slope < max_pauses and _is_even(device)
    if implausible and not steady and not paused:
        return ClockFit(host * speed, 0.0, 0.0, 0, device_clock=False)
    late = host - clock_map.host(x)
    jitter, outliers = _jitter(late)
    begin = float(clock_map.steady_host(np.zeros(1))[0])
    return ClockFit(
        t=np.asarray(device + speed * begin, dtype=np.float64),
        # a queue that fills or drains looks like such a rate for a few seconds
        drift=0.0 if implausible and line.span < MAX_CONGESTION else 1.0 / (1.0 + line.slope) - 1.0,
        jitter=jitter * speed,
        outliers=outliers,
        device_clock=True,
        offset_error=None if implausible or line.level_error is None else line.level_error * speed,
        drift_error=None if implausible else line.slope_error,
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
    """Line of the longest stretch without steps, and the map that continues it across steps."""
    edges = [0, *(step.row for step in steps), len(x)]
    stretches = [slice(first, last) for first, last in pairwise(edges) if last > first]
    longest = max(range(len(stretches)), key=lambda k: float(x[stretches[k]][-1] - x[stretches[k]][0]))
    line = fit_delay_line(x[stretches[longest]], delay[stretches[longest]])
    stepped = np.concatenate([[0.0], np.cumsum([step.size for step in steps])])
    levels = line.level + stepped - stepped[longest]
    begins = x[[0, *(step.row for step in steps)]]
    return line, ClockMap(zero_ns, origin_ns, speed, begins, levels, line.slope, line.middle, float(x[-1]))


def _jitter(residual: FloatArray, min_spread: float = 1e-6, max_deviation: float = 4.0) -> tuple[float, int]:
    """Robust standard deviation (s) of residuals, and the number beyond ``max_deviation`` of these."""
    median = float(np.median(residual))
    spread = max(1.4826 * float(np.median(np.abs(residual - median))), min_spread)
    return spread, int(np.count_nonzero(np.abs(residual - median) > max_deviation * spread))


def _is_even(device: FloatArray, tolerance: float = 1e-3) -> bool:
    """Whether a clock advances by whole periods (several where samples are lost)."""
    steps = np.diff(device)
    periods = steps / np.median(steps)
    return bool(np.mean(np.abs(periods - np.rint(periods)) < tolerance) > 0.99)
