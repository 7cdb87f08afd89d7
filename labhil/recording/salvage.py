"""Salvage of the complete records of a damaged MCAP file.

Records are read one after another. After an incomplete one the next complete one is searched byte by byte. A
chunk counts if its checksum is right, or is itself the only damage. Of a truncated chunk the messages before
the cut count. ``recover.py`` writes the result.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from labhil.bounds import FREE, LARGEST_CHUNK, RATIO, Budget, ImplausibleError
from labhil.recording.chunks import is_mcap
from labhil.recording.compression import decompress, decompress_prefix
from labhil.recording.definitions import Definitions
from labhil.recording.memory_maps import RELEASE_INTERVAL, FileBytes, release_pages
from labhil.recording.message_store import Message, MessageStore
from labhil.recording.record_bounds import (
    CHUNK,
    COMPRESSIONS,
    INDEX,
    INDEX_ENTRY,
    MESSAGE,
    RECORD,
    ChunkHeader,
    checksum_matches,
    find_next_record,
    is_end,
    parse_chunk_header,
    record_end,
)

_DESCRIPTIONS: dict[int, Any] = {Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read}

PART_LOST = "a part of a chunk: a record in it is damaged, or it holds more than a file of this size may"
_CHUNK_CONTENT = {Opcode.MESSAGE, *_DESCRIPTIONS}
"""Records in chunks."""

BEFORE_INDEX = {Opcode.CHUNK, Opcode.MESSAGE_INDEX}
"""Records before an index of messages, which looks like a message after an error of one bit."""

INDEXES = {
    Opcode.MESSAGE_INDEX,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
    Opcode.STATISTICS,
    Opcode.SUMMARY_OFFSET,
}


@dataclass(slots=True)
class Loss:
    """A damaged part of the file.

    Attributes:
        start: its first byte.
        end: its end.
        what: what is damaged, for messages.
        chunk: whether it is a chunk.
        messages: number of its messages by channel, from its index.
    """

    start: int
    end: int
    what: str
    chunk: bool = False
    messages: dict[int, int] = field(default_factory=dict)


@dataclass(slots=True)
class Salvage:
    """Complete records of a file.

    Attributes:
        profile: profile of the file.
        schemas: schemas by number.
        channels: channels by number.
        messages: messages in the order of the file.
        attachments: attachments.
        metadata: metadata.
        statistics: statistics of the file, if there are any.
        chunks: number of saved chunks.
        losses: damaged parts.
        doubtful: number of messages that may be damaged.
        spliced: whether channel numbers have several meanings, as in concatenated files.
        ended: whether the file has an end.
    """

    profile: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: MessageStore = field(default_factory=MessageStore)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    statistics: Statistics | None = None
    chunks: int = 0
    losses: list[Loss] = field(default_factory=list)
    doubtful: int = 0
    spliced: bool = False
    ended: bool = False


def salvage(data: FileBytes, *, keep_doubtful: bool = False) -> Salvage:
    """Read all complete records of an MCAP file, wherever it is damaged.

    Args:
        data: the file.
        keep_doubtful: whether to keep messages of chunks with a wrong checksum, whose values may be wrong.

    Returns:
        The records.
    """
    return _Salvager(data, keep_doubtful).walk()


class _Salvager:
    def __init__(self, data: FileBytes, keep_doubtful: bool) -> None:
        self._data = data
        self._keep_doubtful = keep_doubtful
        self._result = Salvage()
        self._definitions = Definitions()
        self._budget = Budget.of(len(data))
        self._after_damage = False  # whether the next record may be of a chunk with a damaged head
        self._strays: list[tuple[int, int]] = []  # positions of such messages in file and result
        self._lost_chunk: Loss | None = None  # the last lost chunk, until its index

    def walk(self) -> Salvage:
        """Read the file."""
        data, result = self._data, self._result
        position = len(MCAP0_MAGIC) if is_mcap(data) else 0
        previous_opcode, let_go_at = 0, 0
        while position < len(data):
            if result.ended and is_end(data, position):
                break
            end = record_end(data, position)
            if end is None:
                position = self._skip_damage(position)
                self._after_damage = True
                continue
            opcode, body = data[position], data[position + RECORD.size : end]
            self._after_damage = self._after_damage and opcode in _CHUNK_CONTENT
            if opcode == Opcode.CHUNK:
                self._add_chunk(position, end)
            elif self._after_damage or (opcode == Opcode.MESSAGE and previous_opcode in BEFORE_INDEX):
                self._add_stray(opcode, position, body)
            else:
                self._add_record(opcode, body)
            position, previous_opcode = end, opcode
            if end - let_go_at > RELEASE_INTERVAL:
                release_pages(data, end)
                let_go_at = end
        self._classify_strays()
        names = self._definitions
        names.resolve(set(result.messages.channels))
        result.schemas, result.channels, result.spliced = names.schemas, names.channels, names.renumbered
        return result

    def _skip_damage(self, position: int) -> int:
        """Store the loss at ``position``; returns the begin of the next complete record."""
        data = self._data
        after = find_next_record(data, position + 1)
        chunk = parse_chunk_header(data, position)
        # the next records may be those of the chunk itself if it is not compressed
        last = after == len(data) or (chunk is not None and not chunk.compression)
        if chunk is not None and chunk.end > len(data) and last:
            self._add_cut_chunk(position, chunk)
            return len(data)
        if self._add_damaged_chunk(position, after):
            return after
        looks_like_chunk = data[position] == Opcode.CHUNK
        what = "a damaged chunk" if looks_like_chunk else "a damaged record"
        if data[position] in INDEXES:
            what = "a damaged index, which holds no messages"
        if after == len(data):
            what = f"{what}, up to the end of the file"
        if not any(data[position:after]):
            what, looks_like_chunk = "zeros", False
        self._add_loss(Loss(position, after, what, chunk=looks_like_chunk))
        return after

    def _add_loss(self, loss: Loss) -> None:
        self._result.losses.append(loss)
        self._lost_chunk = loss

    def _add_record(self, opcode: int, body: bytes) -> None:
        stream, result = ReadDataStream(BytesIO(body)), self._result
        if opcode == Opcode.MESSAGE_INDEX:
            self._count_lost_messages(body)
            return
        self._lost_chunk = None
        if opcode == Opcode.HEADER:
            result.profile = Header.read(stream).profile
        elif opcode == Opcode.SCHEMA:
            self._definitions.add_schema(Schema.read(stream))
        elif opcode == Opcode.CHANNEL:
            self._definitions.add_channel(Channel.read(stream))
        elif opcode == Opcode.MESSAGE:
            result.messages.append(self._message(body))
        elif opcode == Opcode.ATTACHMENT:
            result.attachments.append(Attachment.read(stream))
        elif opcode == Opcode.METADATA:
            result.metadata.append(Metadata.read(stream))
        elif opcode == Opcode.STATISTICS:
            result.statistics = Statistics.read(stream)
        elif opcode == Opcode.FOOTER:
            result.ended = True

    def _add_stray(self, opcode: int, position: int, body: bytes) -> None:
        """Add a message or description after a damaged part, which may be of a damaged chunk."""
        if opcode == Opcode.MESSAGE:
            self._strays.append((position, len(self._result.messages)))
            self._add_record(opcode, body)
        else:
            self._add_description(opcode, body, intact=False)

    def _classify_strays(self) -> None:
        """Treat messages outside chunks as doubtful if the file has chunks: they have no checksum."""
        result = self._result
        if not self._strays or not (result.chunks or any(loss.chunk for loss in result.losses)):
            return
        if self._keep_doubtful:
            result.doubtful += len(self._strays)
            return
        for position, place in reversed(self._strays):
            message = result.messages.pop(place)
            end = position + RECORD.size + MESSAGE.size + len(message.data)
            result.losses.append(Loss(position, end, "a message outside the chunks, without a checksum"))
        result.losses.sort(key=lambda loss: loss.start)

    def _count_lost_messages(self, body: bytes) -> None:
        if self._lost_chunk is None or not self._lost_chunk.chunk:
            return
        channel, size = INDEX.unpack_from(body)
        counts = self._lost_chunk.messages
        counts[channel] = counts.get(channel, 0) + size // INDEX_ENTRY.size

    def _add_chunk(self, position: int, end: int) -> None:
        chunk = parse_chunk_header(self._data, position)
        assert chunk is not None, "whole_record has looked at it"
        self._lost_chunk = None
        try:
            raw = self._decompress(chunk.compression, self._data[chunk.content : end], chunk.size)
        except Exception as error:  # noqa: BLE001 - lz4 and zstd each raise their own
            self._add_loss(Loss(position, end, f"a chunk that cannot be unpacked: {error}", chunk=True))
            return
        intact = checksum_matches(chunk.crc, zlib.crc32(raw), whole_size=len(raw) == chunk.size)
        if not intact and not self._keep_doubtful:
            what = "a chunk whose checksum is wrong"
            self._add_loss(Loss(position, end, what, chunk=True))
            return
        count_before = len(self._result.messages)
        whole_bytes = self._add_content(raw, intact=intact)
        self._result.chunks += 1
        if not intact:
            self._result.doubtful += len(self._result.messages) - count_before
        if whole_bytes < len(raw):
            self._add_loss(Loss(position, end, PART_LOST, chunk=True))

    def _add_cut_chunk(self, position: int, chunk: ChunkHeader) -> None:
        """Add the messages of a truncated chunk before its cut."""
        data, count_before = self._data, len(self._result.messages)
        raw = decompress_prefix(
            chunk.compression.decode(), data[chunk.content :], min(chunk.size, self._budget.content)
        )
        self._add_content(raw, intact=False)
        saved = len(self._result.messages) - count_before
        what = f"a chunk that is cut off; {saved} messages before the cut were saved"
        self._add_loss(Loss(position, len(data), what, chunk=True))

    def _add_damaged_chunk(self, position: int, after: int) -> bool:
        """Add a chunk with a damaged head if its content has the stored checksum; whether that is so."""
        data = self._data
        if after - position < RECORD.size + CHUNK.size:
            return False
        _, _, size, crc, _ = CHUNK.unpack_from(data, position + RECORD.size)
        for compression in COMPRESSIONS:
            content = position + RECORD.size + CHUNK.size + len(compression) + 8
            try:
                raw = self._decompress(compression, data[content:after], size)
            except Exception:  # noqa: BLE001 - another compression
                continue
            if raw and zlib.crc32(raw) == crc:
                self._lost_chunk = None
                whole_bytes = self._add_content(raw, intact=True)
                self._result.chunks += 1
                if whole_bytes < len(raw):
                    self._add_loss(Loss(position, after, PART_LOST, chunk=True))
                return True
        return False

    def _add_content(self, raw: bytes, *, intact: bool) -> int:
        """Add the records of a chunk; returns the size of its complete records.

        Descriptions of channels and schemas in damaged content count only if there are no others.
        """
        position = damaged = 0
        for opcode, start, end in _iterate_records(raw):
            try:
                self._budget.take_record()
            except ImplausibleError:
                break  # more records than a file of this size may have: the rest counts as damaged
            position = end
            if opcode == Opcode.MESSAGE:
                self._result.messages.append(self._message(raw[start:end]))
            elif opcode in _DESCRIPTIONS and not self._add_description(opcode, raw[start:end], intact):
                damaged += end - start
        return position - damaged

    def _add_description(self, opcode: int, body: bytes, intact: bool) -> bool:
        """Add the description of a channel or schema; whether it is complete."""
        try:
            description = _DESCRIPTIONS[opcode](ReadDataStream(BytesIO(body)))
        except Exception:  # noqa: BLE001 - mcap's parsers raise almost anything on garbage
            return False
        if not intact:
            self._definitions.add_doubtful(description)
        elif isinstance(description, Schema):
            self._definitions.add_schema(description)
        else:
            self._definitions.add_channel(description)
        return True

    def _decompress(self, compression: bytes, content: bytes, size: int) -> bytes:
        """Decompress a chunk within the limits of a file of this size; raises the errors of the libraries.

        The size in the chunk is no limit, since it may be damaged.
        """
        most = min(self._budget.content, LARGEST_CHUNK)
        if compression == b"lz4":
            most = min(most, FREE + RATIO * len(content))
        elif compression == b"zstd":
            most = min(most, max(size, zstandard.frame_content_size(content)))
        raw = decompress(compression.decode(), content, most)
        self._budget.take_content(len(raw))
        return raw

    def _message(self, body: bytes) -> Message:
        channel, sequence, log_time, publish_time = MESSAGE.unpack_from(body)
        data = body[MESSAGE.size :]
        return Message(self._definitions.channel_number(channel), sequence, log_time, publish_time, data)


def _iterate_records(raw: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of the body of each complete record of a chunk."""
    position = 0
    while position + RECORD.size <= len(raw):
        opcode, length = RECORD.unpack_from(raw, position)
        start = position + RECORD.size
        position = start + length
        if position > len(raw) or (opcode == Opcode.MESSAGE and length < MESSAGE.size) or opcode == 0:
            return
        yield opcode, start, position
