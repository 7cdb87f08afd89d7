"""What stands in an MCAP file, chunk by chunk, whether or not the file has an end.

The records inside a chunk are walked once; the messages of one channel are then taken out of it as one
array of bytes, so that nothing is done message by message.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata
from mcap.writer import MCAP0_MAGIC
from numpy.lib.stride_tricks import sliding_window_view

from labhil.bounds import Budget, ImplausibleError
from labhil.codec import ByteRows
from labhil.recording.compression import decompress
from labhil.recording.memory_maps import RELEASE_INTERVAL, FileBytes, release_pages
from labhil.signals import IntArray
from labhil.terminal import printable_name

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQH")
_MESSAGE_HEAD = 22  # channel u16, sequence u32, log time u64, publish time u64

BLOCK = 1 << 25
"""Bytes of messages of one channel (32 MiB) that are decoded together."""


@dataclass(slots=True)
class Messages:
    """The messages of one channel, in the order of the file, as pieces of rows of bytes; ``size`` is all of
    them, in bytes."""

    pieces: list[ByteRows] = field(default_factory=list)
    size: int = 0

    def add(self, rows: ByteRows) -> None:
        """Append rows of bytes, shape (k, bytes of a message)."""
        self.pieces.append(rows)
        self.size += rows.size

    def forget(self) -> None:
        """Keep nothing of what has been read so far."""
        self.pieces.clear()
        self.size = 0

    def rows(self, size: int) -> ByteRows | None:
        """The payloads as one array of shape (n, size), or None when some have another size."""
        if not all(piece.shape[1] == _MESSAGE_HEAD + size for piece in self.pieces):
            return None
        if not self.pieces:
            return np.empty((0, size), dtype=np.uint8)
        return np.concatenate(self.pieces)[:, _MESSAGE_HEAD:]

    def payloads(self) -> list[bytes]:
        """The payloads one by one."""
        return [row[_MESSAGE_HEAD:].tobytes() for piece in self.pieces for row in piece]

    def log_times(self) -> IntArray:
        """Log times in ns (Unix time), int64 of shape (n,)."""
        times = [np.ascontiguousarray(piece[:, 6:14]).view("<i8")[:, 0] for piece in self.pieces]
        return np.concatenate(times).astype(np.int64) if times else np.empty(0, dtype=np.int64)


@dataclass(slots=True)
class Contents:
    """Everything that could be read. ``damage`` says in words what could not, empty when all could.

    Of attachments of one name with different contents the first stands in ``attachments``, and the name in
    ``ambiguous``.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    messages: defaultdict[int, Messages] = field(default_factory=lambda: defaultdict(Messages))
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    ambiguous: set[str] = field(default_factory=set)
    damage: str = ""


def is_mcap(data: FileBytes) -> bool:
    """Whether a file begins as an MCAP file does."""
    return data[: len(MCAP0_MAGIC)] == MCAP0_MAGIC


class ChannelConflictError(ValueError):
    """The number of a channel has another meaning from here on: what follows is of another file."""


OnBlock = Callable[[Channel, Messages], None]
"""Is given a channel and what has been read of it, when that is much; what it takes away is kept no more."""


def scan_mcap(data: FileBytes, on_block: OnBlock | None = None) -> Contents:
    """Read all that can be read of an MCAP file, with or without its end.

    ``on_block`` keeps what is read small. ImplausibleError when it claims to hold more than a file of its
    size can.
    """
    contents, budget = Contents(), Budget.of(len(data))
    position, let_go_at = len(MCAP0_MAGIC), 0
    while position + _RECORD.size <= len(data):
        opcode, length = _RECORD.unpack_from(data, position)
        start, end = position + _RECORD.size, position + _RECORD.size + length
        if opcode == 0:  # no record has it: blocks of zeros are what a power failure leaves
            contents.damage = f"byte {position}: expected a record, found zeros"
            return contents
        if end > len(data):
            break
        try:
            _take(contents, opcode, data[start:end], budget)
        except ImplausibleError:
            raise
        except ChannelConflictError as error:
            contents.damage = f"byte {position}: {error}"
            return contents
        except Exception as error:  # noqa: BLE001 - lz4, zstd, struct and mcap each raise their own
            contents.damage = f"byte {position}: a damaged record was left out: {error}"
        if opcode == Opcode.FOOTER and len(data) - end == len(MCAP0_MAGIC) and data[end:] == MCAP0_MAGIC:
            return contents
        if end - let_go_at > RELEASE_INTERVAL:
            release_pages(data, end)
            let_go_at = end
            _hand_over(contents, on_block)
        position = end
    missing = f"the file ends after {len(data)} bytes, without the end that a finished recording has"
    contents.damage = f"{contents.damage}; {missing}" if contents.damage else missing
    return contents


def _hand_over(contents: Contents, on_block: OnBlock | None) -> None:
    if on_block is None:
        return
    for number, messages in contents.messages.items():
        if messages.size > BLOCK and number in contents.channels:
            on_block(contents.channels[number], messages)


def _take(contents: Contents, opcode: int, body: bytes, budget: Budget) -> None:
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.CHUNK:
        _take_chunk(contents, _unpack(Chunk.read(stream), budget), budget)
    elif opcode == Opcode.CHANNEL:
        _take_channel(contents, Channel.read(stream))
    elif opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(stream)
        data = bytes(attachment.data)
        if contents.attachments.setdefault(attachment.name, data) != data:
            contents.ambiguous.add(attachment.name)
    elif opcode == Opcode.METADATA:
        metadata = Metadata.read(stream)
        contents.metadata[metadata.name] = metadata.metadata
    elif opcode == Opcode.MESSAGE:  # a file without chunks
        _refuse_short(len(body))
        row = np.frombuffer(body, dtype=np.uint8)[np.newaxis]
        contents.messages[int.from_bytes(body[:2], "little")].add(row)


def _unpack(chunk: Chunk, budget: Budget) -> bytes:
    budget.take_content(chunk.uncompressed_size)
    raw = decompress(chunk.compression, chunk.data, chunk.uncompressed_size)
    if chunk.uncompressed_crc not in (0, zlib.crc32(raw)):
        raise ValueError("its checksum is wrong")
    return raw


def _take_channel(contents: Contents, channel: Channel) -> None:
    known = contents.channels.setdefault(channel.id, channel)
    if (known.topic, known.message_encoding) != (channel.topic, channel.message_encoding):
        raise ChannelConflictError(
            f"channel {channel.id} is {printable_name(known.topic)}, and from here on "
            f"{printable_name(channel.topic)}: the file is pieced together from several"
        )


def _refuse_short(length: int) -> None:
    if length < _MESSAGE_HEAD:
        raise ValueError(f"expected a message of {_MESSAGE_HEAD} bytes or more, found one of {length}")


def _take_chunk(contents: Contents, raw: bytes, budget: Budget) -> None:
    places: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
    for opcode, start, length, channel in _records(raw):
        budget.take_record()
        if opcode == Opcode.MESSAGE:
            _refuse_short(length)
            places[channel].append((start, length))
        elif opcode != Opcode.CHUNK:  # there is none within another
            _take(contents, opcode, raw[start : start + length], budget)
    flat = np.frombuffer(raw, dtype=np.uint8)
    for channel, spans in places.items():
        starts, lengths = np.array(spans).T
        if (lengths == lengths[0]).all():
            rows: Any = sliding_window_view(flat, lengths[0])[starts]
            contents.messages[channel].add(rows)
        else:
            for start, length in spans:
                contents.messages[channel].add(flat[np.newaxis, start : start + length])


def _records(raw: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Walk a chunk: opcode, start and length of the body, and its first two bytes as a number."""
    position, end = 0, len(raw)
    while position < end:
        # the last record may have a body shorter than two bytes
        head = raw[position : position + _MESSAGE.size].ljust(_MESSAGE.size, b"\0")
        opcode, length, channel = _MESSAGE.unpack(head)
        position += _RECORD.size
        if opcode == 0 or length > end - position:
            raise ValueError("expected whole records in a chunk, found one that is not")
        yield opcode, position, length, channel
        position += length
