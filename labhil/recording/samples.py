"""Decoder of the samples of a file, block by block, so that any size of file fits into memory."""

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
"""Size of the values of a channel in memory, bytes (256 MiB); larger ones are in a temporary file."""


@dataclass(slots=True)
class _ChannelData:
    """Decoded samples of a channel; many values move from ``values`` to ``spool``."""

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
    """Decoder of the messages of a file while it is read."""

    def __init__(self) -> None:
        self._blocks: dict[int, _ChannelData] = {}
        self._invalid: set[int] = set()

    def decode(self, channel: Channel, messages: Messages) -> None:
        """Decode the messages of a channel read so far, and clear them; ignores foreign channels."""
        if "labhil.stream" not in channel.metadata or channel.id in self._invalid:
            return
        try:
            self._decode(channel, messages)
        except (ProtocolError, ValueError):
            self._invalid.add(channel.id)  # :meth:`batch` raises the error again, for a message with the file

    def batch(self, channel: Channel, messages: Messages) -> Batch:
        """All samples of a channel; ProtocolError or ValueError if they do not match its stream."""
        self._decode(channel, messages)
        return self._blocks.pop(channel.id).batch()

    def _decode(self, channel: Channel, messages: Messages) -> None:
        blocks = self._blocks.get(channel.id)
        if blocks is None:
            blocks = _ChannelData(Codec(stream_from_json(channel.metadata["labhil.stream"])))
            self._blocks[channel.id] = blocks
        rows = messages.rows(blocks.codec.size)
        decode = blocks.codec.decode(messages.payloads()) if rows is None else blocks.codec.decode_rows(rows)
        blocks.add(decode)
        messages.clear()
