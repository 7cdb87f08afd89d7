"""What became of each channel of a broken file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from labhil.recording.message_store import Message
from labhil.terminal import printable_name

MOST_SPANS = 5
"""Spans of lost samples that are reported of one stream, the longest first."""

SEQUENCE_WRAPS = 1 << 32


@dataclass(frozen=True, slots=True)
class Span:
    """``missing`` numbers are not there between two messages; times in s from the first message saved."""

    start: float
    end: float
    missing: int


@dataclass(frozen=True, slots=True)
class StreamRecovery:
    """What became of one channel.

    ``expected`` is how many messages the broken file says it held, None where it does not say;
    ``indexed`` how many were in damaged chunks, by their index; ``spans`` where numbers are missing.
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
    """What is known of the messages of one channel, one after another."""

    count: int = 0
    first: int = 0
    last: int = 0
    before: Message | None = None
    gaps: list[tuple[int, int, int]] = field(default_factory=list)

    def take(self, message: Message) -> None:
        """Count the next message of the channel."""
        self.first = min(self.first, message.log_time) if self.count else message.log_time
        self.last = max(self.last, message.log_time)
        self.count += 1
        if self.before is not None:
            missing = (message.sequence - self.before.sequence) % SEQUENCE_WRAPS - 1
            if 0 < missing < SEQUENCE_WRAPS // 2 and message.log_time > self.before.log_time:
                self.gaps.append((self.before.log_time, message.log_time, missing))
        self.before = message

    def recovery(self, topic: str, expected: int | None, indexed: int, origin: int) -> StreamRecovery:
        """What became of the channel; ``origin`` (ns) is the first message of all, times are s from it."""
        start, end = (self.first - origin, self.last - origin) if self.count else (0, 0)
        spans = tuple(Span((a - origin) * 1e-9, (b - origin) * 1e-9, missing) for a, b, missing in self.gaps)
        return StreamRecovery(topic, self.count, expected, indexed, start * 1e-9, end * 1e-9, spans)


def format_stream(stream: StreamRecovery) -> Iterator[str]:
    """Yield what a person wants to know of a channel, a line each."""
    line = f"{printable_name(stream.topic)}: {stream.saved} messages saved"
    if stream.saved:
        line += f", {stream.start:.3f} to {stream.end:.3f} s"
    if stream.expected is not None and stream.expected != stream.saved:
        line += f"; {stream.expected - stream.saved} of {stream.expected} lost"
    elif stream.indexed:
        line += f"; {stream.indexed} lost with damaged chunks"
    yield line
    longest = sorted(stream.spans, key=lambda span: span.missing, reverse=True)
    for span in sorted(longest[:MOST_SPANS], key=lambda span: span.start):
        yield f"  {span.missing} missing between {span.start:.3f} and {span.end:.3f} s"
    if len(longest) > MOST_SPANS:
        rest = sum(span.missing for span in longest[MOST_SPANS:])
        yield f"  {rest} more missing in {len(longest) - MOST_SPANS} shorter gaps"
