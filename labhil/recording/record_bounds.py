"""Bounds of complete records in an MCAP file that may be damaged anywhere.

A record is complete if the lengths inside it add up to its own.
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
INDEX_ENTRY = struct.Struct("<QQ")

COMPRESSIONS = (b"lz4", b"zstd", b"")

_CANDIDATE = re.compile(rb"(?=[\x01-\x0f].{5}\x00{3})", re.DOTALL)
"""Begin of a possible record of less than a terabyte."""

FIXED_LENGTHS = {Opcode.FOOTER: 20, Opcode.DATA_END: 4, Opcode.SUMMARY_OFFSET: 17}

_OPCODES = frozenset(int(opcode) for opcode in Opcode)


@dataclass(frozen=True, slots=True)
class ChunkHeader:
    """Head of a chunk.

    Attributes:
        content: position of its content.
        end: end of its record.
        compression: name of the compression.
        size: decompressed size.
        crc: CRC-32 of the decompressed content, 0 for none.
    """

    content: int
    end: int
    compression: bytes
    size: int
    crc: int


def parse_chunk_header(data: FileBytes, position: int) -> ChunkHeader | None:
    """Parse the head of a chunk at ``position``; None if its lengths are inconsistent."""
    if len(data) < position + RECORD.size + CHUNK.size + 8 or data[position] != Opcode.CHUNK:
        return None
    length = RECORD.unpack_from(data, position)[1]
    start, end, size, crc, name_length = CHUNK.unpack_from(data, position + RECORD.size)
    name = position + RECORD.size + CHUNK.size
    if name_length > 4 or name + name_length + 8 > len(data):
        return None
    compression = data[name : name + name_length]
    (compressed_size,) = struct.unpack_from("<Q", data, name + name_length)
    fits = length == CHUNK.size + name_length + 8 + compressed_size and size <= LARGEST_CHUNK and start <= end
    if compression not in COMPRESSIONS or not fits:
        return None
    content = name + name_length + 8
    return ChunkHeader(content, content + compressed_size, compression, size, crc)


def record_end(data: FileBytes, position: int, work: Work | None = None) -> int | None:
    """Find the end of the record at a position.

    Args:
        data: the file.
        position: begin of the record.
        work: budget for parsing records, by length; a record beyond it counts as incomplete.

    Returns:
        The end; None if the record is incomplete.
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
        return end if _is_consistent(opcode, data[start:end]) else None
    except Exception:  # noqa: BLE001 - mcap's parsers raise almost anything on garbage
        return None


def is_end(data: FileBytes, position: int) -> bool:
    """Whether only the final magic bytes follow from ``position`` on."""
    return len(data) - position == len(MCAP0_MAGIC) and data[position:] == MCAP0_MAGIC


def find_next_record(data: FileBytes, position: int) -> int:
    """Find the next complete record before another one or the end; the file's length without one."""
    work = Work.of(len(data))  # many candidates may claim large lengths
    for candidate in _CANDIDATE.finditer(data, position):
        start = candidate.start()
        end = record_end(data, start, work)
        if end is not None and (end >= len(data) or is_end(data, end) or _may_begin(data, end)):
            return start
    return len(data)


def checksum_matches(stored: int, calculated: int, *, whole_size: bool) -> bool:
    """Whether content is sound: its checksum is right, or only the stored checksum is damaged.

    Damage of the content changes all bytes of its CRC. A CRC with one wrong byte (by chance 1 in 4 million)
    was damaged itself.

    Args:
        stored: the stored CRC-32; 0 for none.
        calculated: the CRC-32 of the content.
        whole_size: whether the content has its stated size.

    Returns:
        Whether it is sound.
    """
    n_wrong = sum(byte != 0 for byte in struct.pack("<I", stored ^ calculated))
    return n_wrong == 0 or (whole_size and (stored == 0 or n_wrong == 1))


def _may_begin(data: FileBytes, position: int) -> bool:
    """Whether a record may begin here: it ends within the file, or is a truncated chunk."""
    if position + RECORD.size > len(data):
        return True
    opcode, length = RECORD.unpack_from(data, position)
    if opcode not in _OPCODES:
        return False
    return position + length <= len(data) or parse_chunk_header(data, position) is not None


def _is_consistent(opcode: int, body: bytes) -> bool:
    """Whether the lengths inside a record add up to its own, and an attachment's checksum is right."""
    if opcode in FIXED_LENGTHS:
        return True
    if opcode == Opcode.MESSAGE_INDEX:
        _, size = INDEX.unpack_from(body)
        return bool(size) and size % INDEX_ENTRY.size == 0 and len(body) == INDEX.size + size
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
