"""The files of others as columns of numbers: text of any extension, and MAT."""

from __future__ import annotations

import csv
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labhil.errors import TableError
from labhil.rig import Table
from labhil.signals import FloatArray, IntArray

DELIMITERS: Mapping[str, str | None] = {"comma": ",", "semicolon": ";", "tab": "\t", "whitespace": None}
SAMPLE_LINES = 50

BINARY = {
    b"\x89MCAP": "an MCAP recording, which needs no import",
    b"PAR1": "a Parquet file",
    b"PK\x03\x04": "an XLSX or other zipped file",
    b"\x89HDF": "an HDF5 file (MATLAB 7.3: save with '-v7' instead)",
    b"SQLite": "an SQLite database (a ROS 2 bag?)",
}


@dataclass(frozen=True)
class Columns(ABC):
    """A table of others: ``names`` of its columns (None without a header) and how many there are.

    ``lines`` (rows,) says where each row stands, for messages; ``counts`` (rows,) how many fields it has.
    """

    names: tuple[str, ...] | None
    width: int
    lines: IntArray
    counts: IntArray

    @property
    def complete(self) -> NDArray[np.bool_]:
        """Which rows have the right number of fields, shape (rows,)."""
        complete: NDArray[np.bool_] = self.counts == self.width
        return complete

    @abstractmethod
    def numbers(self, column: int) -> FloatArray:
        """The values of a column, shape (rows,); NaN where there is no number."""

    @abstractmethod
    def text(self, column: int, row: int) -> str:
        """What stands there, for messages."""


@dataclass(frozen=True)
class TextColumns(Columns):
    """Columns of a text file; the rows are kept as fields of text until a column is asked for."""

    rows: Sequence[Sequence[str]]
    decimal: str

    def numbers(self, column: int) -> FloatArray:
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


@dataclass(frozen=True)
class MatColumns(Columns):
    """Columns of a MAT file: each variable one, or several (``name_0`` …) for a matrix."""

    values: FloatArray

    def numbers(self, column: int) -> FloatArray:
        """The values of a column, shape (rows,)."""
        return self.values[:, column]

    def text(self, column: int, row: int) -> str:
        """What stands there, for messages."""
        return f"{self.values[row, column]}"


def read_columns(path: Path, data: bytes, table: Table, wanted: frozenset[str]) -> Columns:
    """Read a file of others as columns.

    ``wanted`` are the column names that the rig file asks for: they help to tell a header from data.
    TableError when the file is empty or of a kind that is not read.
    """
    if not data.strip():
        raise TableError(f"{path}: expected a table, found an empty file")
    if data.startswith(b"MATLAB 5.0"):
        return _read_mat(path)
    for magic, what in BINARY.items():
        if data.startswith(magic):
            raise TableError(f"{path}: expected a text table or a MAT file (version 5 to 7), found {what}")
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


def _read_text(path: Path, text: str, table: Table, wanted: frozenset[str]) -> TextColumns:
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


def _has_header(fields: Sequence[str], table: Table, wanted: frozenset[str]) -> bool:
    if table.header is not None:
        return table.header
    names = [field.strip().strip("\"'") for field in fields]
    if wanted & set(names):
        return True
    numbers = [_number(name.replace(table.decimal, ".")) for name in names if name]
    return bool(np.isnan(numbers).all())


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _read_mat(path: Path) -> MatColumns:
    from scipy.io import loadmat

    try:
        variables: dict[str, Any] = loadmat(path)
    except Exception as error:  # a cut MAT file makes scipy raise almost anything
        raise TableError(f"{path}: expected a MAT file, found one that cannot be read: {error}") from error
    arrays = {
        name: np.asarray(value, dtype=np.float64)
        for name, value in variables.items()
        if not name.startswith("__") and isinstance(value, np.ndarray) and value.dtype.kind in "iufb"
    }
    arrays = {name: value for name, value in arrays.items() if value.ndim == 2 and value.size}
    if not arrays:
        raise TableError(f"{path}: expected variables that are columns of numbers, found none")
    sizes: Counter[int] = Counter()
    for value in arrays.values():
        sizes[max(value.shape)] += value.size
    rows = sizes.most_common(1)[0][0]  # scalars and settings beside the columns do not count
    names: list[str] = []
    columns: list[FloatArray] = []
    for name, value in arrays.items():
        upright = value if value.shape[0] == rows else value.T
        if upright.shape[0] != rows:
            continue  # a scalar or a table of something else
        count = upright.shape[1]
        names += [name] if count == 1 else [f"{name}_{column}" for column in range(count)]
        columns.append(upright)
    counts = np.full(rows, len(names))
    return MatColumns(tuple(names), len(names), np.arange(1, rows + 1), counts, np.hstack(columns))
