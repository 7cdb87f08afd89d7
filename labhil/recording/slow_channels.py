"""Channels that are sampled more slowly than the rows of their table, and leave cells empty in between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labhil.errors import TableError
from labhil.recording.bad_rows import MOST_DROPPED
from labhil.recording.sheet import Mapped, Sheet
from labhil.signals import Direction, FloatArray, Hold, IntArray

SLOWER = 1 / 3
"""Share of a channel's samples that are followed by an empty cell, from which on it is a slower one: three
samples in four rows. A channel that fell silent for one long stretch has a few such places only."""

FEWEST_SAMPLES = 5
"""Samples from which a channel can be seen to be slower, and not only to lack some."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Filled:
    """Values of the channels with what was filled; ``edge`` (rows,) are beyond a slow channel's samples."""

    taken: list[tuple[Mapped, FloatArray]]
    edge: Mask
    notes: tuple[str, ...]


def fill_slow(sheet: Sheet, taken: Sequence[tuple[Mapped, FloatArray]], t: FloatArray) -> Filled:
    """Fill the empty cells of slower channels by what the signal does between its samples.

    Inputs and states are held or joined by straight lines, as their signal declares. An output is measured:
    TableError with the choices, unless the rig file has ``blanks = "fill"``, or drops bad rows. ``t`` (rows,)
    is in s, NaN where a row does not count.
    """
    rows = np.flatnonzero(sheet.columns.complete & np.isfinite(t))
    edge = np.zeros(len(t), dtype=np.bool_)
    notes, result = [], []
    for one, values in taken:
        missing = _missing(sheet, one)[rows]
        there = np.flatnonzero(np.isfinite(values[rows]).all(axis=1))
        if not _is_slow(sheet, missing, there):
            result.append((one, values))
            continue
        if one.signal.direction is Direction.OUTPUT and sheet.rig.table.blanks != "fill":
            if sheet.rig.table.bad_rows == "drop":
                result.append((one, values))
                continue
            raise TableError(_choices(sheet, one, rows, there))
        longest = int(np.diff(there).max())
        result.append((one, _filled(one, values, t, rows, there, missing, longest)))
        first, last = int(there[0]), int(there[-1])
        edge[rows[max(0, first - longest) : first]] = True
        edge[rows[last + 1 : last + 1 + longest]] = True
        way = "it keeps the last one" if one.signal.hold is Hold.ZERO else "it goes along straight lines"
        notes.append(
            f"{one.signal.name} is slower: {len(there)} samples in {len(rows)} rows; between its samples "
            f"{way}"
        )
    finite = np.all([np.isfinite(values).all(axis=1) for _, values in result], axis=0)
    return Filled(result, edge & ~finite, tuple(notes))


def _missing(sheet: Sheet, one: Mapped) -> Mask:
    return np.any([sheet.columns.missing(column) for column in one.columns], axis=0)


def _is_slow(sheet: Sheet, missing: Mask, there: IntArray) -> bool:
    if len(there) < FEWEST_SAMPLES or np.count_nonzero(missing) <= MOST_DROPPED * len(missing):
        return False
    if sheet.rig.table.blanks == "fill":
        return True
    return bool(np.mean(np.diff(there) > 1) >= SLOWER)


def _filled(
    one: Mapped,
    values: FloatArray,
    t: FloatArray,
    rows: IntArray,
    there: IntArray,
    missing: Mask,
    longest: int,
) -> FloatArray:
    values = values.copy()
    gaps = np.flatnonzero(missing)
    gaps = gaps[(gaps > there[0]) & (gaps < there[-1] + longest)]
    if one.signal.hold is Hold.ZERO:
        before = there[np.searchsorted(there, gaps) - 1]
        values[rows[gaps]] = values[rows[before]]
        return values
    gaps = gaps[gaps < there[-1]]
    for column in range(values.shape[1]):
        known = values[rows[there], column]
        values[rows[gaps], column] = np.interp(t[rows[gaps]], t[rows[there]], known)
    return values


def _choices(sheet: Sheet, one: Mapped, rows: IntArray, there: IntArray) -> str:
    name = one.signal.name
    blank = int(rows[np.setdiff1d(np.arange(len(rows)), there)[0]])
    return (
        f"{sheet.path}: {name} has a value in {len(there)} of {len(rows)} rows, the first empty cell is in "
        f"{sheet.place(blank)}, column {sheet.column(one.columns[0])}: a slower channel. It is an output, so "
        f"values in between would be invented. Choose in {sheet.rig.path}: leave {name} out of [channels]; "
        "or "
        f'[table] bad_rows = "drop" for the rows in which it stands; or [table] blanks = "fill" to join its '
        f"samples by {'steps' if one.signal.hold is Hold.ZERO else 'straight lines'}"
    )
