"""One stream as it comes in: its newest samples, their regularity, and what is missing."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from labhil.codec import Codec
from labhil.errors import ProtocolError
from labhil.host_clock import steady_ns
from labhil.recording.stamps import HOST_CLOCK
from labhil.signals import Batch, FloatArray, Stream
from labhil.tui.ring_buffer import RingBuffer

HISTORY = 60.0
"""Length of the stored past, s of the host's clock."""

STATISTICS_SPAN = 2.0
"""Length of the past from which rate and delays are measured, s of the host's clock."""

SILENT_AFTER = 0.6
"""Time without samples after which a stream is silent, s; for slow streams it is five periods."""

MOST_ROWS = 65536

UNDECODABLE = (ProtocolError, LookupError, AttributeError, TypeError, ValueError, ArithmeticError)
"""Errors that a malformed stream raises; they must not hide the other streams."""

MOST_PENDING = 256
"""Messages that wait for a reader; decoding them together costs little more than decoding one."""


@dataclass(frozen=True, slots=True)
class StreamHealth:
    """Hold the regularity of a stream.

    Attributes:
        rate: Measured, samples per s of the host's clock; None while there are too few.
        age: Time since the newest sample came, s.
        silent: Whether that is too long.
        gaps: Number of samples that are missing.
        received: Number of samples.
        transit: Median time from acquisition on the host to here, s.
        lateness: Largest difference of the delays from device to host, s.
    """

    rate: float | None
    age: float
    silent: bool
    gaps: int
    received: int
    transit: float | None
    lateness: float | None


@dataclass(slots=True)
class StreamWatch:
    """Collect one stream: a thread of the bus receives messages, and whoever reads them decodes them."""

    stream: Stream
    speed: float
    metadata: Mapping[str, str]
    codec: Codec = field(init=False)
    received: int = 0
    gaps: int = 0
    last_seq: int | None = None
    arrived_at: float = 0.0
    fault: str = ""
    """Error in a malformed message; empty where there is none."""
    recent_transits: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=512))
    _ring: RingBuffer = field(init=False)
    _pending: list[bytes] = field(default_factory=list)
    _arrivals: list[tuple[int, float, int]] = field(default_factory=list)
    """Number of pending messages after an arrival, and its times on the monotonic and the wall clock."""
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        self.codec = Codec(self.stream)
        rows = round(self.stream.rate * self.speed * HISTORY * 1.1)
        self._ring = RingBuffer(self.stream.width, min(max(rows, 1024), MOST_ROWS))

    @property
    def ahead_ns(self) -> int:
        """How far the clock of the time stamps is ahead of this machine's wall clock, ns.

        The wall clock may have been set since the session of the device began.
        """
        offset = self.metadata.get(HOST_CLOCK)
        return 0 if offset is None else steady_ns() + int(offset) - time.time_ns()

    @property
    def ring(self) -> RingBuffer:
        """The newest samples, with all that have come in."""
        self._decode_waiting()
        return self._ring

    def receive(self, payloads: list[bytes], now: float, now_ns: int) -> None:
        """Queue messages for decoding.

        Args:
            payloads: The messages.
            now: Monotonic time, s.
            now_ns: Unix time, ns.
        """
        with self._lock:
            self._pending += payloads
            self._arrivals.append((len(self._pending), now, now_ns))
            self.arrived_at = now
            is_full = len(self._pending) >= MOST_PENDING
        if is_full:
            self._decode_waiting()

    def _decode_waiting(self) -> None:
        with self._lock:
            payloads, arrivals = self._pending, self._arrivals
            self._pending, self._arrivals = [], []
            if not payloads:
                return
            try:
                self._append(self.codec.decode(payloads), arrivals)
            except UNDECODABLE as error:
                self.fault = str(error)
                self._append_one_by_one(payloads, arrivals)

    def _append_one_by_one(self, payloads: list[bytes], arrivals: list[tuple[int, float, int]]) -> None:
        """Append the valid messages where one of them is malformed."""
        _, now, now_ns = arrivals[-1]
        for payload in payloads:
            with suppress(*UNDECODABLE):
                self._append(self.codec.decode([payload]), [(1, now, now_ns)])

    def _append(self, batch: Batch, arrivals: list[tuple[int, float, int]]) -> None:
        seq = batch.seq
        previous = self.last_seq if self.last_seq is not None else int(seq[0]) - 1
        self.gaps += int(np.maximum(np.diff(seq, prepend=previous) - 1, 0).sum())
        self.last_seq = int(seq[-1])
        self.received += len(batch)
        for count, now, now_ns in arrivals:
            self.recent_transits.append(
                (now, (now_ns + self.ahead_ns - int(batch.t_acq_ns[count - 1])) * 1e-9)
            )
        self._ring.append(batch)

    def health(self, now: float) -> StreamHealth:
        """Return the regularity of the last 2 s; ``now`` is monotonic time, s."""
        age = now - self.arrived_at
        silent = age > max(SILENT_AFTER, 5.0 / (self.stream.rate * self.speed))
        t_acq, t_hw, _ = self.ring.newest(STATISTICS_SPAN)
        rate = lateness = None
        if len(t_acq) > 2 and t_acq[-1] > t_acq[0] and not silent:
            rate = (len(t_acq) - 1) / ((t_acq[-1] - t_acq[0]) * 1e-9)
            delays = (t_acq - t_acq[0]) - (t_hw - t_hw[0]) / self.speed
            lateness = float(delays.max() - delays.min()) * 1e-9
        recent = [transit for at, transit in self.recent_transits.copy() if now - at < STATISTICS_SPAN]
        transit = float(np.median(recent)) if recent and not silent else None
        return StreamHealth(rate, age, silent, self.gaps, self.received, transit, lateness)


def trace(
    stream_watch: StreamWatch, signal: str, seconds: float, now_ns: int
) -> tuple[FloatArray, FloatArray]:
    """Return the newest samples of a signal.

    Args:
        stream_watch: Its stream.
        signal: Name of the signal.
        seconds: How far back, s.
        now_ns: Unix time, ns.

    Returns:
        Times (n,), s before now and negative, and values (n, columns).
    """
    t_acq, _, values = stream_watch.ring.newest(seconds)
    ago: FloatArray = (t_acq - (now_ns + stream_watch.ahead_ns)).astype(np.float64) * 1e-9
    return ago, values[:, stream_watch.stream.columns_of(signal)]
