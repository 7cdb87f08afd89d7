"""Recovery of a damaged recording: all complete messages in a new file, with a report of the losses.

``salvage.py`` reads the damaged file, ``reorder.py`` puts the messages in order.
"""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Metadata
from mcap.records import Message as StoredMessage
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from labhil.errors import RecordingError, RecordingFailedError
from labhil.recording.chunks import is_mcap, scan_mcap
from labhil.recording.memory_maps import FileBytes, bytes_of, sha256_of
from labhil.recording.message_store import Message
from labhil.recording.reorder import OrderedMessages, reorder
from labhil.recording.salvage import Loss, Salvage, salvage
from labhil.recording.stream_recovery import StreamRecovery, Tally, format_stream
from labhil.recording.writer import CHUNK_SIZE
from labhil.unreadable import RECORDING, beginning_of, reason_unreadable
from labhil.version import __version__

METADATA = "recover"
DRAFT_SUFFIX = ".saving"
"""Suffix of the new file until it is verified; ``.part`` is a recorder's."""

MAX_RECORD_SIZE = 1 << 32


@dataclass(frozen=True, slots=True)
class Recovery:
    """Result of a recovery.

    Attributes:
        source: the damaged file.
        sha256: its SHA-256.
        path: the new file.
        size: size of the damaged file, bytes.
        chunks: number of saved chunks.
        streams: channels.
        attachments: names of saved attachments.
        metadata: names of saved metadata.
        losses: damaged parts.
        nameless: number of messages without a description of their channel.
        doubtful: number of saved messages that may be damaged.
        ended: whether the damaged file has an end.
        copies: number of dropped exact copies of messages.
        moved: number of messages that were put in order.
        notes: lines about the order.
        spliced: whether channel numbers have several meanings, as in concatenated files.
    """

    source: Path
    sha256: str
    path: Path
    size: int
    chunks: int
    streams: tuple[StreamRecovery, ...]
    attachments: tuple[str, ...]
    metadata: tuple[str, ...]
    losses: tuple[Loss, ...]
    nameless: int
    doubtful: int
    ended: bool
    copies: int
    moved: int
    notes: tuple[str, ...]
    spliced: bool = False

    @property
    def bytes_lost(self) -> int:
        """Size of the damaged parts, bytes."""
        return sum(loss.end - loss.start for loss in self.losses)

    @property
    def saved(self) -> int:
        """Number of saved messages."""
        return sum(stream.saved for stream in self.streams)

    def lines(self) -> list[str]:
        """Describe the result for users, in lines of text."""
        n_lost_chunks = sum(loss.chunk for loss in self.losses)
        lines = [
            f"{self.source}: {self.size} bytes; saved {self.saved} messages of {self.chunks} whole chunks, "
            f"{len(self.attachments)} attachments, {len(self.metadata)} metadata records"
        ]
        lines += [
            f"lost: bytes {loss.start} to {loss.end} ({loss.end - loss.start}): {loss.what}"
            f"{_index_count(loss)}"
            for loss in self.losses
        ]
        if self.losses:
            lines.append(f"lost in total: {self.bytes_lost} bytes, {n_lost_chunks} damaged chunks")
        if not self.ended:
            lines.append("the file had no end (footer): its recorder was killed, or it is cut")
        if self.nameless:
            lines.append(f"lost: {self.nameless} messages of channels that nothing in the file describes")
        if self.spliced:
            lines.append(
                "the file is joined from several: it uses the number of a channel for different ones; "
                "each keeps its own messages"
            )
        if self.doubtful:
            lines.append(
                f"doubtful: {self.doubtful} messages come from chunks whose checksum is wrong; "
                "their values may be wrong"
            )
        if self.copies:
            lines.append(f"repaired: {self.copies} exact copies of messages were dropped")
        if self.moved:
            lines.append(f"repaired: {self.moved} messages were behind later ones, and were put in order")
        lines += self.notes
        lines += [line for stream in self.streams for line in format_stream(stream)]
        if not self.losses and self.ended:
            lines.append("nothing was lost")
        return lines

    def to_json(self) -> dict[str, Any]:
        """The result as ``labhil.recover/1``."""
        return {
            "schema": "labhil.recover/1",
            "source": str(self.source),
            "sha256": self.sha256,
            "path": str(self.path),
            "bytes": self.size,
            "bytes_lost": self.bytes_lost,
            "chunks_saved": self.chunks,
            "chunks_lost": sum(loss.chunk for loss in self.losses),
            "had_an_end": self.ended,
            "messages_saved": self.saved,
            "messages_without_channel": self.nameless,
            "messages_doubtful": self.doubtful,
            "messages_copied": self.copies,
            "messages_moved": self.moved,
            "notes": list(self.notes),
            "attachments": list(self.attachments),
            "metadata": list(self.metadata),
            "losses": [
                {
                    "start": loss.start,
                    "end": loss.end,
                    "what": loss.what,
                    "messages": sum(loss.messages.values()),
                }
                for loss in self.losses
            ],
            "streams": [
                {
                    "topic": stream.topic,
                    "saved": stream.saved,
                    "expected": stream.expected,
                    "start": stream.start,
                    "end": stream.end,
                    "missing": [[span.start, span.end, span.missing] for span in stream.spans],
                }
                for stream in self.streams
            ],
        }


def recover(source: Path, out: Path, *, keep_doubtful: bool = False) -> Recovery:
    """Save the complete messages, attachments and metadata of a damaged MCAP file in a new file.

    The metadata ``recover`` of the new file describe the losses. The new file is verified.

    Args:
        source: the damaged file.
        out: the new file.
        keep_doubtful: whether to keep messages of chunks with a wrong checksum, whose values may be wrong.

    Returns:
        What was saved and lost.

    Raises:
        RecordingError: The source cannot be read, is no MCAP file, or has no complete message; or ``out``
            exists.
        RecordingFailedError: ``out`` cannot be written, or cannot be read back.
    """
    data = _bytes_of(source)
    if out.exists():
        raise RecordingError(f"{out}: expected a new file, found one that exists; nothing was written")
    salvaged = salvage(data, keep_doubtful=keep_doubtful)
    if not is_mcap(data) and not salvaged.chunks:
        raise RecordingError(
            f"{source}: expected an MCAP recording, found a file that begins with {beginning_of(data[:8])} "
            "and holds no whole chunk of one; nothing was written"
        )
    messages: Sequence[Message] = salvaged.messages
    nameless = sum(number not in salvaged.channels for number in salvaged.messages.channels)
    if nameless:
        messages = [message for message in salvaged.messages if message.channel in salvaged.channels]
    if not messages:
        raise RecordingError(
            f"{source}: expected messages to save, found no complete one in {len(data)} bytes; "
            "nothing was written"
        )
    ordered = reorder(messages, salvaged.channels)
    result = _summarise(source, data, out, salvaged, ordered, nameless)
    _write(salvaged, ordered.messages, result, out)
    return result


def _bytes_of(source: Path) -> FileBytes:
    try:
        data = bytes_of(source)
    except OSError as error:
        reason = reason_unreadable(source, error, RECORDING)
        raise RecordingError(f"{source}: cannot be read: {reason}") from error
    if not data:
        raise RecordingError(f"{source}: expected an MCAP recording, found an empty file")
    return data


def _summarise(
    source: Path, data: FileBytes, out: Path, salvaged: Salvage, ordered: OrderedMessages, nameless: int
) -> Recovery:
    tallies: defaultdict[int, Tally] = defaultdict(Tally)
    for message in ordered.messages:
        tallies[message.channel].add(message)
    origin = min(tally.first for tally in tallies.values())
    # in concatenated files the statistics count by ambiguous numbers
    has_counts = salvaged.statistics is not None and not salvaged.spliced
    counts = salvaged.statistics.channel_message_counts if salvaged.statistics and has_counts else {}
    if any(tally.count > counts.get(number, 0) for number, tally in tallies.items()):
        counts = {}  # statistics of a part of the file
    indexed: Counter[int] = Counter()
    for loss in salvaged.losses:
        indexed.update(loss.messages)
    streams = []
    for number, channel in salvaged.channels.items():
        expected = counts.get(number, 0) - ordered.copies.get(number, 0) if counts else None
        streams.append(tallies[number].recovery(channel.topic, expected, indexed[number], origin))
    return Recovery(
        source=source,
        sha256=sha256_of(data),
        path=out,
        size=len(data),
        chunks=salvaged.chunks,
        streams=tuple(streams),
        attachments=tuple(attachment.name for attachment in salvaged.attachments),
        metadata=tuple(metadata.name for metadata in salvaged.metadata),
        losses=tuple(salvaged.losses),
        nameless=nameless,
        doubtful=salvaged.doubtful,
        spliced=salvaged.spliced,
        ended=salvaged.ended,
        copies=sum(ordered.copies.values()),
        moved=ordered.moved,
        notes=ordered.notes,
    )


def _index_count(loss: Loss) -> str:
    count = sum(loss.messages.values())
    return f"; its index names {count} messages" if count else ""


def _write(salvaged: Salvage, messages: Sequence[Message], result: Recovery, out: Path) -> None:
    """Write a draft beside ``out``, verify it, and then give it its name."""
    part = out.with_name(f"{out.name}{DRAFT_SUFFIX}")
    try:
        with part.open("xb") as file:
            _write_records(
                Writer(file, chunk_size=CHUNK_SIZE, compression=CompressionType.LZ4),
                salvaged,
                messages,
                result,
            )
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError as error:
        raise RecordingError(
            f"{part}: expected no file of this name, found one; move it away first"
        ) from error
    except OSError as error:
        part.unlink(missing_ok=True)
        raise RecordingFailedError(f"{out}: could not be written: {error}") from error
    try:
        _verify(part, salvaged, messages)
        os.link(part, out)  # unlike a rename, it does not replace a file that exists meanwhile
    except FileExistsError as error:
        raise RecordingError(f"{out}: expected a new file, found one that exists") from error
    except OSError as error:
        raise RecordingFailedError(f"{out}: could not be written: {error}") from error
    finally:
        part.unlink(missing_ok=True)


def _write_records(writer: Writer, salvaged: Salvage, messages: Sequence[Message], result: Recovery) -> None:
    writer.start(profile=salvaged.profile, library=f"labhil {__version__}")
    schemas = {0: 0}
    numbers: dict[int, int] = {}
    for number, channel in salvaged.channels.items():
        schema = salvaged.schemas.get(channel.schema_id)
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        numbers[number] = writer.register_channel(
            channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0), channel.metadata
        )
    for attachment in salvaged.attachments:
        writer.add_attachment(
            attachment.create_time,
            attachment.log_time,
            attachment.name,
            attachment.media_type,
            attachment.data,
        )
    for metadata in salvaged.metadata:
        writer.add_metadata(metadata.name, metadata.metadata)
    record = {
        "source": result.source.name,
        "sha256": result.sha256,
        "lost": "\n".join(result.lines()[1:]),
        "bytes_lost": str(result.bytes_lost),
        "messages_doubtful": str(result.doubtful),
    }
    writer.add_metadata(METADATA, record)
    for message in messages:
        writer.add_message(
            numbers[message.channel], message.log_time, message.data, message.publish_time, message.sequence
        )
    writer.finish()


def _verify(path: Path, salvaged: Salvage, messages: Sequence[Message]) -> None:
    """Read the new file with mcap's readers; RecordingFailedError unless everything is there."""
    topics: dict[int, str] = {}
    attachments: list[Attachment] = []
    metadata: list[Metadata] = []
    compared = 0
    try:
        with path.open("rb") as file:
            for stored in StreamReader(file, validate_crcs=True, record_size_limit=MAX_RECORD_SIZE).records:
                if isinstance(stored, Channel):
                    topics[stored.id] = stored.topic
                elif isinstance(stored, StoredMessage):
                    _check_message(path, stored, messages[compared], topics, salvaged.channels)
                    compared += 1
                elif isinstance(stored, Attachment):
                    attachments.append(stored)
                elif isinstance(stored, Metadata):
                    metadata.append(stored)
            file.seek(0)
            summary = make_reader(file).get_summary()
    except Exception as error:
        if isinstance(error, RecordingFailedError):
            raise
        raise RecordingFailedError(f"{path}: what was written cannot be read back: {error!r}") from error
    statistics = None if summary is None else summary.statistics
    counted = 0 if statistics is None else statistics.message_count
    rest_matches = (attachments, metadata[:-1]) == (salvaged.attachments, salvaged.metadata)
    if (compared, counted) != (len(messages), len(messages)) or not rest_matches or _find_damage(path):
        raise RecordingFailedError(
            f"{path}: expected {len(messages)} messages, the attachments and the metadata back, found "
            f"{compared} messages ({counted} by its own statistics), {len(attachments)} attachments and "
            f"{len(metadata)} metadata records"
        )


def _find_damage(path: Path) -> str:
    """Damage that ``chunks.py`` finds in a file."""
    return scan_mcap(bytes_of(path), lambda _channel, messages: messages.clear()).damage


def _check_message(
    path: Path,
    read: StoredMessage,
    written: Message,
    topics: Mapping[int, str],
    channels: Mapping[int, Channel],
) -> None:
    is_equal = (
        topics[read.channel_id] == channels[written.channel].topic
        and (read.log_time, read.publish_time) == (written.log_time, written.publish_time)
        and read.sequence == written.sequence
        and read.data == written.data
    )
    if not is_equal:
        raise RecordingFailedError(f"{path}: a message that was read back is not the one that was written")
