"""Reader and writer of workbooks (XLSX), by openpyxl."""

from __future__ import annotations

import math
import re
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime, time
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labhil.bounds import ImplausibleError, refuse_claim
from labhil.errors import TableError, UsageError, suggestion
from labhil.extras import load_optional
from labhil.recording.formats.columns import Columns, cell_text, parse_cell, times_or_numbers
from labhil.recording.formats.notation import Notation, is_missing
from labhil.recording.formats.time_text import TimeKind, TimeValues
from labhil.recording.units import is_units_line
from labhil.rig_sections import Table
from labhil.signals import FloatArray, Hold, Stream

MAX_SHEET_ROWS = 1_048_575
"""Largest number of rows below the header of a sheet."""

FREE_CELLS, MAX_CELLS_PER_VALUE = 1 << 20, 50
"""Largest area of a sheet in cells: a constant, and a multiple of its filled cells. No table is sparser."""


@dataclass(frozen=True)
class SheetColumns(Columns):
    """Columns of a sheet, whose cells are converted when a column is read.

    Attributes:
        rows: cells of each row.
        notation: notation of numbers in text.
        units: texts of a line of units.
    """

    rows: Sequence[Sequence[Any]]
    notation: Notation
    units: tuple[str, ...] = ()

    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """Values (rows,) of a column; NaN where there is no number."""
        return np.array([parse_cell(cell, self.notation) for cell in self._cells(column)], dtype=np.float64)

    def times(self, column: int) -> TimeValues:
        """Times (rows,) in a column; dates and times of day in s."""
        cells = self._cells(column)
        stamps = times_or_numbers(self.numbers(column), [cell_text(cell) for cell in cells])
        if stamps.kind is not TimeKind.NUMBER:
            return stamps
        kinds = {datetime: TimeKind.DATE, time: TimeKind.OF_DAY}
        first = next((cell for cell in cells if cell is not None), None)
        return TimeValues(stamps.values, kinds.get(type(first), TimeKind.NUMBER))

    def missing(self, column: int) -> NDArray[np.bool_]:
        """Rows where a column has no value, (rows,)."""
        return np.array(
            [cell is None or (isinstance(cell, str) and is_missing(cell)) for cell in self._cells(column)]
        )

    def readable(self, column: int, notation: Notation) -> int:
        """Number of cells of a column that are numbers in another notation."""
        values = np.array([parse_cell(cell, notation) for cell in self._cells(column)], dtype=np.float64)
        return int(np.count_nonzero(np.isfinite(values)))

    def text(self, column: int, row: int) -> str:
        """Content of a cell, for messages."""
        cells = self.rows[row]
        cell = cells[column] if column < len(cells) else None
        return "an empty cell" if cell is None else repr(cell)

    def _cells(self, column: int) -> list[Any]:
        return [row[column] if column < len(row) else None for row in self.rows]


def read_workbook(path: Path, table: Table, wanted: Sequence[str]) -> SheetColumns:
    """Read a sheet of a workbook, with the last calculated values of formulas.

    Args:
        path: the file.
        table: section ``[table]`` of the rig file, whose ``sheet`` names the sheet; else it is the first.
        wanted: names of columns, by which a header is recognised.

    Returns:
        The table.

    Raises:
        TableError: The file cannot be read, or has no such sheet or no rows.
        MissingExtraError: openpyxl is not installed.
    """
    openpyxl = load_optional("openpyxl", f"{path}: a workbook (XLSX)")
    try:
        with zipfile.ZipFile(path) as packed:
            refuse_claim(
                "the workbook", sum(part.file_size for part in packed.infolist()), path.stat().st_size
            )
        with closing(openpyxl.load_workbook(path, read_only=True, data_only=True)) as book:
            cells = _cells(path, book, table)
    except (TableError, MemoryError):
        raise
    except ImplausibleError as error:
        raise TableError(f"{path}: {error}") from error
    except Exception as error:  # zipfile, the XML parser and openpyxl each raise their own
        raise TableError(
            f"{path}: expected a workbook (XLSX), found one that cannot be read: {error!r}"
        ) from error
    if not cells:
        raise TableError(f"{path}: expected a table, found no rows (after skip_rows = {table.skip_rows})")
    names = None
    if _has_header(cells[0][1], table, wanted):
        names = tuple("" if cell is None else str(cell).strip() for cell in cells[0][1])
        cells = cells[1:]
    units: tuple[str, ...] = ()
    if names is not None and cells and is_units_line(texts := [cell_text(cell) for cell in cells[0][1]]):
        units, cells = tuple(texts + [""] * (len(names) - len(texts))), cells[1:]
    if not cells:
        raise TableError(f"{path}: expected rows below the header, found no rows below it")
    filled = np.array([len(row) for _, row in cells], dtype=np.int64)
    width = len(names) if names is not None else int(np.bincount(filled).argmax())
    lines = np.array([number for number, _ in cells], dtype=np.int64)
    # empty cells at the end are not stored, so missing cells are empty fields
    counts = np.maximum(filled, width)
    rows = [row for _, row in cells]
    return SheetColumns(names, width, lines, counts, rows, Notation.of(table), units)


def write_workbook(stream: Stream, t: FloatArray, values: FloatArray, out: Path) -> None:
    """Write a sheet named after the stream: a header, then ``t`` and the signals; empty where not finite.

    Numbers have 16 significant digits; a double needs 17 to be exact.

    Args:
        stream: the stream.
        t: times (n,), s.
        values: samples (n, columns).
        out: the file.

    Raises:
        UsageError: There are more samples than a sheet has rows.
        MissingExtraError: openpyxl is not installed.
    """
    openpyxl = load_optional("openpyxl", f"{out}: writing a workbook (XLSX)")
    if len(t) > MAX_SHEET_ROWS:
        raise UsageError(
            f"{out}: expected at most {MAX_SHEET_ROWS} samples for one sheet, found {len(t)}; "
            "a .parquet or .csv file holds them all"
        )
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet(re.sub(r"[\\*?:/\[\]]|[^\x20-\ud7ff]", "_", stream.name)[:31])
    sheet.append(["t", *stream.columns()])
    for row in np.column_stack([t, values]).tolist():
        sheet.append([cell if math.isfinite(cell) else None for cell in row])
    packed = BytesIO()
    book.save(packed)
    out.write_bytes(packed.getvalue())


def _cells(path: Path, book: Any, table: Table) -> list[tuple[int, list[Any]]]:
    """Rows with their numbers from 1, without skipped, blank and comment rows and trailing empty cells."""
    names = book.sheetnames
    if table.sheet is not None and table.sheet not in names:
        near = suggestion(table.sheet, names)
        raise TableError(f"{path}: expected a sheet {table.sheet!r}{near}, found {', '.join(names)}")
    sheet = book[names[0] if table.sheet is None else table.sheet]
    if not hasattr(sheet, "iter_rows"):
        raise TableError(f"{path}: sheet {sheet.title!r}: expected cells, found a chart")
    rows = []
    for number, row in _rows(path, sheet):
        cells = [None if isinstance(cell, str) and not cell.strip() else cell for cell in row]
        while cells and cells[-1] is None:
            cells.pop()
        commented = table.comment and cells and str(cells[0]).startswith(table.comment)
        if number > table.skip_rows and cells and not commented:
            rows.append((number, cells))
    return rows


def _rows(path: Path, sheet: Any) -> Iterator[tuple[int, list[Any]]]:
    """Stored rows of a sheet with their numbers from 1, each up to its last filled cell.

    openpyxl's own rows have all cells up to the last row and column of any stored cell, up to 17 billion.
    TableError if the cells up to the last filled ones are many more than the filled ones.
    """
    from openpyxl.worksheet._reader import WorkSheetParser

    book = sheet.parent
    n_filled = area = 0
    with sheet._get_source() as source:
        parser = WorkSheetParser(
            source,
            sheet._shared_strings,
            data_only=True,
            epoch=book.epoch,
            date_formats=book._date_formats,
            timedelta_formats=book._timedelta_formats,
        )
        for number, cells in parser.parse():
            filled = {cell["column"]: cell["value"] for cell in cells if cell["value"] not in (None, "")}
            width = max(filled, default=0)
            n_filled, area = n_filled + len(filled), area + width
            if area > FREE_CELLS + MAX_CELLS_PER_VALUE * n_filled:
                raise TableError(
                    f"{path}: sheet {sheet.title!r}: expected a table, found {n_filled} cells that hold "
                    f"something, spread over {area}; the last of row {number} is in column {width}"
                )
            if 0 < number <= MAX_SHEET_ROWS + 1:
                yield number, [filled.get(column) for column in range(1, width + 1)]


def _has_header(cells: Sequence[Any], table: Table, wanted: Sequence[str]) -> bool:
    if table.header is not None:
        return table.header
    texts = {str(cell).strip() for cell in cells if cell is not None}
    if not texts.isdisjoint(wanted):
        return True
    return all(math.isnan(parse_cell(cell, Notation.of(table))) for cell in cells)
