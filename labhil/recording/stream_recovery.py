"""Saved and lost messages of each channel of a damaged file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from labhil.recording.message_store import Message
from labhil.terminal import printable_name

MAX_SPANS = 5
"""Number of gaps of a channel that are reported, the longest ones."""

SEQUENCE_PERIOD = 1 << 32


@dataclass(frozen=True, slots=True)
class Span:
    """A gap with ``missing`` messages; times in s from the first saved message of the file."""

    start: float
    end: float
    missing: int


@dataclass(frozen=True, slots=True)
class StreamRecovery:
    """Saved and lost messages of a channel.

    Attributes:
        topic: its topic.
        saved: number of saved messages.
        expected: number of messages by the statistics of the file; None without these.
        indexed: number of messages in damaged chunks, by their index.
        start: time of the first message, s.
        end: time of the last message, s.
        spans: gaps in the sequence numbers.
    """

    topic: str
    saved: int
    expected: int | None
    indexed: int
    start: float
    end: float
    spans: tuple[Span, ...]


@dataclass(slots=True)
class Tally:
    """Counter of the messages of a channel and of the gaps between them."""

    count: int = 0
    first: int = 0
    last: int = 0
    before: Message | None = None
    gaps: list[tuple[int, int, int]] = field(default_factory=list)

    def add(self, message: Message) -> None:
        """Count the next message of the channel."""
        self.first = min(self.first, message.log_time) if self.count else message.log_time
        self.last = max(self.last, message.log_time)
        self.count += 1
        if self.before is not None:
            missing = (message.sequence - self.before.sequence) % SEQUENCE_PERIOD - 1
            if 0 < missing < SEQUENCE_PERIOD // 2 and message.log_time > self.before.log_time:
                self.gaps.append((self.before.log_time, message.log_time, missing))
        self.before = message

    def recovery(self, topic: str, expected: int | None, indexed: int, origin: int) -> StreamRecovery:
        """Result for the channel.

        Args:
            topic: its topic.
            expected: number of messages by the statistics of the file; None without these.
            indexed: number of messages in damaged chunks, by their index.
            origin: Unix time from which times are measured, ns.
        """
        start, end = (self.first - origin, self.last - origin) if self.count else (0, 0)
        spans = tuple(Span((a - origin) * 1e-9, (b - origin) * 1e-9, missing) for a, b, missing in self.gaps)
        return StreamRecovery(topic, self.count, expected, indexed, start * 1e-9, end * 1e-9, spans)


def format_stream(stream: StreamRecovery) -> Iterator[str]:
    """Yield lines for users about a channel."""
    line = f"{printable_name(stream.topic)}: {stream.saved} messages saved"
    if stream.saved:
        line += f", {stream.start:.3f} to {stream.end:.3f} s"
    if stream.expected is not None and stream.expected != stream.saved:
        line += f"; {stream.expected - stream.saved} of {stream.expected} lost"
    elif stream.indexed:
        line += f"; {stream.indexed} lost with damaged chunks"
    yield line
    longest = sorted(stream.spans, key=lambda span: span.missing, reverse=True)
    for span in sorted(longest[:MAX_SPANS], key=lambda span: span.start):
        yield f"  {span.missing} missing between {span.start:.3f} and {span.end:.3f} s"
    if len(longest) > MAX_SPANS:
        rest = sum(span.missing for span in longest[MAX_SPANS:])
        yield f"  {rest} more missing in {len(longest) - MAX_SPANS} shorter gaps"
