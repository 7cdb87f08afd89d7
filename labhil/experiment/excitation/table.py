"""An excitation that somebody else worked out: a table of times and values."""

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
    """``values`` at ``times`` (s); on the straight line in between, or with "hold" the earlier one.

    The first value stands before the first time, the last after the last.
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
        share = (t - self.times[before]) / (self.times[after] - self.times[before])
        return self.values[before] + share * (self.values[after] - self.values[before])


def read_table(path: str, between: Between = "linear", directory: Path = Path()) -> Excitation | Excitations:
    """Read a table of comma-separated numbers: t (s), then a value, or one for each column of a vector.

    ``path`` is relative to ``directory``. A first line that is no numbers is taken for a header, empty
    lines do not count. ValueError says which line is wrong.
    """
    if between not in ("linear", "hold"):
        raise ValueError(f"`between` must be 'linear' or 'hold', found {between!r}")
    where = directory / path
    try:
        text = read_file(where).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"`path`: {where} cannot be read as a table t,value: {error}") from error
    rows = _rows(text, where)
    times = tuple(row[0] for row in rows)
    for earlier, later in pairwise(times):
        if not earlier < later:
            raise ValueError(f"{where}: times must increase, found {later:g} s after {earlier:g} s")
    columns = tuple(
        Table(times, tuple(row[column] for row in rows), between) for column in range(1, len(rows[0]))
    )
    return columns[0] if len(columns) == 1 else Excitations(columns)


def _rows(text: str, where: Path) -> list[tuple[float, ...]]:
    rows: list[tuple[float, ...]] = []
    for number, cells in enumerate(csv.reader(text.splitlines()), start=1):
        if not any(cell.strip() for cell in cells):
            continue
        row = _numbers(cells)
        if row is None and number == 1:
            continue
        width = len(rows[0]) if rows else max(len(cells), 2)
        if row is None or len(row) != width:
            raise ValueError(
                f"{where}: line {number}: expected {width} finite numbers, found {','.join(cells)!r}"
            )
        rows.append(row)
    if not rows:
        raise ValueError(f"{where}: expected rows of t,value, found none")
    return rows


def _numbers(cells: list[str]) -> tuple[float, ...] | None:
    try:
        row = tuple(float(cell) for cell in cells)
    except ValueError:
        return None
    return row if all(isfinite(value) for value in row) else None
