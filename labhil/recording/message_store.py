"""Messages one after another, as many as a file holds: the first in memory, the others on the disk."""

from __future__ import annotations

import mmap
import struct
import weakref
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO, overload

from labhil.recording.mapped import let_go, temporary_file, write_all

IN_MEMORY = 1 << 28
"""Bytes of messages (256 MiB) that are kept in memory; what comes after them goes to a temporary file."""

READS = 1 << 16
"""Messages that are read from the disk before their pages are let go."""

_HEAD = struct.Struct("<IIQQI")


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it stood in the file; times in ns (Unix)."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


def channels_of(messages: Sequence[Message]) -> Iterable[int]:
    """Return the channel of each message; of a store without a look at the messages."""
    return messages.channels if isinstance(messages, MessageStore) else (each.channel for each in messages)


class MessageStore(Sequence[Message]):
    """A sequence of messages that grows at its end.

    DiskFailedError where there is no room for them.
    """

    def __init__(self) -> None:
        self._places: array[int] = array("Q")
        self._channels: array[int] = array("I")
        self._memory = bytearray()
        self._file: BinaryIO | None = None
        self._mapped: mmap.mmap | None = None
        self._written = 0  # bytes in the file
        self._looked_at = 0

    def append(self, message: Message) -> None:
        """Add a message."""
        head = _HEAD.pack(
            message.channel, message.sequence, message.log_time, message.publish_time, len(message.data)
        )
        self._places.append(len(self._memory) + self._written)
        self._channels.append(message.channel)
        if len(self._memory) < IN_MEMORY:
            self._memory += head + message.data
            return
        if self._file is None:
            self._file = temporary_file()
            weakref.finalize(self, self._file.close)
        self._mapped = None
        write_all(self._file, head + message.data)
        self._written += len(head) + len(message.data)

    def pop(self, place: int) -> Message:
        """Take a message out."""
        message = self[place]
        self._places.pop(place)
        self._channels.pop(place)
        return message

    def __len__(self) -> int:
        return len(self._places)

    @property
    def channels(self) -> Sequence[int]:
        """The channel of each message, without a look at the message."""
        return self._channels

    @overload
    def __getitem__(self, place: int) -> Message: ...
    @overload
    def __getitem__(self, place: slice) -> list[Message]: ...
    def __getitem__(self, place: int | slice) -> Message | list[Message]:
        if isinstance(place, slice):
            return [self._at(position) for position in self._places[place]]
        return self._at(self._places[place])

    def __iter__(self) -> Iterator[Message]:
        return map(self._at, self._places)

    def _at(self, position: int) -> Message:
        held: bytearray | mmap.mmap = self._memory
        if position >= len(self._memory):
            held, position = self._on_disk(), position - len(self._memory)
            self._looked_at += 1
            if self._looked_at % READS == 0:
                let_go(held, len(held))
        channel, sequence, log_time, publish_time, length = _HEAD.unpack_from(held, position)
        start = position + _HEAD.size
        return Message(channel, sequence, log_time, publish_time, bytes(held[start : start + length]))

    def _on_disk(self) -> mmap.mmap:
        if self._mapped is None:
            assert self._file is not None, "no message lies beyond the memory before there is a file"
            self._file.flush()
            self._mapped = mmap.mmap(self._file.fileno(), self._written, access=mmap.ACCESS_READ)
        return self._mapped
