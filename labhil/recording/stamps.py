"""Stamps of a stream's samples, and the choice of the clock that times it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.recording.clock import ClockFit, keeps_declared_rate
from labhil.recording.timeline import MAX_WRONG_ROWS, increasing_stretches, longest_increase
from labhil.signals import FloatArray, IntArray

HOST_CLOCK = "host_clock_offset_ns"
"""Metadata key of a stream whose host stamped by a monotonic clock (:mod:`labhil.host_clock`).

The value is Unix time minus that clock, ns.
"""


@dataclass(frozen=True, slots=True)
class Stamps:
    """Stamps of the samples of one stream.

    Attributes:
        seq: sequence numbers, (n,).
        t_hw_ns: the device's clock, (n,).
        t_acq_ns: the host's clock, (n,).
        rate: declared sampling rate, Hz.
        speed: seconds of the device's world per second of the host.
        steady_host: whether the host stamped by a monotonic clock (:mod:`labhil.host_clock`).
    """

    seq: IntArray
    t_hw_ns: IntArray
    t_acq_ns: IntArray
    rate: float
    speed: float = 1.0
    steady_host: bool = False

    @property
    def keeps_rate(self) -> bool:
        """Whether the device's clock keeps its declared rate."""
        return keeps_declared_rate(self.t_hw_ns, self.seq, self.rate)

    @property
    def share_clock(self) -> bool:
        """Whether both stamps are from one clock, as in an imported table."""
        return bool(np.array_equal(self.t_hw_ns, self.t_acq_ns))


def with_device_time(
    stamps: Stamps,
    own_clock: ClockFit,
    main: ClockFit | None,
    *,
    measured: bool,
    max_clock_difference: float = 10.0,
) -> ClockFit:
    """Time a stream by the clock of its device, unless its stamps are from another clock.

    Args:
        stamps: the stamps of the stream.
        own_clock: the clock fitted to them alone.
        main: the clock of the device's longest stream; None if it has none.
        measured: whether the device made the stamps; else its host derived them from the newest sample.
        max_clock_difference: largest median difference of stamps from one clock, s.

    Returns:
        ``main`` with the times of the stream, or ``own_clock``.
    """
    if main is None or main.map is None or own_clock is main or not len(stamps.seq):
        return own_clock
    host = (stamps.t_acq_ns - main.map.origin_ns) * 1e-9
    x = main.map.elapsed(stamps.t_hw_ns)
    if not measured:
        # they are wrong where the newest sample was late or the host's clock was set
        rows = _rows_with_right_times(x)
        x = np.interp(np.arange(len(x)), rows, x[rows])
    elif (
        not (np.diff(stamps.t_hw_ns) > 0).all()
        or abs(float(np.median(host - main.map.host(x)))) > max_clock_difference
    ):
        return own_clock
    begin = float(main.map.steady_host(np.zeros(1))[0])
    return replace(main, t=(x + begin) * stamps.speed)


def _rows_with_right_times(x: FloatArray) -> IntArray:
    """Rows of requested values whose times increase; far into the world of a fast twin many do not.

    Its host derives them from the newest sample. One that is late by 10 ms is late by 0.4 s at 40 times real
    time, so that the times of many commands go back, and no stretch of increasing ones covers them all.
    """
    rows = max(increasing_stretches(x), key=len)
    is_whole = rows[0] <= MAX_WRONG_ROWS and len(x) - 1 - rows[-1] <= MAX_WRONG_ROWS
    return rows if is_whole else longest_increase(x)
