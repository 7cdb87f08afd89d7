"""A fault of the data as a value: its kind, where it is, the share of samples, and the message to people.

The detectors are called in :mod:`labhil.diagnose.intake`; how much of a fault is tolerated stands here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from labhil.physics.record import Record
from labhil.signals import FloatArray


class FaultKind(StrEnum):
    """The kinds of fault that data may have."""

    NOT_FINITE = "not_finite"
    TIME_ORDER = "time_order"
    GAP = "gap"
    STUCK = "stuck"
    SATURATED = "saturated"
    OUTLIER = "outlier"
    ZERO_STEP = "zero_step"
    CLOCK_DRIFT = "clock_drift"
    CLOCK_STEP = "clock_step"
    CLOCK_RATE = "clock_rate"
    NO_DEVICE_CLOCK = "no_device_clock"
    NO_EXCITATION = "no_excitation"
    UNDERSAMPLED = "undersampled"
    WRAPPED = "wrapped"
    LEAD = "lead"


TOLERATED_SHARE: Mapping[FaultKind, float] = {
    FaultKind.NOT_FINITE: 0.0,
    FaultKind.TIME_ORDER: 0.0,
    FaultKind.GAP: 0.2,
    FaultKind.STUCK: 0.01,
    FaultKind.SATURATED: 0.5,
    FaultKind.OUTLIER: 0.02,
    FaultKind.ZERO_STEP: 0.0,
    FaultKind.CLOCK_DRIFT: 0.0,
    FaultKind.CLOCK_STEP: 0.0,
    FaultKind.WRAPPED: 0.0,
    FaultKind.LEAD: 0.0,
    FaultKind.UNDERSAMPLED: 0.0,
}
"""Share of the samples up to which a fault is only reported. Kinds that are not listed are always tolerated.

A reading at the end of a range is a one-sided bound on the true value and counts as one in residuals. Where
more than half of a channel is clipped, not even its median is known.
"""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of one channel.

    Attributes:
        kind: what is wrong.
        channel: name of the channel, "t" for the time stamps themselves.
        joint: number of the joint that the channel belongs to, None where it belongs to none.
        times: spans (begin, end) in s of the recording.
        share: share of the samples that are affected; for gaps the share of the time that windows bridge.
        statement: message with what is wrong, where, when, how much, and what to do about it.
        recording: number from 1 of the recording, in whose own time ``times`` are; None of a single one.
        mended: whether the fault changes no number that is calculated from the data.
    """

    kind: FaultKind
    channel: str
    joint: int | None
    times: tuple[tuple[float, float], ...]
    share: float
    statement: str
    recording: int | None = None
    mended: bool = False


@dataclass(frozen=True, slots=True)
class RecordedChannel:
    """One column of a recording with what is known of it.

    Attributes:
        name: name of the signal.
        joint: number of its joint, None where it belongs to none.
        values: readings (n,).
        sigma: standard deviation of its noise, in its unit.
        drive: inputs (n, m) that may move it from one sample to the next.
        is_position: whether it is the position of a body, which cannot jump.
        may_rest: whether it may stand still at any value and leave that for a while, since what drives it
            is not recorded.
    """

    name: str
    joint: int | None
    values: FloatArray
    sigma: float
    drive: FloatArray
    is_position: bool = False
    may_rest: bool = False

    @property
    def label(self) -> str:
        """Name of the channel in messages."""
        return self.name if self.joint is None else f"{self.name} of joint {self.joint}"


def fault_in_spans(
    record: Record,
    channel: RecordedChannel,
    kind: FaultKind,
    spans: Sequence[tuple[int, int]],
    share: float,
    statement: str,
) -> Fault:
    """Return a fault of a channel whose place is given in samples.

    Args:
        record: the recording, for its time stamps.
        channel: the channel that has the fault.
        kind: what is wrong.
        spans: first and last samples of each stretch.
        share: share of the samples that are affected.
        statement: message to people.

    Returns:
        The fault, with its spans in seconds.
    """
    times = tuple((float(record.t[first]), float(record.t[last])) for first, last in spans)
    return Fault(kind, channel.name, channel.joint, times, share, statement)


def format_spans(record: Record, spans: Sequence[tuple[int, int]]) -> str:
    """Return " at 3.1 s" or " from 3.1 to 3.4 s" of one span of samples, else their number and extent.

    Args:
        record: the recording, for its time stamps.
        spans: first and last samples of each stretch, in order of time.

    Returns:
        A phrase for a message, with a space before it.
    """
    first, last = record.t[spans[0][0]], record.t[spans[-1][1]]
    if len(spans) == 1:
        return f" at {first:.4g} s" if first == last else f" from {first:.4g} to {last:.4g} s"
    return f" {len(spans)} times between {first:.4g} and {last:.4g} s"


def format_percent(share: float) -> str:
    """Return a share (0 to 1) in percent with two digits, as messages show it."""
    return f"{100 * share:.2g} %"
