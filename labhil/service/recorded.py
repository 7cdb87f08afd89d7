"""One stream in the recorder: its waiting samples, its gaps, the clock of its device; and the summaries."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from labhil.bus.incoming import excerpt
from labhil.codec import stamps_of
from labhil.errors import ProtocolError
from labhil.recording.clock import fit_clock
from labhil.recording.clock_faults import ClockFault, find_clock_faults
from labhil.recording.device_clocks import DeviceClock, StampCollector
from labhil.recording.stamps import HOST_CLOCK
from labhil.signals import Direction, Stream


@dataclass(frozen=True, slots=True)
class StreamSummary:
    """What was recorded of one stream; ``gaps`` counts lost samples, ``rate`` is measured, Hz."""

    device: str
    stream: str
    samples: int
    gaps: int
    rate: float


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """What was recorded.

    Attributes:
        path: The recording.
        duration: From the first sample to the last, s of the host's clock.
        streams: What was recorded of each stream.
        warnings: Faults of the stamps of the devices' clocks and lost samples, a sentence each; known only
            at the end.
    """

    path: Path
    duration: float
    streams: tuple[StreamSummary, ...]
    warnings: tuple[str, ...] = ()


@dataclass(slots=True)
class RecordedStream:
    """One stream while it is recorded; ``number`` is None until its schema is known and it can be written."""

    device: str
    stream: str
    number: int | None = None
    waiting: list[bytes] = field(default_factory=list)
    size: int = 0
    """Bytes that wait for their schema."""
    asked_at: float = float("-inf")
    fault: str = ""
    samples: int = 0
    gaps: int = 0
    refused: int = 0
    missing_at_end: int = 0
    """Samples that its publisher published after the last one that came."""
    end_unknown: bool = False
    """Whether its publisher is gone without stating how many samples it published."""
    first_ns: int = 0
    last_ns: int = 0
    first_seq: int = 0
    last_seq: int = 0
    speed: float = 1.0
    rate: float = 0.0
    steady_host: bool = False
    second: int = 1
    """Samples in one second of the host's clock."""
    clock: StampCollector | None = None
    """Where the device's own clock stamps the samples."""

    def apply_schema(self, stream: Stream, metadata: Mapping[str, str]) -> None:
        """Take over the rate and the clock that its publisher declares.

        Raises:
            ProtocolError: The speed is not a positive number.
        """
        speed = float(metadata.get("speed", "1"))
        if not 0 < speed < float("inf"):
            raise ProtocolError(f"speed: expected a positive number, found {excerpt(metadata['speed'])}")
        self.speed = speed
        self.rate, self.steady_host = stream.rate, HOST_CLOCK in metadata
        self.second = max(1, round(stream.rate * speed))
        if any(signal.direction is not Direction.REQUESTED for signal in stream.signals):
            self.clock = StampCollector()

    def count(self, payloads: list[bytes]) -> None:
        """Count stored samples and the gaps between their numbers."""
        stamps = stamps_of(payloads)
        if self.clock is not None:
            self.clock.add(stamps[:, 1], stamps[:, 2], stamps[:, 0])
        seq = stamps[:, 0].tolist()
        if self.samples == 0:
            self.first_seq, self.first_ns, self.last_seq = seq[0], int(stamps[0, 1]), seq[0] - 1
        for number in seq:
            self.gaps += max(0, number - self.last_seq - 1)
            self.last_seq = number
        self.samples += len(payloads)
        self.last_ns = int(stamps[-1, 1])

    def note_last_seq(self, last_seq: int) -> None:
        """Count the samples that are missing up to ``last_seq``, the last one that was published."""
        self.missing_at_end = max(0, last_seq - self.last_seq) if self.samples else 0
        self.gaps += self.missing_at_end

    def clock_faults(self) -> tuple[ClockFault, ...]:
        """Return the faults of the stamps of its device's clock."""
        if self.clock is None:
            return ()
        stamps = self.clock.stamps(self.rate, self.speed, steady_host=self.steady_host)
        if len(stamps.seq) < 3:
            return ()
        fit = fit_clock(
            stamps.t_hw_ns, stamps.t_acq_ns, int(stamps.t_acq_ns[0]), self.speed, stamps.keeps_rate
        )
        return find_clock_faults(stamps, fit, fit.t - fit.t[0])

    def status(self, now_ns: int) -> dict[str, float | None]:
        """Return the counts of the stream, and the age of its last sample in s, at Unix time ``now_ns``."""
        return {
            "received": self.samples,
            "gaps": self.gaps,
            "refused": self.refused,
            "waiting": len(self.waiting),
            "lag": (now_ns - self.last_ns) * 1e-9 if self.samples else None,
        }

    def summary(self) -> StreamSummary:
        """Return the summary of the stream."""
        seconds = (self.last_ns - self.first_ns) * 1e-9
        rate = (self.last_seq - self.first_seq) / seconds if seconds > 0 else 0.0
        return StreamSummary(self.device, self.stream, self.samples, self.gaps, rate)


def device_clocks(streams: Iterable[RecordedStream]) -> dict[str, DeviceClock]:
    """Estimate the clock of each device, from its first stream that has one."""
    clocks: dict[str, DeviceClock] = {}
    for stream in streams:
        clock = stream.clock.clock(stream.speed) if stream.clock is not None else None
        if clock is not None:
            clocks.setdefault(stream.device, clock)
    return clocks
