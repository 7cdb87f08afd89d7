"""An excitation from a file: a table of times and values."""

from __future__ import annotations

import csv
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Literal

from labhil.bounds import read_file
from labhil.experiment.excitation.function import Excitation, Excitations

Between = Literal["linear", "hold"]


@dataclass(frozen=True, slots=True)
class Table:
    """``values`` at ``times`` (s), with linear interpolation, or with the earlier value ("hold").

    The first value holds before the first time, the last value after the last.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]
    between: Between = "linear"

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        after = bisect_right(self.times, t)
        if after == 0:
            return self.values[0]
        before = after - 1
        if after == len(self.times) or self.between == "hold":
            return self.values[before]
        weight = (t - self.times[before]) / (self.times[after] - self.times[before])
        return self.values[before] + weight * (self.values[after] - self.values[before])


def read_table(path: str, between: Between = "linear", directory: Path = Path()) -> Excitation | Excitations:
    """Read a table of comma-separated numbers: t (s), then a value, or one for each column of a vector.

    A first line without numbers is taken for a header; empty lines do not count.

    Args:
        path: The file, relative to ``directory``.
        between: Interpolation, "linear" or "hold".
        directory: Where a relative path begins.

    Raises:
        ValueError: The file cannot be read, or a line is malformed; the message gives its number.
    """
    if between not in ("linear", "hold"):
        raise ValueError(f"`between` must be 'linear' or 'hold', found {between!r}")
    table_path = directory / path
    try:
        text = read_file(table_path).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"`path`: {table_path} cannot be read as a table t,value: {error}") from error
    rows = _parse_rows(text, table_path)
    times = tuple(row[0] for row in rows)
    for earlier, later in pairwise(times):
        if not earlier < later:
            raise ValueError(f"{table_path}: times must increase, found {later:g} s after {earlier:g} s")
    columns = tuple(
        Table(times, tuple(row[column] for row in rows), between) for column in range(1, len(rows[0]))
    )
    return columns[0] if len(columns) == 1 else Excitations(columns)


def _parse_rows(text: str, table_path: Path) -> list[tuple[float, ...]]:
    rows: list[tuple[float, ...]] = []
    for number, cells in enumerate(csv.reader(text.splitlines()), start=1):
        if not any(cell.strip() for cell in cells):
            continue
        row = _parse_numbers(cells)
        if row is None and number == 1:
            continue
        width = len(rows[0]) if rows else max(len(cells), 2)
        if row is None or len(row) != width:
            raise ValueError(
                f"{table_path}: line {number}: expected {width} finite numbers, found {','.join(cells)!r}"
            )
        rows.append(row)
    if not rows:
        raise ValueError(f"{table_path}: expected rows of t,value, found none")
    return rows


def _parse_numbers(cells: list[str]) -> tuple[float, ...] | None:
    try:
        row = tuple(float(cell) for cell in cells)
    except ValueError:
        return None
    return row if all(isfinite(value) for value in row) else None
