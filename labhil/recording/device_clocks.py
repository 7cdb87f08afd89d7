"""What a recording says of its devices' clocks: each against the host's, and against one another.

Written when a recording ends, from the stamps of all its samples. A constant latency between a device and
the stamp of the host cannot be told from an offset of its clock: it is left in, and two devices on wires of
the same kind share it.
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
from labhil.recording.clock import fit_clock
from labhil.signals import IntArray

CLOCKS = "clocks"
OFFSETS = "clock_offsets"
"""Names of the metadata that hold them: one entry a device, and one a pair; JSON each."""

LARGEST = 16384
"""As many stamps are kept; when there are more, every other one is let go of."""


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """One device's clock against the host's: it showed ``t_device_ns`` at Unix time ``t_host_ns``.

    ``drift`` is its relative error (50e-6: 50 ppm fast), ``speed`` how many seconds of its world pass in one
    of the host. ``offset_error`` (s) and ``drift_error`` are standard errors, at that moment; ``jitter`` (s)
    is the robust standard deviation of the host's stamps. Of ``samples`` looked at, ``outliers`` were thrown
    out.
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

    def device_ns(self, t_host_ns: int) -> int:
        """Return what the device's clock shows at Unix time ``t_host_ns``."""
        elapsed = (t_host_ns - self.t_host_ns) * self.speed
        return self.t_device_ns + round(elapsed) + round(elapsed * self.drift)

    def error_at(self, t_host_ns: int) -> float:
        """Return the standard error of that, s of the device's world; it grows away from the middle."""
        return hypot(self.offset_error, (t_host_ns - self.t_host_ns) * 1e-9 * self.speed * self.drift_error)


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """By how much (s) one device's clock was ahead of another's at ``t_host_ns``; ``error`` is 1 σ."""

    offset: float
    error: float
    t_host_ns: int


class ClockWatch:
    """Collects the stamps of one device in bounded memory."""

    def __init__(self) -> None:
        self._kept: list[IntArray] = []
        self._count = 0
        self._every = 1
        self._seen = 0

    def add(self, t_acq_ns: IntArray, t_hw_ns: IntArray) -> None:
        """Take in stamps, oldest first, both (n,)."""
        first = -self._seen % self._every
        self._seen += len(t_acq_ns)
        stamps = np.column_stack([t_acq_ns, t_hw_ns])[first :: self._every]
        self._kept.append(stamps)
        self._count += len(stamps)
        while self._count > LARGEST:
            thinned = np.concatenate(self._kept)[::2]
            self._kept, self._count = [thinned], len(thinned)
            self._every *= 2

    def clock(self, speed: float = 1.0) -> DeviceClock | None:
        """Return the clock, or None where the stamps do not tell one."""
        if self._count < 3:
            return None
        stamps = np.concatenate(self._kept)
        origin = int(stamps[0, 0])
        fit = fit_clock(stamps[:, 1], stamps[:, 0], origin, speed)
        if not fit.device_clock or fit.offset_error is None or fit.drift_error is None:
            return None
        middle = len(stamps) // 2
        t_host_ns = origin + round(float(fit.t[middle]) / speed * 1e9)
        t_device_ns = int(stamps[middle, 1])
        return DeviceClock(
            t_host_ns,
            t_device_ns,
            speed,
            fit.drift,
            fit.drift_error,
            fit.offset_error,
            fit.jitter,
            len(stamps),
            fit.outliers,
        )


def offsets_between(clocks: Mapping[str, DeviceClock]) -> dict[tuple[str, str], ClockOffset]:
    """Return by how much each device's clock is ahead of each later one's of the same speed."""
    offsets = {}
    for (first, a), (second, b) in combinations(clocks.items(), 2):
        if a.speed != b.speed:
            continue
        at = (a.t_host_ns + b.t_host_ns) // 2
        offset = (a.device_ns(at) - b.device_ns(at)) * 1e-9
        offsets[first, second] = ClockOffset(offset, hypot(a.error_at(at), b.error_at(at)), at)
    return offsets


def clocks_to_metadata(clocks: Mapping[str, DeviceClock]) -> dict[str, dict[str, str]]:
    """Return the tables of strings that a recording holds; none without clocks."""
    tables = {CLOCKS: {device: json.dumps(asdict(clock)) for device, clock in clocks.items()}}
    tables[OFFSETS] = {
        f"{first} - {second}": json.dumps(asdict(offset))
        for (first, second), offset in offsets_between(clocks).items()
    }
    return {name: table for name, table in tables.items() if table}


def clocks_from_metadata(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, DeviceClock]:
    """Read what :func:`clocks_to_metadata` wrote; what is not like that is left out."""
    clocks = {}
    for device, text in metadata.get(CLOCKS, {}).items():
        with contextlib.suppress(ValueError, TypeError, OverflowError):
            clock = DeviceClock(**parse_json(text))
            if all(type(value) in (int, float) and isfinite(value) for value in asdict(clock).values()):
                clocks[device] = clock
    return clocks
