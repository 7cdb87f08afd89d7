"""What a table is, whatever file it stood in."""

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
from labhil.recording.formats.time_text import Stamps, stamps_of
from labhil.recording.units import without_unit
from labhil.signals import FloatArray, Hold, IntArray


@dataclass(frozen=True)
class Columns(ABC):
    """A table of others: ``names`` of its columns (None without a header) and how many there are.

    ``lines`` (rows,) says where each row stands, for messages; ``counts`` (rows,) how many fields it has.
    """

    names: tuple[str, ...] | None
    width: int
    lines: IntArray
    counts: IntArray

    row_word = "row"
    """What a row is called in messages."""

    @property
    def complete(self) -> NDArray[np.bool_]:
        """Which rows have the right number of fields, shape (rows,)."""
        complete: NDArray[np.bool_] = self.counts == self.width
        return complete

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know of how the rows came to be, a line each."""
        return ()

    @property
    def left_out(self) -> str:
        """What is in the file and is no column, with why, for messages; empty where that cannot be."""
        return ""

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of a folder that the columns came from; empty where all in it count."""
        return ()

    def find(self, source: str) -> tuple[int, ...]:
        """The numbers of the columns that bear this name: none, one or several.

        A column ``Time [ms]`` is found as ``Time``, too, and as ``time`` where none bears that name exactly.
        """
        names = self.names or ()
        if places := _places(names, source):
            return places
        bare = [without_unit(name) for name in names]
        return _places(bare, source) or _places([n.casefold() for n in bare], source.casefold())

    @property
    def units(self) -> tuple[str, ...]:
        """The texts of a line of units below the header, one for each column; empty where there is none."""
        return ()

    def times(self, column: int) -> Stamps:
        """The values of a column that holds the time, shape (rows,); dates and times of day in s."""
        return Stamps(self.numbers(column))

    def missing(self, column: int) -> NDArray[np.bool_]:
        """Where a column has no value at all (an empty cell, no text that is no number), shape (rows,)."""
        return np.zeros(len(self.counts), dtype=np.bool_)

    def readable(self, column: int, notation: Notation) -> int:
        """How many cells of a column would be numbers in another notation; 0 where the file knows none."""
        return 0

    @abstractmethod
    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """The values of a column, shape (rows,); NaN where there is no number.

        ``hold`` says what the signal does between its samples, where they do not come with the rows.
        """

    @abstractmethod
    def text(self, column: int, row: int) -> str:
        """What stands there, for messages."""


@dataclass(frozen=True)
class NumberColumns(Columns):
    """Columns that are numbers in the file already: ``values`` holds one array of shape (rows,) for each."""

    values: Sequence[FloatArray]
    texts: Mapping[int, Sequence[Any]] = field(default_factory=dict)
    """What stands in the columns that are text in the file, by their number."""

    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """The values of a column, shape (rows,); NaN where there is no number."""
        return self.values[column]

    def times(self, column: int) -> Stamps:
        """The values of a column that holds the time, shape (rows,); dates and times of day in s."""
        return read_stamps(self.values[column], [cell_text(cell) for cell in self.texts.get(column, ())])

    def missing(self, column: int) -> NDArray[np.bool_]:
        """Where a column has no value at all, shape (rows,)."""
        missing = np.isnan(self.values[column])
        if column in self.texts:
            missing &= np.array([cell is None or is_missing(str(cell)) for cell in self.texts[column]])
        return missing

    def text(self, column: int, row: int) -> str:
        """What stands there, for messages."""
        if column in self.texts:
            return repr(self.texts[column][row])
        return f"{self.values[column][row]}"


def _places(names: Sequence[str], wanted: str) -> tuple[int, ...]:
    return tuple(place for place, name in enumerate(names) if name == wanted)


def number_columns(
    names: Sequence[str], values: Sequence[FloatArray], texts: Mapping[int, Sequence[Any]] | None = None
) -> NumberColumns:
    """A table with a name and an array of shape (rows,) for each column."""
    rows = len(values[0])
    counts = np.full(rows, len(names))
    return NumberColumns(tuple(names), len(names), np.arange(1, rows + 1), counts, values, texts or {})


def read_stamps(numbers: FloatArray, texts: Sequence[str]) -> Stamps:
    """The times of a column: its numbers, or its texts where more of these are dates or times of day."""
    finite = int(np.count_nonzero(np.isfinite(numbers)))
    stamps = stamps_of(texts) if finite < len(texts) else None
    if stamps is not None and np.count_nonzero(np.isfinite(stamps.values)) > finite:
        return stamps
    return Stamps(numbers)


def cell_text(cell: Any) -> str:
    """The text in a cell, "" where it holds something else."""
    return cell if isinstance(cell, str) else ""


def number_of(cell: Any, notation: Notation = Notation()) -> float:  # noqa: B008
    """The number that a cell means: NaN for what is none; a date in s of Unix time, a duration in s."""
    if isinstance(cell, (int, float)):
        return float(cell)
    if isinstance(cell, datetime):  # without a zone it is taken for UTC, which has no hour twice
        return (cell if cell.tzinfo else cell.replace(tzinfo=UTC)).timestamp()
    if isinstance(cell, timedelta):
        return cell.total_seconds()
    if isinstance(cell, time):
        return 3600.0 * cell.hour + 60.0 * cell.minute + cell.second + 1e-6 * cell.microsecond
    return notation.number(str(cell))
