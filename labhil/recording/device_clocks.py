"""What a recording says of its devices' clocks: each against the host's, and against one another.

Written when a recording ends, from the stamps of all its samples. A constant latency between a device and
the stamp of the host looks like an offset of its clock: it is left in, and two devices on wires of the same
kind share it.
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
"""Names of the metadata that hold them: one entry a device, and one a pair; JSON each."""

LARGEST = 16384
"""As many stamps are looked at; of more, those that came in with the least delay."""


SURE = 2.0
"""Standard errors within which something lies, but for one time in twenty."""

MOST_PIECES = 512
"""Pieces that stamps stand in before they are put together."""


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """One device's clock against the host's: it showed ``t_device_ns`` at Unix time ``t_host_ns``.

    ``drift`` is its relative error (50e-6: 50 ppm fast), ``speed`` how many seconds of its world pass in one
    of the host. ``offset_error`` (s) and ``drift_error`` are standard errors, at that moment; ``jitter`` (s)
    is the robust standard deviation of the stamps' delays. Of ``samples`` looked at, ``outliers`` came far
    later than usual. ``stepped`` (s of the host) is by how much the stamps jump in all, either way: 0 for a
    sound map. ``spread`` (s) is by how much the middle one of the stamps is later than the earliest.
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
        """Return what the device's clock shows at Unix time ``t_host_ns``."""
        elapsed = (t_host_ns - self.t_host_ns) * self.speed
        return self.t_device_ns + round(elapsed) + round(elapsed * self.drift)

    def error_at(self, t_host_ns: int) -> float:
        """Return the standard error of that, s of the device's world; it grows away from the middle.

        Where the stamps jump, it is not known on which side the host's clock was right: all of it counts.
        """
        away = (t_host_ns - self.t_host_ns) * 1e-9 * self.speed * self.drift_error
        return hypot(self.offset_error, away, self.stepped * self.speed)

    def bound_at(self, t_host_ns: int) -> float:
        """Return a bound of that error, s of the device's world.

        Stamps that only ever come late do not show what all of them share: the least delay. As Cristian's
        bound is half of the round trip, so half of the delay that is seen to vary is taken for what is not
        seen, beside two standard errors. A latency that never varies is not in it.
        """
        return SURE * self.error_at(t_host_ns) + 0.5 * self.spread


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """By how much (s) one device's clock was ahead of another's at ``t_host_ns``.

    ``error`` is 1 σ of what the stamps scatter; ``bound`` holds what they cannot show, too
    (:meth:`DeviceClock.bound_at` of both): the true offset lies within it.
    """

    offset: float
    error: float
    t_host_ns: int
    bound: float = 0.0


class ClockWatch:
    """Collects the stamps of one device in bounded memory."""

    def __init__(self) -> None:
        self._pieces: list[IntArray] = []
        self._count = 0
        self._next = 0

    def add(self, t_acq_ns: IntArray, t_hw_ns: IntArray, seq: IntArray | None = None) -> None:
        """Take in stamps, oldest first, all (n,); without ``seq`` no sample is missing between them."""
        if seq is None:
            seq = np.arange(len(t_acq_ns), dtype=np.int64) + self._next
        if not len(seq):
            return
        self._next = int(seq[-1]) + 1
        self._pieces.append(np.column_stack([t_acq_ns, t_hw_ns, seq]))
        self._count += len(seq)
        if len(self._pieces) > MOST_PIECES:  # an array of one sample takes ten times what is in it
            self._pieces = [np.concatenate(self._pieces)]
        while self._count > LARGEST * 2:
            thinned = _least_delayed(np.concatenate(self._pieces))
            self._pieces, self._count = [thinned], len(thinned)

    def stamps(self, rate: float, speed: float = 1.0, *, steady_host: bool = False) -> Stamps:
        """Return what was kept; ``rate`` (Hz) is the declared one."""
        stamps = np.concatenate([np.empty((0, 3), dtype=np.int64), *self._pieces])
        while len(stamps) > LARGEST:
            stamps = _least_delayed(stamps)
        return Stamps(stamps[:, 2], stamps[:, 1], stamps[:, 0], rate, speed, steady_host)

    def clock(self, speed: float = 1.0) -> DeviceClock | None:
        """Return the clock, or None where the stamps do not tell one."""
        return device_clock(self.stamps(1.0, speed))


def _least_delayed(stamps: IntArray) -> IntArray:
    """Of each two stamps that follow one another, the one that came sooner: that one tells of the clocks."""
    pairs = stamps[: len(stamps) // 2 * 2].reshape(-1, 2, stamps.shape[1])
    delay = pairs[:, :, 0] - pairs[:, :, 1]
    best = pairs[np.arange(len(pairs)), np.argmin(delay, axis=1)]
    return np.concatenate([best, stamps[len(pairs) * 2 :]])


def device_clock(stamps: Stamps, fit: ClockFit | None = None) -> DeviceClock | None:
    """Return a device's clock as its stamps tell it, None where they do not; ``fit`` if it is there
    already."""
    if len(stamps.seq) < 3:
        return None
    if fit is None:
        fit = fit_clock(
            stamps.t_hw_ns, stamps.t_acq_ns, int(stamps.t_acq_ns[0]), stamps.speed, steady=stamps.keep_rate
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


def offsets_between(clocks: Mapping[str, DeviceClock]) -> dict[tuple[str, str], ClockOffset]:
    """Return by how much each device's clock is ahead of each later one's of the same speed."""
    offsets = {}
    for (first, a), (second, b) in combinations(clocks.items(), 2):
        if a.speed != b.speed:
            continue
        at = (a.t_host_ns + b.t_host_ns) // 2
        offset = (a.device_ns(at) - b.device_ns(at)) * 1e-9
        error = hypot(a.error_at(at), b.error_at(at))
        bound = SURE * error + 0.5 * (a.spread + b.spread)
        offsets[first, second] = ClockOffset(offset, error, at, bound)
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
