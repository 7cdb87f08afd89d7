"""Samples of a device, as the check looks at them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labhil.experiment.bench import Bench
from labhil.signals import FloatArray, Signal, Stream


@dataclass(frozen=True, slots=True)
class Samples:
    """Samples of one stream: times ``t`` (n,) of the device's clock, s, and ``values`` (n, columns), SI."""

    stream: Stream
    t: FloatArray
    values: FloatArray

    @classmethod
    def received(cls, bench: Bench) -> Samples:
        """Take what a bench has received since the last call; does not wait."""
        stream = Stream("state", tuple(bench.signals.values()), bench.rate)
        return cls.of(stream, bench.received())

    @classmethod
    def of(cls, stream: Stream, columns: Mapping[str, FloatArray]) -> Samples:
        """Make samples of arrays by signal name, (n,) or (n, k), with ``t``."""
        t = columns["t"]
        arrays = [columns[signal.name].reshape(len(t), signal.width) for signal in stream.signals]
        return cls(stream, t, np.hstack(arrays))

    @classmethod
    def joined(cls, parts: Sequence[Samples]) -> Samples:
        """Join samples of the same stream, in their order."""
        t, values = [part.t for part in parts], [part.values for part in parts]
        return cls(parts[0].stream, np.concatenate(t), np.concatenate(values))

    def __len__(self) -> int:
        return len(self.t)

    def of_signal(self, signal: Signal) -> FloatArray:
        """The values of a signal, (n, width)."""
        return self.values[:, self.stream.columns_of(signal.name)]

    def column(self, name: str) -> FloatArray:
        """The values of a column, (n,)."""
        return self.values[:, self.stream.columns().index(name)]
