"""What a fault of the data is, and how it is put into words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from labhil.physics.model import Record
from labhil.signals import FloatArray


class Kind(StrEnum):
    """What may be wrong with data."""

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


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of one channel (``channel`` "t" for the time itself).

    ``times`` are spans (begin, end) in s of the record; ``share`` is the part of the samples that is
    affected, for gaps that of the time which windows bridge; ``statement`` says what, where, when, how much
    and what to do about it. Of several recordings ``recording`` is the one, in whose own time ``times`` are.
    What is ``mended`` takes nothing from numbers that are calculated from the data.
    """

    kind: Kind
    channel: str
    joint: int | None
    times: tuple[tuple[float, float], ...]
    share: float
    statement: str
    recording: int | None = None
    mended: bool = False


@dataclass(frozen=True, slots=True)
class Channel:
    """One column with what is known of it: its name, joint, values (n,) and noise.

    ``drive`` (n, m) are the inputs that may move it at once; ``position`` says that it cannot jump,
    ``rests`` that it may be silent at any value and leave it for a while: what drives it is not known.
    """

    name: str
    joint: int | None
    values: FloatArray
    sigma: float
    drive: FloatArray
    position: bool = False
    rests: bool = False

    @property
    def called(self) -> str:
        """How messages call it."""
        return self.name if self.joint is None else f"{self.name} of joint {self.joint}"


def fault_of(
    record: Record,
    channel: Channel,
    kind: Kind,
    spans: Sequence[tuple[int, int]],
    share: float,
    statement: str,
) -> Fault:
    """A fault of a channel in some spans (first, last) of samples."""
    times = tuple((float(record.t[first]), float(record.t[last])) for first, last in spans)
    return Fault(kind, channel.name, channel.joint, times, share, statement)


def when(record: Record, spans: Sequence[tuple[int, int]]) -> str:
    """ " from 3.1 to 3.4 s", or how often and between which times."""
    first, last = record.t[spans[0][0]], record.t[spans[-1][1]]
    if len(spans) == 1:
        return f" at {first:.4g} s" if first == last else f" from {first:.4g} to {last:.4g} s"
    return f" {len(spans)} times between {first:.4g} and {last:.4g} s"


def percent(share: float) -> str:
    """A share as messages write it."""
    return f"{100 * share:.2g} %"
