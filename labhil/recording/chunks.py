"""Reader of MCAP files, chunk by chunk, with or without an end.

The messages of each channel in a chunk become one array of bytes, so that no code runs per message.
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

_RECORD_HEAD = struct.Struct("<BQ")
_MESSAGE_RECORD_HEAD = struct.Struct("<BQH")
_MESSAGE_HEAD = 22  # channel u16, sequence u32, log time u64, publish time u64

BLOCK_SIZE = 1 << 25
"""Size of the messages of a channel that are decoded together, bytes (32 MiB)."""


@dataclass(slots=True)
class Messages:
    """Messages of a channel in the order of the file.

    Attributes:
        arrays: arrays of messages of equal size, (k, bytes).
        size: size of all messages, bytes.
    """

    arrays: list[ByteRows] = field(default_factory=list)
    size: int = 0

    def add(self, rows: ByteRows) -> None:
        """Append messages (k, bytes)."""
        self.arrays.append(rows)
        self.size += rows.size

    def clear(self) -> None:
        """Drop the messages."""
        self.arrays.clear()
        self.size = 0

    def rows(self, size: int) -> ByteRows | None:
        """Payloads as an array (n, size); None if some have another size."""
        if not all(piece.shape[1] == _MESSAGE_HEAD + size for piece in self.arrays):
            return None
        if not self.arrays:
            return np.empty((0, size), dtype=np.uint8)
        return np.concatenate(self.arrays)[:, _MESSAGE_HEAD:]

    def payloads(self) -> list[bytes]:
        """List the payloads."""
        return [row[_MESSAGE_HEAD:].tobytes() for piece in self.arrays for row in piece]

    def log_times(self) -> IntArray:
        """Log times (n,), ns of Unix time."""
        times = [np.ascontiguousarray(piece[:, 6:14]).view("<i8")[:, 0] for piece in self.arrays]
        return np.concatenate(times).astype(np.int64) if times else np.empty(0, dtype=np.int64)


@dataclass(slots=True)
class Contents:
    """Content of an MCAP file.

    Attributes:
        channels: channels by number.
        messages: messages by number of the channel.
        attachments: attachments by name; the first of several with one name.
        metadata: metadata by name.
        ambiguous: names of several different attachments.
        damage: what could not be read, for messages; empty for a sound file.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    messages: defaultdict[int, Messages] = field(default_factory=lambda: defaultdict(Messages))
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    ambiguous: set[str] = field(default_factory=set)
    damage: str = ""


def is_mcap(data: FileBytes) -> bool:
    """Whether data begin with the magic bytes of MCAP."""
    return data[: len(MCAP0_MAGIC)] == MCAP0_MAGIC


class ChannelConflictError(ValueError):
    """The number of a channel changes its meaning: the rest of the file is from another file."""


OnBlock = Callable[[Channel, Messages], None]
"""Called with a channel and its messages when these are many; it may clear them."""


def scan_mcap(data: FileBytes, on_block: OnBlock | None = None) -> Contents:
    """Read an MCAP file as far as possible, with or without an end.

    Args:
        data: the file.
        on_block: called when a channel has many messages, to limit the memory.

    Returns:
        Its content.

    Raises:
        ImplausibleError: The file claims more content than a file of its size can have.
    """
    contents, budget = Contents(), Budget.of(len(data))
    position, let_go_at = len(MCAP0_MAGIC), 0
    while position + _RECORD_HEAD.size <= len(data):
        opcode, length = _RECORD_HEAD.unpack_from(data, position)
        start, end = position + _RECORD_HEAD.size, position + _RECORD_HEAD.size + length
        if opcode == 0:  # no record: a power failure leaves blocks of zeros
            contents.damage = f"byte {position}: expected a record, found zeros"
            return contents
        if end > len(data):
            break
        try:
            _add_record(contents, opcode, data[start:end], budget)
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
            _pass_blocks(contents, on_block)
        position = end
    missing = f"the file ends after {len(data)} bytes, without the end that a finished recording has"
    contents.damage = f"{contents.damage}; {missing}" if contents.damage else missing
    return contents


def _pass_blocks(contents: Contents, on_block: OnBlock | None) -> None:
    if on_block is None:
        return
    for number, messages in contents.messages.items():
        if messages.size > BLOCK_SIZE and number in contents.channels:
            on_block(contents.channels[number], messages)


def _add_record(contents: Contents, opcode: int, body: bytes, budget: Budget) -> None:
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.CHUNK:
        _add_chunk(contents, _decompress(Chunk.read(stream), budget), budget)
    elif opcode == Opcode.CHANNEL:
        _add_channel(contents, Channel.read(stream))
    elif opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(stream)
        data = bytes(attachment.data)
        if contents.attachments.setdefault(attachment.name, data) != data:
            contents.ambiguous.add(attachment.name)
    elif opcode == Opcode.METADATA:
        metadata = Metadata.read(stream)
        contents.metadata[metadata.name] = metadata.metadata
    elif opcode == Opcode.MESSAGE:  # a file without chunks
        _check_length(len(body))
        row = np.frombuffer(body, dtype=np.uint8)[np.newaxis]
        contents.messages[int.from_bytes(body[:2], "little")].add(row)


def _decompress(chunk: Chunk, budget: Budget) -> bytes:
    budget.take_content(chunk.uncompressed_size)
    raw = decompress(chunk.compression, chunk.data, chunk.uncompressed_size)
    if chunk.uncompressed_crc not in (0, zlib.crc32(raw)):
        raise ValueError("its checksum is wrong")
    return raw


def _add_channel(contents: Contents, channel: Channel) -> None:
    known = contents.channels.setdefault(channel.id, channel)
    if (known.topic, known.message_encoding) != (channel.topic, channel.message_encoding):
        raise ChannelConflictError(
            f"channel {channel.id} is {printable_name(known.topic)}, and from here on "
            f"{printable_name(channel.topic)}: the file is joined from several"
        )


def _check_length(length: int) -> None:
    if length < _MESSAGE_HEAD:
        raise ValueError(f"expected a message of {_MESSAGE_HEAD} bytes or more, found one of {length}")


def _add_chunk(contents: Contents, raw: bytes, budget: Budget) -> None:
    places: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
    for opcode, start, length, channel in _iterate_records(raw):
        budget.take_record()
        if opcode == Opcode.MESSAGE:
            _check_length(length)
            places[channel].append((start, length))
        elif opcode != Opcode.CHUNK:  # chunks are not nested
            _add_record(contents, opcode, raw[start : start + length], budget)
    flat = np.frombuffer(raw, dtype=np.uint8)
    for channel, spans in places.items():
        starts, lengths = np.array(spans).T
        if (lengths == lengths[0]).all():
            rows: Any = sliding_window_view(flat, lengths[0])[starts]
            contents.messages[channel].add(rows)
        else:
            for start, length in spans:
                contents.messages[channel].add(flat[np.newaxis, start : start + length])


def _iterate_records(raw: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Opcode, start and length of the body, and first two bytes (a message's channel) of each record."""
    position, end = 0, len(raw)
    while position < end:
        # the last record may have a body shorter than two bytes
        head = raw[position : position + _MESSAGE_RECORD_HEAD.size].ljust(_MESSAGE_RECORD_HEAD.size, b"\0")
        opcode, length, channel = _MESSAGE_RECORD_HEAD.unpack(head)
        position += _RECORD_HEAD.size
        if opcode == 0 or length > end - position:
            raise ValueError("expected whole records in a chunk, found one that is not")
        yield opcode, position, length, channel
        position += length
