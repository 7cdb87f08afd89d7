"""The stamps of a stream's samples, and by which of a device's clocks its streams are timed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.recording.clock import ClockFit, keeps_declared_rate
from labhil.recording.timeline import increasing_stretches
from labhil.signals import IntArray

HOST_CLOCK = "host_clock_offset_ns"
"""What a stream's metadata name where the host stamped by a clock that nobody sets
(:mod:`labhil.host_clock`):
Unix time less that clock, ns."""


SAME_CLOCK = 10.0
"""s; stamps of another stream of a device that lie further off are of another clock than the device's."""


@dataclass(frozen=True, slots=True)
class Stamps:
    """The stamps of one stream, (n,) each, and what is known of them.

    ``rate`` (Hz) is the declared one, ``speed`` that of the device's world; ``steady_host`` says that the
    host stamped by a clock that nobody sets (:mod:`labhil.host_clock`).
    """

    seq: IntArray
    t_hw_ns: IntArray
    t_acq_ns: IntArray
    rate: float
    speed: float = 1.0
    steady_host: bool = False

    @property
    def keep_rate(self) -> bool:
        """Whether the device's clock keeps its declared rate."""
        return keeps_declared_rate(self.t_hw_ns, self.seq, self.rate)

    @property
    def are_one(self) -> bool:
        """Whether host and device stamped by the same clock, as in an imported table."""
        return bool(np.array_equal(self.t_hw_ns, self.t_acq_ns))


def in_time_of(stamps: Stamps, own_clock: ClockFit, main: ClockFit | None, *, measured: bool) -> ClockFit:
    """Return the times of a stream by the clock ``main`` of its device; ``own`` where that is another one.

    Args:
        stamps: The stamps of the stream.
        own: What they say by themselves.
        main: The clock of the device's longest stream, None where it has none.
        measured: Whether the device made the stamps, or its host worked them out from the newest sample.
    """
    if main is None or main.map is None or own_clock is main or not len(stamps.seq):
        return own_clock
    host = (stamps.t_acq_ns - main.map.origin_ns) * 1e-9
    x = main.map.elapsed(stamps.t_hw_ns)
    if not measured:
        # where the newest sample was late or the host was set, these go astray
        rows = max(increasing_stretches(x), key=len)
        x = np.interp(np.arange(len(x)), rows, x[rows])
    elif (
        not (np.diff(stamps.t_hw_ns) > 0).all() or abs(float(np.median(host - main.map.host(x)))) > SAME_CLOCK
    ):
        return own_clock
    begin = float(main.map.steady_host(np.zeros(1))[0])
    return replace(main, t=(x + begin) * stamps.speed)
