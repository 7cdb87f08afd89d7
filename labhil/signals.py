"""A signal is declared once; wire, file, rig files, plots and model inputs all derive from that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Direction(StrEnum):
    """Which way a signal goes, seen from the plant."""

    INPUT = "input"
    """What acts on the plant: the command in effect at the device at that device time."""
    OUTPUT = "output"
    """What is measured."""
    REQUESTED = "requested"
    """What was requested, before limits were applied."""
    STATUS = "status"
    """Anything else a device says about itself."""


class Hold(StrEnum):
    """What a signal does between two samples."""

    LINEAR = "linear"
    """It moves along the straight line."""
    ZERO = "zero"
    """It keeps the value of the earlier sample."""


@dataclass(frozen=True, slots=True)
class Signal:
    """One quantity with its name and SI unit; ``width`` > 1 for a vector such as six joints."""

    name: str
    unit: str
    direction: Direction
    width: int = 1
    hold: Hold = Hold.LINEAR
    description: str = ""

    def columns(self) -> tuple[str, ...]:
        """Names of the scalar columns: ``actual_q_0`` … ``actual_q_5`` for a vector of six."""
        if self.width == 1:
            return (self.name,)
        return tuple(f"{self.name}_{i}" for i in range(self.width))

    def to_json(self) -> dict[str, Any]:
        """Return the declaration as plain JSON data."""
        return {
            "name": self.name,
            "unit": self.unit,
            "direction": self.direction.value,
            "width": self.width,
            "hold": self.hold.value,
            "description": self.description,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Signal:
        """Read what :meth:`to_json` wrote."""
        return cls(
            name=str(data["name"]),
            unit=str(data["unit"]),
            direction=Direction(data["direction"]),
            width=int(data.get("width", 1)),
            hold=Hold(data.get("hold", "linear")),
            description=str(data.get("description", "")),
        )


@dataclass(frozen=True, slots=True)
class Stream:
    """Signals that are sampled together, with their nominal rate in Hz (of the device's own clock)."""

    name: str
    signals: tuple[Signal, ...]
    rate: float

    @property
    def width(self) -> int:
        """Number of scalar columns."""
        return sum(signal.width for signal in self.signals)

    def columns(self) -> tuple[str, ...]:
        """Names of all scalar columns, in order."""
        return tuple(column for signal in self.signals for column in signal.columns())

    def names(self) -> tuple[str, ...]:
        """Names of the signals, in order."""
        return tuple(signal.name for signal in self.signals)

    def columns_of(self, name: str) -> slice:
        """Where the signal ``name`` stands among the columns; KeyError when it is not here."""
        start = 0
        for signal in self.signals:
            if signal.name == name:
                return slice(start, start + signal.width)
            start += signal.width
        raise KeyError(name)


@dataclass(frozen=True, slots=True)
class Batch:
    """Samples of one stream, oldest first.

    ``seq`` counts what the device sent (lost samples leave a hole), ``t_hw_ns`` is the device's own
    clock (unwrapped, arbitrary zero), ``t_acq_ns`` the host's Unix time at acquisition; all int64 of
    shape (n,). ``values`` has shape (n, stream.width), SI units.
    """

    seq: IntArray
    t_acq_ns: IntArray
    t_hw_ns: IntArray
    values: FloatArray

    def __len__(self) -> int:
        return len(self.seq)

    @classmethod
    def empty(cls, width: int) -> Batch:
        """No samples at all."""
        none = np.empty(0, dtype=np.int64)
        return cls(none, none, none, np.empty((0, width)))

    @classmethod
    def of(cls, rows: Sequence[tuple[int, int, int, Sequence[float]]], width: int) -> Batch:
        """Build from rows of (seq, t_acq_ns, t_hw_ns, values)."""
        if not rows:
            return cls.empty(width)
        seq, t_acq, t_hw, values = zip(*rows, strict=True)
        return cls(
            np.array(seq, dtype=np.int64),
            np.array(t_acq, dtype=np.int64),
            np.array(t_hw, dtype=np.int64),
            np.array(values, dtype=np.float64).reshape(len(rows), width),
        )

    @classmethod
    def joined(cls, batches: Sequence[Batch], width: int) -> Batch:
        """One batch of several of the same stream, in their order."""
        if len(batches) == 1:
            return batches[0]
        if not batches:
            return cls.empty(width)
        return cls(
            np.concatenate([batch.seq for batch in batches]),
            np.concatenate([batch.t_acq_ns for batch in batches]),
            np.concatenate([batch.t_hw_ns for batch in batches]),
            np.concatenate([batch.values for batch in batches]),
        )
