"""Tables that are text, of any extension, among them the logs of UR's own and others' RTDE recorders."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labhil.errors import TableError
from labhil.recording.formats.columns import Columns
from labhil.rig import Table
from labhil.signals import FloatArray, Hold

DELIMITERS: Mapping[str, str | None] = {"comma": ",", "semicolon": ";", "tab": "\t", "whitespace": None}
SAMPLE_LINES = 50


@dataclass(frozen=True)
class TextColumns(Columns):
    """Columns of a text file; the rows are kept as fields of text until a column is asked for."""

    rows: Sequence[Sequence[str]]
    decimal: str

    row_word = "line"

    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """The values of a column, shape (rows,); NaN where there is no number."""
        texts = [
            row[column] if good else "" for row, good in zip(self.rows, self.complete.tolist(), strict=True)
        ]
        if self.decimal != ".":
            texts = [text.replace(self.decimal, ".") for text in texts]
        try:
            return np.array(list(map(float, texts)), dtype=np.float64)
        except ValueError:
            return np.array([_number(text) for text in texts], dtype=np.float64)

    def text(self, column: int, row: int) -> str:
        """What stands there, for messages."""
        fields = self.rows[row]
        return repr(fields[column].strip()) if column < len(fields) else "nothing"


def read_text(path: Path, data: bytes, table: Table, wanted: Collection[str]) -> TextColumns:
    """Read a table that is text: separated by commas, semicolons, tabs or blanks.

    ``wanted`` are the column names that the rig file asks for: they help to tell a header from data.
    TableError when there are no rows in it, or it is no text.
    """
    return _read_text(path, _decoded(path, data), table, wanted)


def _decoded(path: Path, data: bytes) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    if b"\x00" in data:
        raise TableError(f"{path}: expected a text table or a MAT file, found a binary file")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _read_text(path: Path, text: str, table: Table, wanted: Collection[str]) -> TextColumns:
    numbered = _lines(text, table)
    if not numbered:
        raise TableError(f"{path}: expected a table, found no rows (after skip_rows = {table.skip_rows})")
    delimiter = DELIMITERS[table.delimiter or _delimiter(path, [line for _, line in numbered], table)]
    if delimiter == table.decimal:
        raise TableError(f"{path}: [table] delimiter and decimal are both {delimiter!r}; they must differ")
    rows = [_split(line, delimiter) for _, line in numbered]
    lines = np.array([number for number, _ in numbered], dtype=np.int64)
    names = None
    if _has_header(rows[0], table, wanted):
        names = tuple(field.strip().strip("\"'") for field in rows[0])
        rows, lines = rows[1:], lines[1:]
    counts = np.array([len(row) for row in rows], dtype=np.int64)
    width = len(names) if names is not None else int(np.bincount(counts).argmax())
    if not (counts == width).any():
        found = f"{counts[0]} fields in line {lines[0]}" if len(rows) else "no rows below it"
        raise TableError(f"{path}: expected {width} fields a row, as in its header, found {found}")
    return TextColumns(names, width, lines, counts, rows, table.decimal)


def _lines(text: str, table: Table) -> list[tuple[int, str]]:
    """Lines with their numbers from 1, without skipped, blank and comment lines."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    numbered = list(enumerate(lines, start=1))[table.skip_rows :]
    if table.comment:
        numbered = [(number, line.split(table.comment, 1)[0]) for number, line in numbered]
    return [(number, line) for number, line in numbered if line and not line.isspace()]


def _delimiter(path: Path, lines: Sequence[str], table: Table) -> str:
    """Tell the delimiter by the extension, and by what the lines hold."""
    sample = lines[:SAMPLE_LINES]
    if path.suffix.lower() in {".tsv", ".tab"}:
        return "tab"
    candidates = ("semicolon", "comma") if table.decimal == "." else ("semicolon",)
    for name in candidates:
        if np.median([line.count(str(DELIMITERS[name])) for line in sample]) >= 1:
            return name
    if _agreement(sample, "\t") > _agreement(sample, None):
        return "tab"
    return "whitespace"


def _agreement(lines: Sequence[str], delimiter: str | None) -> float:
    """The share of lines that have the most frequent number of fields, if that is more than one."""
    counts = Counter(len(line.split(delimiter)) for line in lines)
    fields, frequency = counts.most_common(1)[0]
    return frequency / len(lines) if fields > 1 else 0.0


def _split(line: str, delimiter: str | None) -> list[str]:
    if delimiter is not None and '"' in line:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    return line.split(delimiter)


def _has_header(fields: Sequence[str], table: Table, wanted: Collection[str]) -> bool:
    if table.header is not None:
        return table.header
    names = [field.strip().strip("\"'") for field in fields]
    if not set(names).isdisjoint(wanted):
        return True
    numbers = [_number(name.replace(table.decimal, ".")) for name in names if name]
    return bool(np.isnan(numbers).all())


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
