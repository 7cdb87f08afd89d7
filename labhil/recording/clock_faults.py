"""What is wrong with the stamps of a stream: steps and rates that no clock has, and what they mean.

Looked for when a recording ends, so that whoever made it hears of it, and when it is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from labhil.recording.clock import LARGEST_DRIFT, ClockFit
from labhil.recording.clock_map import SMALLEST_STEP, steps_in
from labhil.recording.stamps import Stamps
from labhil.signals import FloatArray, IntArray

CRYSTAL = 500e-6
"""Two clocks differ by no more: a quartz crystal is within 100 ppm over years and temperatures, and a host's
clock is slewed by 500 ppm at most (the kernel's limit, also NTP's for a clock that works, RFC 5905)."""

SURE = 3.0
"""A rate counts as off once it is so many standard errors beyond that."""

DECLARED = 0.01
"""Host stamps whose mean rate is further from the declared one are named; timers of programs come nearer."""

NO_CLOCK_STEP = 5.0
"""Of host stamps alone a step is at least so many sample periods: a program's timer is late by some."""


class ClockFaultKind(StrEnum):
    """What may be wrong with stamps."""

    STEP = "clock_step"
    RATE = "clock_rate"
    NO_CLOCK = "no_device_clock"


@dataclass(frozen=True, slots=True)
class ClockFault:
    """One fault of a stream's stamps.

    ``times`` (s) are times of analysis; ``distorts_time`` says whether the time of analysis is itself wrong
    there, rather than only its place in the host's time. ``statement`` says what is wrong and what it means.
    """

    kind: ClockFaultKind
    times: tuple[float, ...]
    distorts_time: bool
    statement: str


def clock_faults(stamps: Stamps, fit: ClockFit, t: FloatArray) -> tuple[ClockFault, ...]:
    """Return what is wrong with the stamps of a stream whose clock is ``fit`` and whose times are ``t``
    (s)."""
    if len(stamps.seq) < 3:
        return ()
    if not fit.device_clock or stamps.are_one:
        return tuple(_of_host_stamps(stamps, fit, t))
    return (*_steps(stamps, fit, t), *_rate(fit, stamps))


def _steps(stamps: Stamps, fit: ClockFit, t: FloatArray) -> list[ClockFault]:
    """Jumps of one clock against the other, attributed by the samples' own numbers."""
    if not fit.steps:
        return []
    rows = np.array([step.row for step in fit.steps])
    sizes = np.array([step.size for step in fit.steps])
    own = _own_jumps(stamps, rows, sizes)
    faults = []
    if own.any():
        faults.append(
            ClockFault(
                ClockFaultKind.STEP, tuple(t[rows[own]].tolist()), True,
                f"the device's clock jumps{_where(-sizes[own] * stamps.speed, t[rows[own]])} against its own "
                "count of samples: the time of analysis is wrong there. Use one side only (option span).",
            )
        )  # fmt: skip
    if not own.all():
        sizes, rows = sizes[~own], rows[~own]
        faults.append(
            ClockFault(
                ClockFaultKind.STEP, tuple(t[rows].tolist()), False,
                f"the host's stamps jump{_where(sizes, t[rows])} against the device's clock: "
                f"{_cause(sizes, steady_host=stamps.steady_host)}. The time of analysis is the device's own "
                "and has no such jump; Unix times, times of events and the alignment with other devices do.",
            )
        )  # fmt: skip
    return faults


def _own_jumps(stamps: Stamps, rows: IntArray, sizes: FloatArray) -> np.ndarray:
    """Which steps are the device's: its clock advances there by other than its count of samples says."""
    period = float(np.median(np.diff(stamps.t_hw_ns) / np.maximum(np.diff(stamps.seq), 1)))
    ahead = (np.diff(stamps.t_hw_ns) - period * np.diff(stamps.seq))[rows - 1] * 1e-9 / stamps.speed
    return np.asarray(np.abs(ahead + sizes) < 0.5 * np.abs(sizes))


def _cause(sizes: FloatArray, *, steady_host: bool) -> str:
    stood = "the device stood still meanwhile (a simulated one does where its machine is busy)"
    if steady_host:
        late = "samples were held up for long before that"
        return stood if (sizes > 0).all() else late if (sizes < 0).all() else f"{stood}, or {late}"
    if (sizes < 0).all():
        return "the host's clock was set back"
    if (sizes > 0).all():
        return f"the host's clock was set ahead, or {stood}"
    return f"the host's clock was set, or {stood}"


def _where(sizes: FloatArray, times: FloatArray) -> str:
    """ " by −0.5 s at 5.4 s", or how often, by how much in all, and the largest."""
    largest = int(np.argmax(np.abs(sizes)))
    jump = f"{sizes[largest]:+.4g} s at {times[largest]:.4g} s".replace("-", "−")
    if len(sizes) == 1:
        return f" by {jump}"
    return f" {len(sizes)} times, by {float(sizes.sum()):+.4g} s in all, the largest {jump}".replace("-", "−")


def _rate(fit: ClockFit, stamps: Stamps) -> list[ClockFault]:
    error, slope = fit.drift_error, 0.0 if fit.map is None else fit.map.slope
    if fit.drift == 0.0 and abs(slope) > LARGEST_DRIFT:
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
    if abs(fit.drift) <= CRYSTAL + SURE * (error or 0.0):
        return []
    if error is None and abs(slope) <= LARGEST_DRIFT:
        return []
    known = "" if error is None else f" ± {1e6 * error:.2g}"
    why = "the host's clock was slewed, or the device's has no crystal (a ceramic resonator: 5000 ppm)"
    if fit.drift < 0.0:
        why += ", or the device stands still now and then (a simulated one where its machine is busy)"
    return [
        ClockFault(
            ClockFaultKind.RATE, (), False,
            f"the device's clock runs {1e6 * fit.drift:+.0f}{known} ppm against the host's, and two crystals "
            f"differ by {1e6 * CRYSTAL:.0f} at most: {why}. The time of analysis is the device's own; if "
            "that is the wrong one, all times and rates are off by this share.".replace("-", "−", 1),
        )
    ]  # fmt: skip


def _of_host_stamps(stamps: Stamps, fit: ClockFit, t: FloatArray) -> list[ClockFault]:
    """Steps and stretches where there are host stamps only: the samples' numbers are the other clock."""
    faults = []
    numbers = np.diff(stamps.seq)
    moves = np.diff(stamps.t_hw_ns)
    if not fit.device_clock and (moves != 0).any() and not stamps.are_one:
        still = int(np.count_nonzero(moves <= 0))
        what = f"does not advance at {still} samples" if still else "runs at another rate than it declares"
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
    smallest = max(SMALLEST_STEP, NO_CLOCK_STEP * period)
    jumps = [(row, size) for row, size in steps_in(x, delay) if abs(size) >= smallest]
    # what a program's timer does over many samples is no step
    lone = [(r, s) for r, s in jumps if (steps[r - 1] - period * numbers[r - 1]) / s > 0.5]
    if stamps.are_one:
        # a table may have rows at any times, and gaps; but rows that were left out cannot have taken no time
        lone, jumps = [(r, s) for r, s in lone if s < 0.0], []
    if lone:
        faults.append(_step_of_host_stamps(stamps, t, lone))
    faults += _stretches(stamps, t, [pair for pair in jumps if pair not in lone], period)
    return faults


def _step_of_host_stamps(stamps: Stamps, t: FloatArray, jumps: list[tuple[int, float]]) -> ClockFault:
    rows, sizes = np.array([row for row, _ in jumps]), np.array([size for _, size in jumps])
    back = bool((sizes < 0).any())
    why = "nothing was sampled then, or the clock was set ahead"
    if back:
        why = "the clock was set, or rows are repeated" if stamps.are_one else "the clock was set"
        why += ". The time of analysis is wrong there: use one side only (option span)"
    return ClockFault(
        ClockFaultKind.STEP, tuple(t[rows].tolist()), back,
        f"the times jump{_where(sizes * stamps.speed, t[rows])} against the count of samples, and the device "
        f"has no clock of its own: {why}.",
    )  # fmt: skip


def _stretches(
    stamps: Stamps, t: FloatArray, moves: list[tuple[int, float]], period: float
) -> list[ClockFault]:
    """Host stamps that run slower or faster than the samples for a while, or all the time."""
    if stamps.are_one:
        return []
    faults = []
    if moves:
        rows, sizes = np.array([row for row, _ in moves]), np.array([size for _, size in moves])
        faults.append(
            ClockFault(
                ClockFaultKind.RATE, tuple(t[rows].tolist()), False,
                f"the times part from the count of samples{_where(sizes * stamps.speed, t[rows])}, little by "
                "little, and the device has no clock of its own: the host's clock was slewed, or sampling "
                "was slower or faster there.",
            )
        )  # fmt: skip
    declared = stamps.rate * period * stamps.speed
    if abs(declared - 1.0) > DECLARED:
        faults.append(
            ClockFault(
                ClockFaultKind.RATE, (), False,
                f"samples come at {stamps.rate / declared:.5g} Hz by the host's stamps, declared are "
                f"{stamps.rate:.5g} Hz, and the device has no clock of its own to tell which is right.",
            )
        )  # fmt: skip
    return faults
