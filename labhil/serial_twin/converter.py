"""Converters of a simulated device: SI values to the raw numbers of a channel."""

from __future__ import annotations

import numpy as np

from labhil.link import ChannelScale
from labhil.serial_twin.firmware import Raw
from labhil.signals import FloatArray


class Converter:
    """An analogue-to-digital converter that clips to its range.

    Args:
        low: Lower end of the range, SI.
        high: Upper end of the range, SI.
        bits: Resolution.
    """

    def __init__(self, low: float, high: float, bits: int) -> None:
        step = np.float32((high - low) / (1 << bits))
        self.scale = ChannelScale(float(step), float(np.rint(-low / step)))
        self._last = (1 << bits) - 1

    def raw(self, values: FloatArray) -> Raw:
        """Return the raw numbers (n,) of SI values (n,)."""
        counts = np.rint(values / self.scale.scale + self.scale.zero)
        return np.minimum(np.maximum(counts, 0.0), self._last).astype(np.uint16)


class Counter:
    """A counter that wraps at 16 bits, such as that of an encoder; ``step`` is one count, SI."""

    def __init__(self, step: float) -> None:
        self.scale = ChannelScale(float(np.float32(step)), 0.0)

    def raw(self, values: FloatArray) -> Raw:
        """Return the raw numbers (n,) of SI values (n,); an encoder counts the edges that it has passed."""
        return (np.floor(values / self.scale.scale).astype(np.int64) % (1 << 16)).astype(np.uint16)


NOT_FITTED = ChannelScale(0.0, 0.0)
"""The scale that HELLO gives for a channel that is not fitted."""
