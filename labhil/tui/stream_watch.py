"""One stream as a screen receives it: its newest samples, how regularly they come, what is missing."""

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
"""How far back a plot can look, s of the host's clock."""

STATISTICS_SPAN = 2.0
"""Rate and delays are those of the newest samples of so many s of the host's clock."""

SILENT_AFTER = 0.6
"""A stream that sends nothing for so long is marked as silent, s; slow streams after five periods."""

MOST_ROWS = 65536

UNDECODABLE = (ProtocolError, LookupError, AttributeError, TypeError, ValueError, ArithmeticError)
"""Errors in a malformed stream, which must not hide the others."""

MOST_PENDING = 256
"""Messages that wait until somebody looks; decoding them together costs little more than decoding one."""


@dataclass(frozen=True, slots=True)
class StreamHealth:
    """How regularly a stream comes in.

    ``rate`` is measured (samples per s of the host's clock), None while there are too few; ``age`` is s
    since the newest sample came; ``silent`` is whether that is too long. ``transit`` is from acquisition on
    the host to here, ``lateness`` by how much the slowest sample was later at the host than the quickest,
    by the device's clock; both s.
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
    """One stream as it comes in: a thread of the bus takes messages, and who looks at them decodes them."""

    stream: Stream
    speed: float
    metadata: Mapping[str, str]
    codec: Codec = field(init=False)
    received: int = 0
    gaps: int = 0
    last_seq: int | None = None
    arrived_at: float = 0.0
    fault: str = ""
    """What was wrong with a message that is no sample; empty where all are."""
    recent_transits: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=512))
    _ring: RingBuffer = field(init=False)
    _pending: list[bytes] = field(default_factory=list)
    _arrivals: list[tuple[int, float, int]] = field(default_factory=list)
    """How many messages waited after an arrival, and its times on the monotonic and the wall clock."""
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        self.codec = Codec(self.stream)
        rows = round(self.stream.rate * self.speed * HISTORY * 1.1)
        self._ring = RingBuffer(self.stream.width, min(max(rows, 1024), MOST_ROWS))

    @property
    def ahead_ns(self) -> int:
        """By how much the clock that stamps the samples is ahead of this machine's wall clock, ns.

        The wall clock may have been set since the session of the device began, its clock not.
        """
        offset = self.metadata.get(HOST_CLOCK)
        return 0 if offset is None else steady_ns() + int(offset) - time.time_ns()

    @property
    def ring(self) -> RingBuffer:
        """The newest samples, all that have come in."""
        self._decode_waiting()
        return self._ring

    def receive(self, payloads: list[bytes], now: float, now_ns: int) -> None:
        """Take messages in."""
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
        """Among these is one that is no message of the stream: take the others."""
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
        """How regularly it came in lately; times on the monotonic clock, s."""
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
    """The newest ``seconds`` of a signal: s before ``now_ns`` (n,), negative, and values (n, columns)."""
    t_acq, _, values = stream_watch.ring.newest(seconds)
    ago: FloatArray = (t_acq - (now_ns + stream_watch.ahead_ns)).astype(np.float64) * 1e-9
    return ago, values[:, stream_watch.stream.columns_of(signal)]
