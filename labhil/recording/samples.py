"""The samples of a file's channels, decoded block by block while it is read, so that no file is too large."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from mcap.records import Channel

from labhil.codec import Codec, stream_from_json
from labhil.errors import ProtocolError
from labhil.recording.chunks import Messages
from labhil.recording.memory_maps import Spool
from labhil.signals import Batch, FloatArray, IntArray

MAX_BYTES_IN_MEMORY = 1 << 28
"""Bytes of values (256 MiB) of one channel that are kept in memory; more go to a temporary file."""


@dataclass(slots=True)
class _Blocks:
    """What has been decoded of one channel; values stand in ``values`` until they are too many."""

    codec: Codec
    stamps: list[tuple[IntArray, IntArray, IntArray]] = field(default_factory=list)
    values: list[FloatArray] = field(default_factory=list)
    size: int = 0
    spool: Spool | None = None

    def add(self, batch: Batch) -> None:
        self.stamps.append((batch.seq, batch.t_acq_ns, batch.t_hw_ns))
        self.values.append(batch.values)
        self.size += batch.values.nbytes
        if self.size > MAX_BYTES_IN_MEMORY:
            self.spool = Spool(batch.values.shape[1]) if self.spool is None else self.spool
            for values in self.values:
                self.spool.add(values)
            self.values.clear()

    def batch(self) -> Batch:
        seq, t_acq_ns, t_hw_ns = (np.concatenate(column) for column in zip(*self.stamps, strict=True))
        values = np.concatenate(self.values) if self.spool is None else self.spool.finish()
        return Batch(seq, t_acq_ns, t_hw_ns, values)


class Samples:
    """Decodes messages as they come; used by one reading of one file."""

    def __init__(self) -> None:
        self._blocks: dict[int, _Blocks] = {}
        self._refused: set[int] = set()

    def take(self, channel: Channel, messages: Messages) -> None:
        """Decode what has been read of a channel so far, and keep only that; channels of others stay."""
        if "labhil.stream" not in channel.metadata or channel.id in self._refused:
            return
        try:
            self._decode(channel, messages)
        except (ProtocolError, ValueError):
            self._refused.add(channel.id)  # :meth:`batch` raises it again, where it is known which file it is

    def batch(self, channel: Channel, messages: Messages) -> Batch:
        """Return all samples of a channel; ProtocolError or ValueError where they are none of its stream."""
        self._decode(channel, messages)
        return self._blocks.pop(channel.id).batch()

    def _decode(self, channel: Channel, messages: Messages) -> None:
        blocks = self._blocks.get(channel.id)
        if blocks is None:
            blocks = _Blocks(Codec(stream_from_json(channel.metadata["labhil.stream"])))
            self._blocks[channel.id] = blocks
        rows = messages.rows(blocks.codec.size)
        decode = blocks.codec.decode(messages.payloads()) if rows is None else blocks.codec.decode_rows(rows)
        blocks.add(decode)
        messages.forget()
