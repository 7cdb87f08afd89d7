"""Clocks of a recording's devices, each against the host's and against one another.

The recorder writes them as metadata when a recording ends. A constant latency between a device and the
host's stamp looks like an offset of its clock and is not removed; devices on equal wires share it.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import combinations
from math import hypot, isfinite

import numpy as np

from labhil.documents import parse_json
from labhil.recording.clock import ClockFit, fit_clock
from labhil.recording.stamps import Stamps
from labhil.signals import IntArray

CLOCKS = "clocks"
OFFSETS = "clock_offsets"
"""Names of the metadata: a JSON text for each device, and one for each pair of devices."""

MAX_STAMPS = 16384
"""Largest number of stamps of a device that are kept; of more, those with the least delay."""

STANDARD_ERRORS = 2.0
"""Standard errors of a bound: 95 % of a normal distribution lie within."""

MAX_ARRAYS = 512
"""Arrays of stamps from which they are joined: an array of one sample takes ten times its content."""


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """A device's clock against the host's.

    Attributes:
        t_host_ns: Unix time of a reference moment.
        t_device_ns: what the device's clock showed then.
        speed: seconds of the device's world per second of the host.
        drift: relative error of the device's clock (50e-6: 50 ppm fast).
        drift_error: its standard error.
        offset_error: standard error of ``t_device_ns``, s.
        jitter: robust standard deviation of the stamps' delays, s.
        samples: number of stamps used.
        outliers: number of stamps with unusual delays.
        stepped: sum of the absolute steps of the host's stamps, s of the host; 0 for a sound map.
        spread: median delay of the stamps over the least one, s.
    """

    t_host_ns: int
    t_device_ns: int
    speed: float
    drift: float
    drift_error: float
    offset_error: float
    jitter: float
    samples: int
    outliers: int
    stepped: float = 0.0
    spread: float = 0.0

    def device_ns(self, t_host_ns: int) -> int:
        """What the device's clock shows at Unix time ``t_host_ns``, ns."""
        elapsed = (t_host_ns - self.t_host_ns) * self.speed
        return self.t_device_ns + round(elapsed) + round(elapsed * self.drift)

    def error_at(self, t_host_ns: int) -> float:
        """Standard error of :meth:`device_ns`, s of the device's world; it grows with the distance in time.

        Steps count as a whole, since it is unknown on which side the host's clock was right.
        """
        drift_error = (t_host_ns - self.t_host_ns) * 1e-9 * self.speed * self.drift_error
        return hypot(self.offset_error, drift_error, self.stepped * self.speed)

    def bound_at(self, t_host_ns: int) -> float:
        """Bound of the error at Unix time ``t_host_ns``, s of the device's world.

        Stamps that can only be late do not show their least delay. By analogy with Cristian's bound, half of
        the round trip (Cristian 1989), half of the spread of the delays is added to two standard errors. A
        latency that never varies is not covered.
        """
        return STANDARD_ERRORS * self.error_at(t_host_ns) + 0.5 * self.spread


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Lead of one device's clock over another's.

    Attributes:
        offset: the lead, s.
        error: standard error that the scatter of the stamps gives, s.
        t_host_ns: Unix time at which it holds.
        bound: bound of the error, s, with what the stamps cannot show (:meth:`DeviceClock.bound_at`).
    """

    offset: float
    error: float
    t_host_ns: int
    bound: float = 0.0


class StampCollector:
    """Collector of the stamps of one device in bounded memory."""

    def __init__(self) -> None:
        self._arrays: list[IntArray] = []
        self._count = 0
        self._next = 0

    def add(self, t_acq_ns: IntArray, t_hw_ns: IntArray, seq: IntArray | None = None) -> None:
        """Add stamps, oldest first.

        Args:
            t_acq_ns: the host's clock, (n,).
            t_hw_ns: the device's clock, (n,).
            seq: sequence numbers, (n,); None if no sample is missing.
        """
        if seq is None:
            seq = np.arange(len(t_acq_ns), dtype=np.int64) + self._next
        if not len(seq):
            return
        self._next = int(seq[-1]) + 1
        self._arrays.append(np.column_stack([t_acq_ns, t_hw_ns, seq]))
        self._count += len(seq)
        if len(self._arrays) > MAX_ARRAYS:
            self._arrays = [np.concatenate(self._arrays)]
        while self._count > MAX_STAMPS * 2:
            thinned = _least_delayed(np.concatenate(self._arrays))
            self._arrays, self._count = [thinned], len(thinned)

    def stamps(self, rate: float, speed: float = 1.0, *, steady_host: bool = False) -> Stamps:
        """Stamps collected so far.

        Args:
            rate: declared sampling rate, Hz.
            speed: seconds of the device's world per second of the host.
            steady_host: whether the host stamped by a monotonic clock.

        Returns:
            At most ``MAX_STAMPS`` stamps.
        """
        stamps = np.concatenate([np.empty((0, 3), dtype=np.int64), *self._arrays])
        while len(stamps) > MAX_STAMPS:
            stamps = _least_delayed(stamps)
        return Stamps(stamps[:, 2], stamps[:, 1], stamps[:, 0], rate, speed, steady_host)

    def clock(self, speed: float = 1.0) -> DeviceClock | None:
        """Estimate the device's clock; None if the stamps do not determine it."""
        return estimate_device_clock(self.stamps(1.0, speed))


def _least_delayed(stamps: IntArray) -> IntArray:
    """The stamp with the smaller delay of each two consecutive ones."""
    pairs = stamps[: len(stamps) // 2 * 2].reshape(-1, 2, stamps.shape[1])
    delay = pairs[:, :, 0] - pairs[:, :, 1]
    best = pairs[np.arange(len(pairs)), np.argmin(delay, axis=1)]
    return np.concatenate([best, stamps[len(pairs) * 2 :]])


def estimate_device_clock(stamps: Stamps, fit: ClockFit | None = None) -> DeviceClock | None:
    """Estimate a device's clock from its stamps.

    Args:
        stamps: the stamps of one of its streams.
        fit: the clock fitted to them, if there is one already.

    Returns:
        The clock; None if the stamps do not determine it.
    """
    if len(stamps.seq) < 3:
        return None
    if fit is None:
        fit = fit_clock(
            stamps.t_hw_ns, stamps.t_acq_ns, int(stamps.t_acq_ns[0]), stamps.speed, steady=stamps.keeps_rate
        )
    if not fit.device_clock or fit.offset_error is None or fit.drift_error is None or fit.map is None:
        return None
    x = fit.map.elapsed(stamps.t_hw_ns)
    middle = int(np.argmin(np.abs(x - fit.map.middle)))
    host = float(fit.map.host(x[middle : middle + 1])[0])
    return DeviceClock(
        t_host_ns=fit.map.origin_ns + round(host * 1e9),
        t_device_ns=int(stamps.t_hw_ns[middle]),
        speed=stamps.speed,
        drift=fit.drift,
        drift_error=fit.drift_error,
        offset_error=fit.offset_error,
        jitter=fit.jitter,
        samples=len(stamps.seq),
        outliers=fit.outliers,
        stepped=float(sum(abs(step.size) for step in fit.steps)),
        spread=fit.spread,
    )


def pairwise_offsets(clocks: Mapping[str, DeviceClock]) -> dict[tuple[str, str], ClockOffset]:
    """Offsets between the clocks of each pair of devices of equal speed.

    Args:
        clocks: clocks by device.

    Returns:
        Offsets by (first, second) device; positive where the first is ahead.
    """
    offsets = {}
    for (first, a), (second, b) in combinations(clocks.items(), 2):
        if a.speed != b.speed:
            continue
        t_ns = (a.t_host_ns + b.t_host_ns) // 2
        offset = (a.device_ns(t_ns) - b.device_ns(t_ns)) * 1e-9
        error = hypot(a.error_at(t_ns), b.error_at(t_ns))
        bound = STANDARD_ERRORS * error + 0.5 * (a.spread + b.spread)
        offsets[first, second] = ClockOffset(offset, error, t_ns, bound)
    return offsets


def clocks_to_metadata(clocks: Mapping[str, DeviceClock]) -> dict[str, dict[str, str]]:
    """Metadata of a recording (tables of strings by name) with these clocks; none without clocks."""
    tables = {CLOCKS: {device: json.dumps(asdict(clock)) for device, clock in clocks.items()}}
    tables[OFFSETS] = {
        f"{first} - {second}": json.dumps(asdict(offset))
        for (first, second), offset in pairwise_offsets(clocks).items()
    }
    return {name: table for name, table in tables.items() if table}


def clocks_from_metadata(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, DeviceClock]:
    """Clocks by device in the metadata of a recording; entries that are not clocks are skipped."""
    clocks = {}
    for device, text in metadata.get(CLOCKS, {}).items():
        with contextlib.suppress(ValueError, TypeError, OverflowError):
            clock = DeviceClock(**parse_json(text))
            if all(type(value) in (int, float) and isfinite(value) for value in asdict(clock).values()):
                clocks[device] = clock
    return clocks
