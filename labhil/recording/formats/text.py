"""Reader of text tables with any extension, among them logs of RTDE recorders."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labhil.errors import TableError
from labhil.recording.formats.columns import Columns, times_or_numbers
from labhil.recording.formats.notation import Notation, is_missing
from labhil.recording.formats.time_text import TimeValues, is_time
from labhil.recording.units import is_units_line
from labhil.rig_sections import Table
from labhil.signals import FloatArray, Hold, IntArray

DELIMITERS: Mapping[str, str | None] = {"comma": ",", "semicolon": ";", "tab": "\t", "whitespace": None}
SAMPLE_LINES = 50
"""Lines by which the delimiter is chosen."""

QUOTED = re.compile(r'"[^"]*"')
QUOTED_NUMBER = re.compile(r'"[^",]*\d[.,\' ]\d[^"]*"')
"""A quoted number with a decimal mark or a separator of thousands."""


@dataclass(frozen=True)
class TextColumns(Columns):
    """Columns of a text file, whose fields are parsed when a column is read.

    Attributes:
        rows: fields of each row.
        notation: notation of numbers.
        units: texts of a line of units.
    """

    rows: Sequence[Sequence[str]]
    notation: Notation
    units: tuple[str, ...] = ()

    row_word = "line"

    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """Values (rows,) of a column; NaN where there is no number."""
        return self.notation.numbers(self._texts(column))

    def times(self, column: int) -> TimeValues:
        """Times (rows,) in a column; dates and times of day in s."""
        texts = self._texts(column)
        return times_or_numbers(self.notation.numbers(texts), texts)

    def missing(self, column: int) -> NDArray[np.bool_]:
        """Rows with the right number of fields where a column has no value, (rows,)."""
        missing = np.array([is_missing(text) for text in self._texts(column)], dtype=np.bool_)
        return missing & self.complete

    def readable(self, column: int, notation: Notation) -> int:
        """Number of cells of a column that are numbers in another notation."""
        return int(np.count_nonzero(np.isfinite(notation.numbers(self._texts(column)))))

    def text(self, column: int, row: int) -> str:
        """Content of a cell, for messages."""
        fields = self.rows[row]
        return repr(fields[column].strip()) if column < len(fields) else "nothing"

    def _texts(self, column: int) -> list[str]:
        return [
            row[column] if good else "" for row, good in zip(self.rows, self.complete.tolist(), strict=True)
        ]


def read_text(path: Path, data: bytes, table: Table, wanted: Collection[str]) -> TextColumns:
    """Read a text table separated by commas, semicolons, tabs or blanks.

    Args:
        path: the file, for messages and its extension.
        data: its content.
        table: section ``[table]`` of the rig file.
        wanted: names of columns, by which a header is recognised.

    Returns:
        The table.

    Raises:
        TableError: The file has no rows, or is no text.
    """
    return _read_text(path, _decode(path, data), table, wanted)


def _decode(path: Path, data: bytes) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    if b"\x00" in data:
        raise TableError(f"{path}: expected a text table or a MAT file, found a binary file")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _read_text(path: Path, text: str, table: Table, wanted: Collection[str]) -> TextColumns:
    lines, texts = _data_lines(text, table)
    if not texts:
        raise TableError(f"{path}: expected a table, found no rows (after skip_rows = {table.skip_rows})")
    delimiter = DELIMITERS[table.delimiter or _find_delimiter(path, texts, table)]
    _refuse_ambiguous_marks(path, texts, delimiter, table)
    try:
        rows = [_split(line, delimiter) for line in texts]
    except csv.Error as error:
        raise TableError(f"{path}: expected a table, found a field that cannot be read: {error}") from error
    names, units = None, tuple[str, ...]()
    if _has_header(rows[0], table, wanted):
        names = tuple(field.strip().strip("\"'") for field in rows[0])
        rows, lines = rows[1:], lines[1:]
        if rows and len(rows[0]) == len(names) and is_units_line(rows[0]):
            units = tuple(rows[0])
            rows, lines = rows[1:], lines[1:]
    counts = np.array([len(row) for row in rows], dtype=np.int64)
    width = len(names) if names is not None else int(np.bincount(counts).argmax())
    if not (counts == width).any():
        actual = f"{counts[0]} fields in line {lines[0]}" if len(rows) else "no rows below it"
        raise TableError(f"{path}: expected {width} fields a row, as in its header, found {actual}")
    return TextColumns(names, width, lines, counts, rows, Notation.of(table), units)


def _refuse_ambiguous_marks(path: Path, lines: Sequence[str], delimiter: str | None, table: Table) -> None:
    """Raise TableError if a mark in numbers is also the delimiter, and no number is quoted."""
    for key, mark in (("decimal", table.decimal), ("thousands", table.thousands)):
        is_delimiter = mark is not None and (mark == delimiter or (mark == " " and delimiter is None))
        if is_delimiter and not any(map(QUOTED_NUMBER.search, lines)):
            raise TableError(
                f"{path}: [table] delimiter and {key} are both {mark!r}; they must differ, "
                f"or numbers with {mark!r} must stand in quotation marks"
            )


def _data_lines(text: str, table: Table) -> tuple[IntArray, list[str]]:
    """Lines with their numbers from 1, (n,), without skipped, blank and comment lines."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")[table.skip_rows :]
    if table.comment:
        lines = [line.split(table.comment, 1)[0] for line in lines]
    full = np.fromiter((bool(line) and not line.isspace() for line in lines), np.bool_, len(lines))
    return np.flatnonzero(full).astype(np.int64) + 1 + table.skip_rows, list(compress(lines, full))


def _find_delimiter(path: Path, lines: Sequence[str], table: Table) -> str:
    """Choose the delimiter by the extension and by the lines, without quoted text.

    The first one of semicolon, comma, tab and blanks counts that splits the first line into as many fields
    as most others. That line may be a header, which has no decimal commas.
    """
    if path.suffix.lower() in {".tsv", ".tab"}:
        return "tab"
    quoted = any(map(QUOTED_NUMBER.search, lines[:SAMPLE_LINES]))
    sample = [QUOTED.sub("q", line).strip(" ") for line in lines[:SAMPLE_LINES]]
    names = [name for name in DELIMITERS if name != "comma" or table.decimal == "." or quoted]
    most_frequent: dict[str, int] = {}
    for name in names:
        counts = Counter(len(line.split(DELIMITERS[name])) for line in sample)
        most_frequent[name] = counts.most_common(1)[0][0]
        if (
            most_frequent[name] > 1
            and len(sample[0].split(DELIMITERS[name])) == most_frequent[name]
            and (name != "whitespace" or counts[most_frequent[name]] == len(sample))
        ):
            return name
    for name in ("semicolon", "comma"):
        if most_frequent.get(name, 1) > 1:
            return name
    return "tab" if _regularity(sample, "\t") > _regularity(sample, None) else "whitespace"


def _regularity(lines: Sequence[str], delimiter: str | None) -> float:
    """Fraction of the lines with the most frequent number of fields; 0 if that is one field."""
    counts = Counter(len(line.split(delimiter)) for line in lines)
    fields, frequency = counts.most_common(1)[0]
    return frequency / len(lines) if fields > 1 else 0.0


def _split(line: str, delimiter: str | None) -> tuple[str, ...]:
    """Fields of a line, as a tuple: a list from ``split`` has room for twelve."""
    if delimiter is not None and '"' in line:
        return tuple(next(csv.reader([line], delimiter=delimiter, skipinitialspace=True)))
    return tuple(line.split(delimiter))


def _has_header(fields: Sequence[str], table: Table, wanted: Collection[str]) -> bool:
    if table.header is not None:
        return table.header
    names = [field.strip().strip("\"'") for field in fields]
    if not set(names).isdisjoint(wanted):
        return True
    notation = Notation.of(table)
    return all(np.isnan(notation.number(name)) and not is_time(name) for name in names if name)
