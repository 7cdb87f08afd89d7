"""A channel's converter: SI values to the whole numbers on the wire."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.link import ChannelScale
from labhil.serial_twin.firmware import Raw
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class Converter:
    """Whole numbers of ``bits`` bits for ``low`` … ``high`` (SI); what lies beyond is an end of the range."""

    low: float
    high: float
    bits: int

    @property
    def scale(self) -> ChannelScale:
        """What its numbers mean."""
        step = np.float32((self.high - self.low) / (1 << self.bits))
        return ChannelScale(float(step), float(np.rint(-self.low / step)))

    def raw(self, values: FloatArray) -> Raw:
        """Numbers (n,) of the values (n,)."""
        scale = self.scale
        counts = np.rint(values / scale.scale + scale.zero)
        return np.clip(counts, 0, (1 << self.bits) - 1).astype(np.uint16)


@dataclass(frozen=True, slots=True)
class Counter:
    """A counter of ``step`` (SI) that wraps at 16 bits, such as an encoder's."""

    step: float

    @property
    def scale(self) -> ChannelScale:
        """What its numbers mean."""
        return ChannelScale(float(np.float32(self.step)), 0.0)

    def raw(self, values: FloatArray) -> Raw:
        """Numbers (n,) of the values (n,); an encoder counts the edges that it has passed."""
        return (np.floor(values / self.scale.scale).astype(np.int64) % (1 << 16)).astype(np.uint16)


NOT_FITTED = ChannelScale(0.0, 0.0)
"""What HELLO says of a channel that the device has not."""
