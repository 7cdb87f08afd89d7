"""Storage of any number of messages, the first in memory, the others on the disk."""

from __future__ import annotations

import mmap
import struct
import weakref
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO, overload

from labhil.recording.memory_maps import release_pages, temporary_file, write_all

MAX_BYTES_IN_MEMORY = 1 << 28
"""Size of the messages in memory, bytes (256 MiB); further ones are in a temporary file."""

READS_PER_RELEASE = 1 << 16
"""Messages read from the disk after which its pages are released."""

_HEAD = struct.Struct("<IIQQI")


@dataclass(frozen=True, slots=True)
class Message:
    """A message of an MCAP file; times in ns of Unix time."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


def channels_of(messages: Sequence[Message]) -> Iterable[int]:
    """Return the channel of each message; of a store without a look at the messages."""
    return messages.channels if isinstance(messages, MessageStore) else (each.channel for each in messages)


class MessageStore(Sequence[Message]):
    """A sequence of messages with ``append``, which raises DiskFailedError if the disk is full."""

    def __init__(self) -> None:
        self._positions: array[int] = array("Q")
        self._channels: array[int] = array("I")
        self._memory = bytearray()
        self._file: BinaryIO | None = None
        self._mapped: mmap.mmap | None = None
        self._written = 0  # bytes in the file
        self._n_reads = 0

    def append(self, message: Message) -> None:
        """Add a message."""
        head = _HEAD.pack(
            message.channel, message.sequence, message.log_time, message.publish_time, len(message.data)
        )
        self._positions.append(len(self._memory) + self._written)
        self._channels.append(message.channel)
        if len(self._memory) < MAX_BYTES_IN_MEMORY:
            self._memory += head + message.data
            return
        if self._file is None:
            self._file = temporary_file()
            weakref.finalize(self, self._file.close)
        self._mapped = None
        write_all(self._file, head + message.data)
        self._written += len(head) + len(message.data)

    def pop(self, index: int) -> Message:
        """Remove a message and return it."""
        message = self[index]
        self._positions.pop(index)
        self._channels.pop(index)
        return message

    def __len__(self) -> int:
        return len(self._positions)

    @property
    def channels(self) -> Sequence[int]:
        """The channel of each message, without a look at the message."""
        return self._channels

    @overload
    def __getitem__(self, index: int) -> Message: ...
    @overload
    def __getitem__(self, index: slice) -> list[Message]: ...
    def __getitem__(self, index: int | slice) -> Message | list[Message]:
        if isinstance(index, slice):
            return [self._read(position) for position in self._positions[index]]
        return self._read(self._positions[index])

    def __iter__(self) -> Iterator[Message]:
        return map(self._read, self._positions)

    def _read(self, position: int) -> Message:
        buffer: bytearray | mmap.mmap = self._memory
        if position >= len(self._memory):
            buffer, position = self._on_disk(), position - len(self._memory)
            self._n_reads += 1
            if self._n_reads % READS_PER_RELEASE == 0:
                release_pages(buffer, len(buffer))
        channel, sequence, log_time, publish_time, length = _HEAD.unpack_from(buffer, position)
        start = position + _HEAD.size
        return Message(channel, sequence, log_time, publish_time, bytes(buffer[start : start + length]))

    def _on_disk(self) -> mmap.mmap:
        if self._mapped is None:
            assert self._file is not None, "no message lies beyond the memory before there is a file"
            self._file.flush()
            self._mapped = mmap.mmap(self._file.fileno(), self._written, access=mmap.ACCESS_READ)
        return self._mapped
