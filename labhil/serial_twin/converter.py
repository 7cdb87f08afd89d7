"""A channel's converter: SI values to the whole numbers on the wire."""

from __future__ import annotations

import numpy as np

from labhil.link import ChannelScale
from labhil.serial_twin.firmware import Raw
from labhil.signals import FloatArray


class Converter:
    """Whole numbers of ``bits`` bits for ``low`` … ``high`` (SI); what lies beyond is an end of the range.

    ``scale`` says what its numbers mean.
    """

    def __init__(self, low: float, high: float, bits: int) -> None:
        step = np.float32((high - low) / (1 << bits))
        self.scale = ChannelScale(float(step), float(np.rint(-low / step)))
        self._last = (1 << bits) - 1

    def raw(self, values: FloatArray) -> Raw:
        """Numbers (n,) of the values (n,)."""
        counts = np.rint(values / self.scale.scale + self.scale.zero)
        return np.minimum(np.maximum(counts, 0.0), self._last).astype(np.uint16)


class Counter:
    """A counter of ``step`` (SI) that wraps at 16 bits, such as an encoder's."""

    def __init__(self, step: float) -> None:
        self.scale = ChannelScale(float(np.float32(step)), 0.0)

    def raw(self, values: FloatArray) -> Raw:
        """Numbers (n,) of the values (n,); an encoder counts the edges that it has passed."""
        return (np.floor(values / self.scale.scale).astype(np.int64) % (1 << 16)).astype(np.uint16)


NOT_FITTED = ChannelScale(0.0, 0.0)
"""What HELLO says of a channel that the device has not."""
