"""A foreign table with its rig file, and the signals that are read from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labhil.recording.formats.columns import Columns
from labhil.rig import RigFile
from labhil.signals import FloatArray, Signal
from labhil.terminal import printable_name

MAX_NAMES = 40
"""Number of columns that an error message lists."""


class MappedSignal(NamedTuple):
    """A signal with its columns, and the scale and offset of each."""

    signal: Signal
    columns: tuple[int, ...]
    scale: FloatArray
    offset: FloatArray

    def to_signal_unit(self, raw: FloatArray) -> FloatArray:
        """Convert raw values (rows, columns) to the signal's unit."""
        with np.errstate(over="ignore", invalid="ignore"):  # values that are not finite make bad rows
            return np.asarray(raw * self.scale + self.offset, dtype=np.float64)


SignalValues = Sequence[tuple[MappedSignal, FloatArray]]
"""Signals with their values (rows, columns)."""


@dataclass(frozen=True)
class Sheet:
    """A foreign file, its columns, and the rig file by which they are read."""

    path: Path
    columns: Columns
    rig: RigFile

    def available(self) -> str:
        """Columns of the file, for messages."""
        if self.columns.names is None:
            return f"no header and {self.columns.width} columns, 0 to {self.columns.width - 1}"
        names = self.columns.names
        more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
        skipped = f"; {self.columns.skipped}" if self.columns.skipped else ""
        return f"the columns {', '.join(map(printable_name, names[:MAX_NAMES]))}{more}{skipped}"

    def place(self, row: int) -> str:
        """Position of a row in the file, for messages."""
        return f"{self.columns.row_word} {self.columns.lines[row]}"

    def column(self, number: int) -> str:
        """Name of a column, for messages."""
        return str(number) if self.columns.names is None else repr(self.columns.names[number])

    def source(self, number: int) -> str:
        """Notation of a column in ``[channels]``."""
        if self.columns.names is None:
            return str(number)
        name = self.columns.names[number]
        return f'"{name}"' if self.columns.names.count(name) == 1 and '"' not in name else str(number)
