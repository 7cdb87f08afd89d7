"""What is whole in a damaged MCAP file, record by record, and where something is missing.

Records are taken one after another as long as each is whole in itself. Where one is not, the next that is
whole is searched for, byte by byte. Nothing is taken on trust: a chunk counts when its checksum is right, or
is the only thing that is wrong in it; of a chunk that was cut off, the messages before the cut count.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from labhil.recording.chunks import is_mcap

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")  # start and end time, size and CRC of the content, length of the name
_MESSAGE = struct.Struct("<HIQQ")
_INDEX = struct.Struct("<HI")
_PLACE = struct.Struct("<QQ")

COMPRESSIONS = (b"lz4", b"zstd", b"")
LARGEST_CHUNK = 1 << 32

_CANDIDATE = re.compile(rb"(?=[\x01-\x0f].{5}\x00{3})", re.DOTALL)
"""Where a record of less than a terabyte may begin."""

FIXED_LENGTHS = {Opcode.FOOTER: 20, Opcode.DATA_END: 4, Opcode.SUMMARY_OFFSET: 17}

INDEXES = {
    Opcode.MESSAGE_INDEX,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
    Opcode.STATISTICS,
    Opcode.SUMMARY_OFFSET,
}


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it stood in the file; times in ns (Unix)."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


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
    """Everything whole that was found, in the order of the file."""

    profile: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    statistics: Statistics | None = None
    chunks: int = 0
    losses: list[Loss] = field(default_factory=list)
    doubtful: int = 0
    ended: bool = False


def salvage(data: bytes, *, keep_doubtful: bool = False) -> Salvage:
    """Find all that is whole in the bytes of an MCAP file, wherever it is damaged.

    ``keep_doubtful`` takes the messages of chunks whose checksum is wrong, as far as they can be told
    apart; their values may be wrong.
    """
    return _Walk(data, keep_doubtful).walk()


class _Walk:
    def __init__(self, data: bytes, keep_doubtful: bool) -> None:
        self._data = data
        self._keep_doubtful = keep_doubtful
        self._found = Salvage()
        self._hit: Loss | None = None  # the chunk that was lost last, until its index has been read

    def walk(self) -> Salvage:
        """Go through the file from its first byte to its last."""
        data, found = self._data, self._found
        position = len(MCAP0_MAGIC) if is_mcap(data) else 0
        while position < len(data):
            if data[position:] == MCAP0_MAGIC and found.ended:
                return found
            end = whole_record(data, position)
            if end is None:
                position = self._step_over(position)
                continue
            opcode = data[position]
            if opcode == Opcode.CHUNK:
                self._take_chunk(position, end)
            else:
                self._take(opcode, data[position + _RECORD.size : end])
            position = end
        return found

    def _step_over(self, position: int) -> int:
        """Note what is broken at ``position`` and return where the next whole record begins."""
        data = self._data
        after = next_record(data, position + 1)
        chunk = chunk_header(data, position)
        if chunk is not None and chunk.end > len(data) and after == len(data):
            self._take_cut_chunk(position, chunk)
            return after
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
        self._found.losses.append(loss)
        self._hit = loss

    def _take(self, opcode: int, body: bytes) -> None:
        stream, found = ReadDataStream(BytesIO(body)), self._found
        if opcode == Opcode.MESSAGE_INDEX:
            self._count_lost(body)
            return
        self._hit = None
        if opcode == Opcode.HEADER:
            found.profile = Header.read(stream).profile
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            found.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            found.channels.setdefault(channel.id, channel)
        elif opcode == Opcode.MESSAGE:
            found.messages.append(_message(body))
        elif opcode == Opcode.ATTACHMENT:
            found.attachments.append(Attachment.read(stream))
        elif opcode == Opcode.METADATA:
            found.metadata.append(Metadata.read(stream))
        elif opcode == Opcode.STATISTICS:
            found.statistics = Statistics.read(stream)
        elif opcode == Opcode.FOOTER:
            found.ended = True

    def _count_lost(self, body: bytes) -> None:
        if self._hit is None or not self._hit.chunk:
            return
        channel, size = _INDEX.unpack_from(body)
        counts = self._hit.messages
        counts[channel] = counts.get(channel, 0) + size // _PLACE.size

    def _take_chunk(self, position: int, end: int) -> None:
        chunk = chunk_header(self._data, position)
        assert chunk is not None, "whole_record has looked at it"
        self._hit = None
        try:
            raw = unpacked(chunk.compression, self._data[chunk.content : end], chunk.size)
        except Exception as error:  # noqa: BLE001 - lz4 and zstd each raise their own
            self._lose(Loss(position, end, f"a chunk that cannot be unpacked: {error}", chunk=True))
            return
        sound = sound_checksum(chunk.crc, zlib.crc32(raw), whole_size=len(raw) == chunk.size)
        if not sound and not self._keep_doubtful:
            what = "a chunk whose checksum is wrong"
            self._lose(Loss(position, end, what, chunk=True))
            return
        before = len(self._found.messages)
        whole = self._take_content(raw)
        self._found.chunks += 1
        if not sound:
            self._found.doubtful += len(self._found.messages) - before
        if whole < len(raw):
            self._lose(Loss(position, end, "the rest of a chunk, from a damaged record on", chunk=True))

    def _take_cut_chunk(self, position: int, chunk: ChunkHeader) -> None:
        """Of a chunk that the end of the file cuts off, take the messages before the cut."""
        data, before = self._data, len(self._found.messages)
        raw = unpacked_prefix(chunk.compression, data[chunk.content :])
        self._take_content(raw)
        saved = len(self._found.messages) - before
        what = f"a chunk that is cut off; {saved} messages before the cut were saved"
        self._lose(Loss(position, len(data), what, chunk=True))

    def _rescue_chunk(self, position: int, after: int) -> bool:
        """A chunk with a damaged head whose content still has the checksum that stands there."""
        data = self._data
        if after - position < _RECORD.size + _CHUNK.size:
            return False
        _, _, size, crc, _ = _CHUNK.unpack_from(data, position + _RECORD.size)
        for compression in COMPRESSIONS:
            content = position + _RECORD.size + _CHUNK.size + len(compression) + 8
            try:
                raw = unpacked(compression, data[content:after], min(size, LARGEST_CHUNK))
            except Exception:  # noqa: BLE001 - it was none of this compression
                continue
            if raw and zlib.crc32(raw) == crc:
                self._take_content(raw)
                self._found.chunks += 1
                self._hit = None
                return True
        return False

    def _take_content(self, raw: bytes) -> int:
        """Take the records of a chunk; returns how many bytes of it are whole records."""
        position = 0
        for opcode, start, end in _records(raw):
            if opcode == Opcode.MESSAGE:
                self._found.messages.append(_message(raw[start:end]))
            elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                self._take(opcode, raw[start:end])
            position = end
        return position


@dataclass(frozen=True, slots=True)
class ChunkHeader:
    """The head of a chunk: where its content begins and its record ends (bytes), and what it says."""

    content: int
    end: int
    compression: bytes
    size: int
    crc: int


def chunk_header(data: bytes, position: int) -> ChunkHeader | None:
    """Read the head of a chunk at ``position``; None when its lengths contradict each other."""
    if len(data) < position + _RECORD.size + _CHUNK.size + 8 or data[position] != Opcode.CHUNK:
        return None
    length = _RECORD.unpack_from(data, position)[1]
    start, end, size, crc, named = _CHUNK.unpack_from(data, position + _RECORD.size)
    name = position + _RECORD.size + _CHUNK.size
    if named > 4 or name + named + 8 > len(data):
        return None
    compression = data[name : name + named]
    (packed,) = struct.unpack_from("<Q", data, name + named)
    fits = length == _CHUNK.size + named + 8 + packed and size <= LARGEST_CHUNK and start <= end
    if compression not in COMPRESSIONS or not fits:
        return None
    content = name + named + 8
    return ChunkHeader(content, content + packed, compression, size, crc)


def whole_record(data: bytes, position: int) -> int | None:
    """Where the record at ``position`` ends, or None when it is not whole in itself."""
    if position + _RECORD.size > len(data):
        return None
    opcode, length = _RECORD.unpack_from(data, position)
    start, end = position + _RECORD.size, position + _RECORD.size + length
    if opcode not in set(Opcode) or end > len(data) or FIXED_LENGTHS.get(opcode, length) != length:
        return None
    if opcode == Opcode.CHUNK:
        return end if chunk_header(data, position) is not None else None
    try:
        return end if _fits(opcode, data[start:end]) else None
    except Exception:  # noqa: BLE001 - mcap's parsers raise almost anything on garbage
        return None


def next_record(data: bytes, position: int) -> int:
    """Where the next whole record begins that another one, or the end, follows; else the file's length."""
    for candidate in _CANDIDATE.finditer(data, position):
        start = candidate.start()
        end = whole_record(data, start)
        if end is not None and (end >= len(data) or data[end:] == MCAP0_MAGIC or _begins(data, end)):
            return start
    return len(data)


def sound_checksum(stored: int, calculated: int, *, whole_size: bool) -> bool:
    """Whether content is whole: the checksums agree, or only the stored one can have been damaged.

    0 stands for none. Content that is damaged changes all four bytes of its CRC: one that differs in a
    single byte (1 in 4 million by chance) was hit itself. ``whole_size`` is whether the content has the
    size that it should have.
    """
    differing = sum(byte != 0 for byte in struct.pack("<I", stored ^ calculated))
    return differing == 0 or (whole_size and (stored == 0 or differing == 1))


def unpacked(compression: bytes, content: bytes, size: int) -> bytes:
    """The content of a chunk; raises whatever its library raises."""
    if compression == b"lz4":
        return bytes(lz4.frame.decompress(content))
    if compression == b"zstd":
        return zstandard.ZstdDecompressor().decompress(content, max_output_size=size)
    return content


def unpacked_prefix(compression: bytes, content: bytes) -> bytes:
    """As much as can be had of content that is cut off."""
    if not compression:
        return content
    packer: Any = (
        lz4.frame.LZ4FrameDecompressor()
        if compression == b"lz4"
        else zstandard.ZstdDecompressor().decompressobj()
    )
    try:
        return bytes(packer.decompress(content))
    except Exception:  # noqa: BLE001 - each library raises its own
        return b""


def _begins(data: bytes, position: int) -> bool:
    """Whether a record seems to begin here: one that ends within the file, or a chunk that is cut off."""
    if position + _RECORD.size > len(data):
        return True
    opcode, length = _RECORD.unpack_from(data, position)
    if opcode not in set(Opcode):
        return False
    return position + length <= len(data) or chunk_header(data, position) is not None


def _fits(opcode: int, body: bytes) -> bool:
    """Whether the lengths inside a record add up to its own."""
    if opcode in FIXED_LENGTHS:
        return True
    if opcode == Opcode.MESSAGE:
        return len(body) >= _MESSAGE.size
    if opcode == Opcode.MESSAGE_INDEX:
        _, size = _INDEX.unpack_from(body)
        return bool(size) and size % _PLACE.size == 0 and len(body) == _INDEX.size + size
    if opcode == Opcode.ATTACHMENT:
        (stored,) = struct.unpack_from("<I", body, len(body) - 4)
        return stored == 0 or zlib.crc32(body[:-4]) == stored
    stream = ReadDataStream(BytesIO(body))
    _READERS[Opcode(opcode)](stream)
    return stream.count == len(body)


def _readers() -> dict[Opcode, Any]:
    from mcap import records

    return {
        Opcode.HEADER: Header.read,
        Opcode.SCHEMA: Schema.read,
        Opcode.CHANNEL: Channel.read,
        Opcode.METADATA: Metadata.read,
        Opcode.STATISTICS: Statistics.read,
        Opcode.CHUNK_INDEX: records.ChunkIndex.read,
        Opcode.ATTACHMENT_INDEX: records.AttachmentIndex.read,
        Opcode.METADATA_INDEX: records.MetadataIndex.read,
    }


_READERS = _readers()


def _records(raw: bytes) -> Iterator[tuple[int, int, int]]:
    """Walk the content of a chunk as far as it holds whole records: opcode, start and end of the body."""
    position = 0
    while position + _RECORD.size <= len(raw):
        opcode, length = _RECORD.unpack_from(raw, position)
        start = position + _RECORD.size
        position = start + length
        if position > len(raw) or (opcode == Opcode.MESSAGE and length < _MESSAGE.size) or opcode == 0:
            return
        yield opcode, start, position


def _message(body: bytes) -> Message:
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
    return Message(channel, sequence, log_time, publish_time, body[_MESSAGE.size :])
