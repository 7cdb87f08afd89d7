"""Where whole records stand in the bytes of an MCAP file that may be damaged anywhere.

Nothing is taken on trust: a record counts when the lengths inside it add up to its own.
"""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass
from io import BytesIO
from typing import Any

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from labhil.bounds import LARGEST_CHUNK, Work
from labhil.recording.memory_maps import FileBytes

RECORD = struct.Struct("<BQ")
CHUNK = struct.Struct("<QQQII")  # start and end time, size and CRC of the content, length of the name
MESSAGE = struct.Struct("<HIQQ")
INDEX = struct.Struct("<HI")
PLACE = struct.Struct("<QQ")

COMPRESSIONS = (b"lz4", b"zstd", b"")

_CANDIDATE = re.compile(rb"(?=[\x01-\x0f].{5}\x00{3})", re.DOTALL)
"""Where a record of less than a terabyte may begin."""

FIXED_LENGTHS = {Opcode.FOOTER: 20, Opcode.DATA_END: 4, Opcode.SUMMARY_OFFSET: 17}

_OPCODES = frozenset(int(opcode) for opcode in Opcode)


@dataclass(frozen=True, slots=True)
class ChunkHeader:
    """The head of a chunk: where its content begins and its record ends (bytes), and what it says."""

    content: int
    end: int
    compression: bytes
    size: int
    crc: int


def parse_chunk_header(data: FileBytes, position: int) -> ChunkHeader | None:
    """Read the head of a chunk at ``position``; None when its lengths contradict each other."""
    if len(data) < position + RECORD.size + CHUNK.size + 8 or data[position] != Opcode.CHUNK:
        return None
    length = RECORD.unpack_from(data, position)[1]
    start, end, size, crc, named = CHUNK.unpack_from(data, position + RECORD.size)
    name = position + RECORD.size + CHUNK.size
    if named > 4 or name + named + 8 > len(data):
        return None
    compression = data[name : name + named]
    (packed,) = struct.unpack_from("<Q", data, name + named)
    fits = length == CHUNK.size + named + 8 + packed and size <= LARGEST_CHUNK and start <= end
    if compression not in COMPRESSIONS or not fits:
        return None
    content = name + named + 8
    return ChunkHeader(content, content + packed, compression, size, crc)


def record_end(data: FileBytes, position: int, work: Work | None = None) -> int | None:
    """Where the record at ``position`` ends, or None when it is not whole in itself.

    Looking into a record takes its length from ``work``; what it no longer suffices for is not whole.
    """
    if position + RECORD.size > len(data):
        return None
    opcode, length = RECORD.unpack_from(data, position)
    start, end = position + RECORD.size, position + RECORD.size + length
    if opcode not in _OPCODES or end > len(data) or FIXED_LENGTHS.get(opcode, length) != length:
        return None
    if opcode == Opcode.MESSAGE:
        return end if length >= MESSAGE.size else None
    if opcode == Opcode.CHUNK:
        return end if parse_chunk_header(data, position) is not None else None
    try:
        if work is not None:
            work.take(length)
        return end if _fits(opcode, data[start:end]) else None
    except Exception:  # noqa: BLE001 - mcap's parsers raise almost anything on garbage
        return None


def is_end(data: FileBytes, position: int) -> bool:
    """Whether nothing but the magic bytes of the end stand from ``position`` on."""
    return len(data) - position == len(MCAP0_MAGIC) and data[position:] == MCAP0_MAGIC


def find_next_record(data: FileBytes, position: int) -> int:
    """Where the next whole record begins that another one, or the end, follows; else the file's length."""
    work = Work.of(len(data))  # records that claim to reach far would be looked through again and again
    for candidate in _CANDIDATE.finditer(data, position):
        start = candidate.start()
        end = record_end(data, start, work)
        if end is not None and (end >= len(data) or is_end(data, end) or _begins(data, end)):
            return start
    return len(data)


def checksum_matches(stored: int, calculated: int, *, whole_size: bool) -> bool:
    """Whether content is whole: the checksums agree, or only the stored one can have been damaged.

    0 stands for none. Content that is damaged changes all four bytes of its CRC: one that differs in a
    single byte (1 in 4 million by chance) was hit itself. ``whole_size`` is whether the content has the
    size that it should have.
    """
    differing = sum(byte != 0 for byte in struct.pack("<I", stored ^ calculated))
    return differing == 0 or (whole_size and (stored == 0 or differing == 1))


def _begins(data: FileBytes, position: int) -> bool:
    """Whether a record seems to begin here: one that ends within the file, or a chunk that is cut off."""
    if position + RECORD.size > len(data):
        return True
    opcode, length = RECORD.unpack_from(data, position)
    if opcode not in _OPCODES:
        return False
    return position + length <= len(data) or parse_chunk_header(data, position) is not None


def _fits(opcode: int, body: bytes) -> bool:
    """Whether the lengths inside a record add up to its own."""
    if opcode in FIXED_LENGTHS:
        return True
    if opcode == Opcode.MESSAGE_INDEX:
        _, size = INDEX.unpack_from(body)
        return bool(size) and size % PLACE.size == 0 and len(body) == INDEX.size + size
    if opcode == Opcode.ATTACHMENT:
        (stored,) = struct.unpack_from("<I", body, len(body) - 4)
        if stored != 0 and zlib.crc32(body[:-4]) != stored:
            return False
    stream = ReadDataStream(BytesIO(body))
    _READERS[Opcode(opcode)](stream)
    return stream.count == len(body)


_READERS: dict[Opcode, Any] = {
    Opcode.HEADER: records.Header.read,
    Opcode.SCHEMA: records.Schema.read,
    Opcode.CHANNEL: records.Channel.read,
    Opcode.METADATA: records.Metadata.read,
    Opcode.STATISTICS: records.Statistics.read,
    Opcode.CHUNK_INDEX: records.ChunkIndex.read,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex.read,
    Opcode.METADATA_INDEX: records.MetadataIndex.read,
    Opcode.ATTACHMENT: records.Attachment.read,
}
