"""A file of others with its columns and its rig file, for those who read it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labhil.recording.formats.columns import Columns
from labhil.rig import RigFile
from labhil.signals import FloatArray, Signal
from labhil.terminal import printable_name

MAX_NAMES = 40
"""Columns that a message lists."""


class MappedSignal(NamedTuple):
    """A signal and the columns it is made of, each with its scale and offset."""

    signal: Signal
    columns: tuple[int, ...]
    scale: FloatArray
    offset: FloatArray

    def to_signal_unit(self, raw: FloatArray) -> FloatArray:
        """Raw values (rows, columns) in the signal's unit."""
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite makes a bad row
            return np.asarray(raw * self.scale + self.offset, dtype=np.float64)


@dataclass(frozen=True)
class Sheet:
    """A file, its columns, and the rig file that says how to read them."""

    path: Path
    columns: Columns
    rig: RigFile

    def available(self) -> str:
        """What columns there are, for messages."""
        if self.columns.names is None:
            return f"no header and {self.columns.width} columns, 0 to {self.columns.width - 1}"
        names = self.columns.names
        more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
        skipped = f"; {self.columns.skipped}" if self.columns.skipped else ""
        return f"the columns {', '.join(map(printable_name, names[:MAX_NAMES]))}{more}{skipped}"

    def place(self, row: int) -> str:
        """Where a row stands in its file, for messages."""
        return f"{self.columns.row_word} {self.columns.lines[row]}"

    def line(self, row: int) -> str:
        """Where a row stands, with the file, for messages."""
        return f"{self.path}, {self.place(row)}"

    def column(self, number: int) -> str:
        """What a column is called, for messages."""
        return str(number) if self.columns.names is None else repr(self.columns.names[number])

    def source(self, number: int) -> str:
        """A column as it is written in ``[channels]``."""
        if self.columns.names is None:
            return str(number)
        name = self.columns.names[number]
        return f'"{name}"' if self.columns.names.count(name) == 1 and '"' not in name else str(number)
