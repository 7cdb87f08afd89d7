"""What is whole in a damaged MCAP file, record by record, and where something is missing.

Records are taken one after another as long as each is whole in itself. Where one is not, the next that is
whole is searched for, byte by byte. Nothing is taken on trust: a chunk counts when its checksum is right, or
is the only thing that is wrong in it; of a chunk that was cut off, the messages before the cut count.
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
from labhil.recording.definitions import Definitions
from labhil.recording.mapped import STRIDE, FileBytes, let_go
from labhil.recording.message_store import Message, MessageStore
from labhil.recording.packing import unpack, unpack_prefix
from labhil.recording.whole_records import (
    CHUNK,
    COMPRESSIONS,
    INDEX,
    MESSAGE,
    PLACE,
    RECORD,
    ChunkHeader,
    chunk_header,
    is_end,
    next_record,
    sound_checksum,
    whole_record,
)

_DESCRIPTIONS: dict[int, Any] = {Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read}

PART_LOST = "a part of a chunk: a record in it is damaged, or it holds more than a file of this size may"
_INNER = {Opcode.MESSAGE, *_DESCRIPTIONS}
"""What stands in chunks."""

BEFORE_INDEX = {Opcode.CHUNK, Opcode.MESSAGE_INDEX}
"""What an index of messages stands behind; by one wrong bit in its first byte it is a message."""

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
    """Bytes ``start`` to ``end`` of the file that hold nothing whole; ``what`` says why.

    ``messages`` counts what an index says was there, by channel; ``chunk`` whether a chunk was hit.
    """

    start: int
    end: int
    what: str
    chunk: bool = False
    messages: dict[int, int] = field(default_factory=dict)


@dataclass(slots=True)
class Salvage:
    """All whole records of a file, in its order."""

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
    """Find all that is whole in the bytes of an MCAP file, wherever it is damaged.

    ``keep_doubtful`` takes the messages of chunks whose checksum is wrong, as far as they can be
    separated; their values may be wrong.
    """
    return _Walk(data, keep_doubtful).walk()


class _Walk:
    def __init__(self, data: FileBytes, keep_doubtful: bool) -> None:
        self._data = data
        self._keep_doubtful = keep_doubtful
        self._result = Salvage()
        self._names = Definitions()
        self._budget = Budget.of(len(data))
        self._resumed = False  # whether what comes may have been in a chunk whose head was damaged
        self._stray: list[tuple[int, int]] = []  # positions of such messages in the file and in the result
        self._hit: Loss | None = None  # the chunk that was lost last, until its index has been read

    def walk(self) -> Salvage:
        """Go through the file from its first byte to its last."""
        data, result = self._data, self._result
        position = len(MCAP0_MAGIC) if is_mcap(data) else 0
        previous_opcode, let_go_at = 0, 0
        while position < len(data):
            if result.ended and is_end(data, position):
                break
            end = whole_record(data, position)
            if end is None:
                position = self._step_over(position)
                self._resumed = True
                continue
            opcode, body = data[position], data[position + RECORD.size : end]
            self._resumed = self._resumed and opcode in _INNER
            if opcode == Opcode.CHUNK:
                self._take_chunk(position, end)
            elif self._resumed or (opcode == Opcode.MESSAGE and previous_opcode in BEFORE_INDEX):
                self._take_stray(opcode, position, body)
            else:
                self._take(opcode, body)
            position, previous_opcode = end, opcode
            if end - let_go_at > STRIDE:
                let_go(data, end)
                let_go_at = end
        self._judge_stray()
        names = self._names
        names.settle(set(result.messages.channels))
        result.schemas, result.channels, result.spliced = names.schemas, names.channels, names.renumbered
        return result

    def _step_over(self, position: int) -> int:
        """Note what is broken at ``position`` and return where the next whole record begins."""
        data = self._data
        after = next_record(data, position + 1)
        chunk = chunk_header(data, position)
        # in content that is not packed whole records follow, those of the chunk itself
        last = after == len(data) or (chunk is not None and not chunk.compression)
        if chunk is not None and chunk.end > len(data) and last:
            self._take_cut_chunk(position, chunk)
            return len(data)
        if self._rescue_chunk(position, after):
            return after
        looks_like_chunk = data[position] == Opcode.CHUNK
        what = "a damaged chunk" if looks_like_chunk else "a damaged record"
        if data[position] in INDEXES:
            what = "a damaged index, which holds no messages"
        if after == len(data):
            what = f"{what}, up to the end of the file"
        if not any(data[position:after]):
            what, looks_like_chunk = "zeros", False
        self._lose(Loss(position, after, what, chunk=looks_like_chunk))
        return after

    def _lose(self, loss: Loss) -> None:
        self._result.losses.append(loss)
        self._hit = loss

    def _take(self, opcode: int, body: bytes) -> None:
        stream, result = ReadDataStream(BytesIO(body)), self._result
        if opcode == Opcode.MESSAGE_INDEX:
            self._count_lost(body)
            return
        self._hit = None
        if opcode == Opcode.HEADER:
            result.profile = Header.read(stream).profile
        elif opcode == Opcode.SCHEMA:
            self._names.schema(Schema.read(stream))
        elif opcode == Opcode.CHANNEL:
            self._names.channel(Channel.read(stream))
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

    def _take_stray(self, opcode: int, position: int, body: bytes) -> None:
        """Take a message or a description after a damaged part: it may be a piece of a damaged chunk."""
        if opcode == Opcode.MESSAGE:
            self._stray.append((position, len(self._result.messages)))
            self._take(opcode, body)
        else:
            self._describe(opcode, body, sound=False)

    def _judge_stray(self) -> None:
        """In a file with chunks no checksum guards messages outside of them: they are doubtful."""
        result = self._result
        if not self._stray or not (result.chunks or any(loss.chunk for loss in result.losses)):
            return
        if self._keep_doubtful:
            result.doubtful += len(self._stray)
            return
        for position, place in reversed(self._stray):
            message = result.messages.pop(place)
            end = position + RECORD.size + MESSAGE.size + len(message.data)
            result.losses.append(Loss(position, end, "a message outside the chunks, without a checksum"))
        result.losses.sort(key=lambda loss: loss.start)

    def _count_lost(self, body: bytes) -> None:
        if self._hit is None or not self._hit.chunk:
            return
        channel, size = INDEX.unpack_from(body)
        counts = self._hit.messages
        counts[channel] = counts.get(channel, 0) + size // PLACE.size

    def _take_chunk(self, position: int, end: int) -> None:
        chunk = chunk_header(self._data, position)
        assert chunk is not None, "whole_record has looked at it"
        self._hit = None
        try:
            raw = self._unpack(chunk.compression, self._data[chunk.content : end], chunk.size)
        except Exception as error:  # noqa: BLE001 - lz4 and zstd each raise their own
            self._lose(Loss(position, end, f"a chunk that cannot be unpacked: {error}", chunk=True))
            return
        sound = sound_checksum(chunk.crc, zlib.crc32(raw), whole_size=len(raw) == chunk.size)
        if not sound and not self._keep_doubtful:
            what = "a chunk whose checksum is wrong"
            self._lose(Loss(position, end, what, chunk=True))
            return
        count_before = len(self._result.messages)
        whole_bytes = self._take_content(raw, sound=sound)
        self._result.chunks += 1
        if not sound:
            self._result.doubtful += len(self._result.messages) - count_before
        if whole_bytes < len(raw):
            self._lose(Loss(position, end, PART_LOST, chunk=True))

    def _take_cut_chunk(self, position: int, chunk: ChunkHeader) -> None:
        """Of a chunk that the end of the file cuts off, take the messages before the cut."""
        data, count_before = self._data, len(self._result.messages)
        raw = unpack_prefix(
            chunk.compression.decode(), data[chunk.content :], min(chunk.size, self._budget.content)
        )
        self._take_content(raw, sound=False)
        saved = len(self._result.messages) - count_before
        what = f"a chunk that is cut off; {saved} messages before the cut were saved"
        self._lose(Loss(position, len(data), what, chunk=True))

    def _rescue_chunk(self, position: int, after: int) -> bool:
        """A chunk with a damaged head whose content still has the checksum that stands there."""
        data = self._data
        if after - position < RECORD.size + CHUNK.size:
            return False
        _, _, size, crc, _ = CHUNK.unpack_from(data, position + RECORD.size)
        for compression in COMPRESSIONS:
            content = position + RECORD.size + CHUNK.size + len(compression) + 8
            try:
                raw = self._unpack(compression, data[content:after], size)
            except Exception:  # noqa: BLE001 - it was none of this compression
                continue
            if raw and zlib.crc32(raw) == crc:
                self._hit = None
                whole_bytes = self._take_content(raw, sound=True)
                self._result.chunks += 1
                if whole_bytes < len(raw):
                    self._lose(Loss(position, after, PART_LOST, chunk=True))
                return True
        return False

    def _take_content(self, raw: bytes, *, sound: bool) -> int:
        """Take the records of a chunk; returns how many bytes of it are whole records.

        Descriptions of channels and schemas in content that is not ``sound`` yield to all others.
        """
        position = damaged = 0
        for opcode, start, end in _records(raw):
            try:
                self._budget.take_record()
            except ImplausibleError:
                break  # more records than a file of this size may hold: the rest counts as not whole
            position = end
            if opcode == Opcode.MESSAGE:
                self._result.messages.append(self._message(raw[start:end]))
            elif opcode in _DESCRIPTIONS and not self._describe(opcode, raw[start:end], sound):
                damaged += end - start
        return position - damaged

    def _describe(self, opcode: int, body: bytes, sound: bool) -> bool:
        """Take the description of a channel or a schema; whether it is whole."""
        try:
            description = _DESCRIPTIONS[opcode](ReadDataStream(BytesIO(body)))
        except Exception:  # noqa: BLE001 - mcap's parsers raise almost anything on garbage
            return False
        if not sound:
            self._names.doubtful(description)
        elif isinstance(description, Schema):
            self._names.schema(description)
        else:
            self._names.channel(description)
        return True

    def _unpack(self, compression: bytes, content: bytes, size: int) -> bytes:
        """The content of a chunk, within what a file of this size may hold; raises what its library raises.

        The size that the chunk claims may itself be damaged: it is no limit.
        """
        most = min(self._budget.content, LARGEST_CHUNK)
        if compression == b"lz4":
            most = min(most, FREE + RATIO * len(content))
        elif compression == b"zstd":
            most = min(most, max(size, zstandard.frame_content_size(content)))
        raw = unpack(compression.decode(), content, most)
        self._budget.take_content(len(raw))
        return raw

    def _message(self, body: bytes) -> Message:
        channel, sequence, log_time, publish_time = MESSAGE.unpack_from(body)
        data = body[MESSAGE.size :]
        return Message(self._names.number(channel), sequence, log_time, publish_time, data)


def _records(raw: bytes) -> Iterator[tuple[int, int, int]]:
    """Walk the content of a chunk as far as it holds whole records: opcode, start and end of the body."""
    position = 0
    while position + RECORD.size <= len(raw):
        opcode, length = RECORD.unpack_from(raw, position)
        start = position + RECORD.size
        position = start + length
        if position > len(raw) or (opcode == Opcode.MESSAGE and length < MESSAGE.size) or opcode == 0:
            return
        yield opcode, start, position
