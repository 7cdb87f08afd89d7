"""Tables of any file format, column by column."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labhil.recording.formats.notation import Notation, is_missing
from labhil.recording.formats.time_text import TimeValues, parse_times
from labhil.recording.units import without_unit
from labhil.signals import FloatArray, Hold, IntArray


@dataclass(frozen=True)
class Columns(ABC):
    """A table of a foreign file.

    Attributes:
        names: names of the columns; None without a header.
        width: number of columns.
        lines: position of each row in the file, for messages, (rows,).
        counts: number of fields of each row, (rows,).
        row_word: what messages call a row.
    """

    names: tuple[str, ...] | None
    width: int
    lines: IntArray
    counts: IntArray

    row_word = "row"

    @property
    def complete(self) -> NDArray[np.bool_]:
        """Rows with the right number of fields, (rows,)."""
        complete: NDArray[np.bool_] = self.counts == self.width
        return complete

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about the choice of rows and columns, for users."""
        return ()

    @property
    def skipped(self) -> str:
        """Content of the file that is no column, and why, for messages; empty if there is none."""
        return ""

    @property
    def files(self) -> tuple[Path, ...]:
        """Files of a folder from which the columns were read; empty if from all of them."""
        return ()

    def find(self, name: str) -> tuple[int, ...]:
        """Find columns by name.

        Args:
            name: a name; ``Time`` and ``time`` match a column ``Time [ms]``, too, if none matches exactly.

        Returns:
            Numbers of the columns: none, one or several.
        """
        names = self.names or ()
        if indices := _indices(names, name):
            return indices
        bare = [without_unit(candidate) for candidate in names]
        return _indices(bare, name) or _indices([n.casefold() for n in bare], name.casefold())

    @property
    def units(self) -> tuple[str, ...]:
        """Texts of a line of units below the header, by column; empty if there is none."""
        return ()

    def times(self, column: int) -> TimeValues:
        """Times (rows,) in a column; dates and times of day in s."""
        return TimeValues(self.numbers(column))

    def missing(self, column: int) -> NDArray[np.bool_]:
        """Rows where a column has no value, (rows,): an empty cell or NaN, but no text that is no number."""
        return np.zeros(len(self.counts), dtype=np.bool_)

    def readable(self, column: int, notation: Notation) -> int:
        """Number of cells of a column that are numbers in another notation; 0 if the file has no notation."""
        return 0

    @abstractmethod
    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """Values of a column.

        Args:
            column: its number.
            hold: interpolation between samples that are not taken with the rows.

        Returns:
            Values (rows,); NaN where there is no number.
        """

    @abstractmethod
    def text(self, column: int, row: int) -> str:
        """Content of a cell, for messages."""


@dataclass(frozen=True)
class NumberColumns(Columns):
    """Columns that are numbers in the file already.

    Attributes:
        values: values of each column, (rows,).
        texts: cells of the columns that are text in the file, by column.
    """

    values: Sequence[FloatArray]
    texts: Mapping[int, Sequence[Any]] = field(default_factory=dict)

    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """Values (rows,) of a column."""
        return self.values[column]

    def times(self, column: int) -> TimeValues:
        """Times (rows,) in a column; dates and times of day in s."""
        return times_or_numbers(self.values[column], [cell_text(cell) for cell in self.texts.get(column, ())])

    def missing(self, column: int) -> NDArray[np.bool_]:
        """Rows where a column has no value, (rows,)."""
        missing = np.isnan(self.values[column])
        if column in self.texts:
            missing &= np.array([cell is None or is_missing(str(cell)) for cell in self.texts[column]])
        return missing

    def text(self, column: int, row: int) -> str:
        """Content of a cell, for messages."""
        if column in self.texts:
            return repr(self.texts[column][row])
        return f"{self.values[column][row]}"


def _indices(names: Sequence[str], wanted: str) -> tuple[int, ...]:
    return tuple(index for index, name in enumerate(names) if name == wanted)


def number_columns(
    names: Sequence[str], values: Sequence[FloatArray], texts: Mapping[int, Sequence[Any]] | None = None
) -> NumberColumns:
    """Make a table of names, values (rows,) and, for columns of text, cells."""
    rows = len(values[0])
    counts = np.full(rows, len(names))
    return NumberColumns(tuple(names), len(names), np.arange(1, rows + 1), counts, values, texts or {})


def times_or_numbers(numbers: FloatArray, texts: Sequence[str]) -> TimeValues:
    """Read a column of times: its numbers, or its texts if more of these are dates or times of day."""
    finite = int(np.count_nonzero(np.isfinite(numbers)))
    stamps = parse_times(texts) if finite < len(texts) else None
    if stamps is not None and np.count_nonzero(np.isfinite(stamps.values)) > finite:
        return stamps
    return TimeValues(numbers)


def cell_text(cell: Any) -> str:
    """Text of a cell; "" for other content."""
    return cell if isinstance(cell, str) else ""


def parse_cell(cell: Any, notation: Notation = Notation()) -> float:  # noqa: B008
    """Number of a cell: dates in s of Unix time, durations in s, NaN for anything else."""
    if isinstance(cell, (int, float)):
        return float(cell)
    if isinstance(cell, datetime):  # UTC without a zone, since it has no ambiguous hour
        return (cell if cell.tzinfo else cell.replace(tzinfo=UTC)).timestamp()
    if isinstance(cell, timedelta):
        return cell.total_seconds()
    if isinstance(cell, time):
        return 3600.0 * cell.hour + 60.0 * cell.minute + cell.second + 1e-6 * cell.microsecond
    return notation.number(str(cell))
