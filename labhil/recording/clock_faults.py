"""Faults in the stamps of a stream: steps and rates that no clock has, and their likely causes.

A recorder looks for them when a recording ends, a reader when it opens one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from labhil.recording.clock import MAX_DRIFT, ClockFit
from labhil.recording.clock_map import MIN_STEP, find_steps
from labhil.recording.stamps import Stamps
from labhil.signals import FloatArray, IntArray

MAX_CRYSTAL_DRIFT = 500e-6
"""Largest relative difference of two sound clocks.

A quartz crystal is within 100 ppm over years and temperatures. A host's clock is slewed by 500 ppm at most
(limit of the Linux kernel and of NTP, RFC 5905).
"""


class ClockFaultKind(StrEnum):
    """Kinds of faults of stamps."""

    STEP = "clock_step"
    RATE = "clock_rate"
    NO_CLOCK = "no_device_clock"


@dataclass(frozen=True, slots=True)
class ClockFault:
    """A fault of a stream's stamps.

    Attributes:
        kind: what is wrong.
        times: where, in s of the time of analysis.
        distorts_time: whether the time of analysis is wrong there, not only its relation to Unix time.
        statement: what is wrong and what follows, for messages.
    """

    kind: ClockFaultKind
    times: tuple[float, ...]
    distorts_time: bool
    statement: str


def find_clock_faults(stamps: Stamps, fit: ClockFit, t: FloatArray) -> tuple[ClockFault, ...]:
    """Find faults in the stamps of a stream.

    Args:
        stamps: its stamps.
        fit: its clock.
        t: its times of analysis, (n,) s.

    Returns:
        The faults, none for fewer than three samples.
    """
    if len(stamps.seq) < 3:
        return ()
    if not fit.device_clock or stamps.share_clock:
        return tuple(_host_stamp_faults(stamps, fit, t))
    return (*_step_faults(stamps, fit, t), *_rate_faults(fit, stamps))


def _step_faults(stamps: Stamps, fit: ClockFit, t: FloatArray) -> list[ClockFault]:
    """Steps of one clock against the other; the samples' numbers show which clock made them."""
    if not fit.steps:
        return []
    rows = np.array([step.row for step in fit.steps])
    sizes = np.array([step.size for step in fit.steps])
    by_device = _are_device_steps(stamps, rows, sizes)
    faults = []
    if by_device.any():
        jumps = _format_jumps(-sizes[by_device] * stamps.speed, t[rows[by_device]])
        faults.append(
            ClockFault(
                ClockFaultKind.STEP, tuple(t[rows[by_device]].tolist()), True,
                f"the device's clock jumps{jumps} against its own count of samples: the time of analysis is "
                "wrong there. Use one side only (option span).",
            )
        )  # fmt: skip
    if not by_device.all():
        sizes, rows = sizes[~by_device], rows[~by_device]
        cause = _step_cause(sizes, steady_host=stamps.steady_host)
        faults.append(
            ClockFault(
                ClockFaultKind.STEP, tuple(t[rows].tolist()), False,
                f"the host's stamps jump{_format_jumps(sizes, t[rows])} against the device's clock: "
                f"{cause}. The time of analysis is the device's own "
                "and has no such jump; Unix times, times of events and the alignment with other devices do.",
            )
        )  # fmt: skip
    return faults


def _are_device_steps(stamps: Stamps, rows: IntArray, sizes: FloatArray) -> np.ndarray:
    """Whether the device's clock made each step: it disagrees there with its own count of samples."""
    period = float(np.median(np.diff(stamps.t_hw_ns) / np.maximum(np.diff(stamps.seq), 1)))
    ahead = (np.diff(stamps.t_hw_ns) - period * np.diff(stamps.seq))[rows - 1] * 1e-9 / stamps.speed
    return np.asarray(np.abs(ahead + sizes) < 0.5 * np.abs(sizes))


def _step_cause(sizes: FloatArray, *, steady_host: bool) -> str:
    pause = "the device stood still meanwhile (a simulated one does where its machine is busy)"
    if steady_host:
        delay = "samples were held up for long before that"
        return pause if (sizes > 0).all() else delay if (sizes < 0).all() else f"{pause}, or {delay}"
    if (sizes < 0).all():
        return "the host's clock was set back"
    if (sizes > 0).all():
        return f"the host's clock was set ahead, or {pause}"
    return f"the host's clock was set, or {pause}"


def _format_jumps(sizes: FloatArray, times: FloatArray) -> str:
    """ " by −0.5 s at 5.4 s" for one jump; number, total and largest of several."""
    largest = int(np.argmax(np.abs(sizes)))
    jump = f"{sizes[largest]:+.4g} s at {times[largest]:.4g} s".replace("-", "−")
    if len(sizes) == 1:
        return f" by {jump}"
    return f" {len(sizes)} times, by {float(sizes.sum()):+.4g} s in all, the largest {jump}".replace("-", "−")


def _rate_faults(fit: ClockFit, stamps: Stamps, min_standard_errors: float = 3.0) -> list[ClockFault]:
    """Fault of a rate that exceeds ``MAX_CRYSTAL_DRIFT`` by some standard errors."""
    error, slope = fit.drift_error, 0.0 if fit.map is None else fit.map.slope
    if fit.drift == 0.0 and abs(slope) > MAX_DRIFT:
        away = "falls behind" if slope > 0.0 else "runs ahead of"
        return [
            ClockFault(
                ClockFaultKind.RATE, (), False,
                f"the device's clock {away} the host's by {100 * abs(slope):.2g} %, for too short a time to "
                "say why: samples were held up, or the device stood still (a simulated one where its machine "
                "is busy). The time of analysis is the device's own; Unix times, times of events and the "
                "alignment with other devices are off by that.",
            )
        ]  # fmt: skip
    if abs(fit.drift) <= MAX_CRYSTAL_DRIFT + min_standard_errors * (error or 0.0):
        return []
    if error is None and abs(slope) <= MAX_DRIFT:
        return []
    uncertainty = "" if error is None else f" ± {1e6 * error:.2g}"
    why = "the host's clock was slewed, or the device's has no crystal (a ceramic resonator: 5000 ppm)"
    if fit.drift < 0.0:
        why += ", or the device stands still now and then (a simulated one where its machine is busy)"
    return [
        ClockFault(
            ClockFaultKind.RATE, (), False,
            f"the device's clock runs {1e6 * fit.drift:+.0f}{uncertainty} ppm against the host's, and two "
            f"crystals differ by {1e6 * MAX_CRYSTAL_DRIFT:.0f} at most: {why}. The time of analysis is the "
            "device's own; if that is the wrong one, all times and rates are off by this share."
            .replace("-", "−", 1),
        )
    ]  # fmt: skip


def _host_stamp_faults(
    stamps: Stamps, fit: ClockFit, t: FloatArray, min_step_periods: float = 5.0
) -> list[ClockFault]:
    """Faults of host stamps, compared with the samples' numbers where there is no device clock.

    A step has at least ``min_step_periods`` sample periods, since a program's timer is late by some.
    """
    faults = []
    numbers = np.diff(stamps.seq)
    moves = np.diff(stamps.t_hw_ns)
    if not fit.device_clock and (moves != 0).any() and not stamps.share_clock:
        n_stopped = int(np.count_nonzero(moves <= 0))
        what = "runs at another rate than it declares"
        if n_stopped:
            what = f"does not advance at {n_stopped} samples"
        faults.append(
            ClockFault(
                ClockFaultKind.NO_CLOCK, (), False,
                f"the device's clock {what}, so the times are the host's stamps, late by what a busy machine "
                "adds.",
            )
        )  # fmt: skip
    if (numbers <= 0).any():
        return faults
    steps = np.diff(stamps.t_acq_ns) * 1e-9
    period = float(np.median(steps / numbers))
    if period <= 0.0:
        return faults
    x = (stamps.seq - stamps.seq[0]) * period
    delay = (stamps.t_acq_ns - stamps.t_acq_ns[0]) * 1e-9 - x
    smallest = max(MIN_STEP, min_step_periods * period)
    jumps = [(row, size) for row, size in find_steps(x, delay) if abs(size) >= smallest]
    # a drift of a program's timer over many samples is no step
    sudden = [(r, s) for r, s in jumps if (steps[r - 1] - period * numbers[r - 1]) / s > 0.5]
    if stamps.share_clock:
        # rows of a table may come at any times, with gaps, but skipped rows must have taken some time
        sudden, jumps = [(r, s) for r, s in sudden if s < 0.0], []
    if sudden:
        faults.append(_host_step_fault(stamps, t, sudden))
    if not stamps.share_clock:
        faults += _host_rate_faults(stamps, t, [pair for pair in jumps if pair not in sudden], period)
    return faults


def _host_step_fault(stamps: Stamps, t: FloatArray, jumps: list[tuple[int, float]]) -> ClockFault:
    rows, sizes = np.array([row for row, _ in jumps]), np.array([size for _, size in jumps])
    back = bool((sizes < 0).any())
    why = "nothing was sampled then, or the clock was set ahead"
    if back:
        why = "the clock was set, or rows are repeated" if stamps.share_clock else "the clock was set"
        why += ". The time of analysis is wrong there: use one side only (option span)"
    return ClockFault(
        ClockFaultKind.STEP, tuple(t[rows].tolist()), back,
        f"the times jump{_format_jumps(sizes * stamps.speed, t[rows])} against the count of samples, and the "
        f"device has no clock of its own: {why}.",
    )  # fmt: skip


def _host_rate_faults(
    stamps: Stamps,
    t: FloatArray,
    drifts: list[tuple[int, float]],
    period: float,
    max_rate_error: float = 0.01,
) -> list[ClockFault]:
    """Faults of host stamps that are slower or faster than the samples, for a while or all the time.

    A mean rate within ``max_rate_error`` of the declared one is sound: a program's timer is better.
    """
    faults = []
    if drifts:
        rows, sizes = np.array([row for row, _ in drifts]), np.array([size for _, size in drifts])
        faults.append(
            ClockFault(
                ClockFaultKind.RATE, tuple(t[rows].tolist()), False,
                f"the times part from the count of samples{_format_jumps(sizes * stamps.speed, t[rows])}, "
                "gradually, and the device has no clock of its own: the host's clock was slewed, or "
                "sampling was slower or faster there.",
            )
        )  # fmt: skip
    rate_ratio = stamps.rate * period * stamps.speed
    if abs(rate_ratio - 1.0) > max_rate_error:
        faults.append(
            ClockFault(
                ClockFaultKind.RATE, (), False,
                f"samples come at {stamps.rate / rate_ratio:.5g} Hz by the host's stamps, declared are "
                f"{stamps.rate:.5g} Hz, and the device has no clock of its own to tell which is right.",
            )
        )  # fmt: skip
    return faults
