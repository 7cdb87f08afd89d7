"""Channels that are sampled more slowly than the rows of their table, and leave cells empty in between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labhil.errors import TableError
from labhil.recording.bad_rows import MOST_DROPPED
from labhil.recording.sheet import MappedSignal, Sheet
from labhil.signals import Direction, FloatArray, Hold, IntArray

SLOWER = 1 / 3
"""Share of a channel's samples that are followed by an empty cell, from which on it is a slower one: three
samples in four rows. A channel that fell silent for one long stretch has a few such places only."""

FEWEST_SAMPLES = 5
"""Samples from which a channel can be seen to be slower, and not only to lack some."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class FilledSignals:
    """Values of the channels with what was filled; ``edge`` (rows,) are beyond a slow channel's samples."""

    taken: list[tuple[MappedSignal, FloatArray]]
    edge: Mask
    notes: tuple[str, ...]


def fill_slow_channels(
    sheet: Sheet, taken: Sequence[tuple[MappedSignal, FloatArray]], t: FloatArray
) -> FilledSignals:
    """Fill the empty cells of slower channels by what the signal does between its samples.

    Inputs and states are held or joined by straight lines, as their signal declares. An output is measured:
    TableError with the choices, unless the rig file has ``blanks = "fill"``, or drops bad rows. ``t`` (rows,)
    is in s, NaN where a row does not count.
    """
    rows = np.flatnonzero(sheet.columns.complete & np.isfinite(t))
    edge = np.zeros(len(t), dtype=np.bool_)
    notes, result = [], []
    for mapped, values in taken:
        missing = _missing(sheet, mapped)[rows]
        present = np.flatnonzero(np.isfinite(values[rows]).all(axis=1))
        if not _is_slow(sheet, missing, present):
            result.append((mapped, values))
            continue
        if mapped.signal.direction is Direction.OUTPUT and sheet.rig.table.blanks != "fill":
            if sheet.rig.table.bad_rows == "drop":
                result.append((mapped, values))
                continue
            raise TableError(_choices(sheet, mapped, rows, present))
        longest = int(np.diff(present).max())
        result.append((mapped, _fill(mapped, values, t, rows, present, missing, longest)))
        first, last = int(present[0]), int(present[-1])
        edge[rows[max(0, first - longest) : first]] = True
        edge[rows[last + 1 : last + 1 + longest]] = True
        way = "it keeps the last one" if mapped.signal.hold is Hold.ZERO else "it goes along straight lines"
        notes.append(
            f"{mapped.signal.name} is slower: {len(present)} samples in {len(rows)} rows; between its "
            f"samples {way}"
        )
    finite = np.all([np.isfinite(values).all(axis=1) for _, values in result], axis=0)
    return FilledSignals(result, edge & ~finite, tuple(notes))


def _missing(sheet: Sheet, one: MappedSignal) -> Mask:
    return np.any([sheet.columns.missing(column) for column in one.columns], axis=0)


def _is_slow(sheet: Sheet, missing: Mask, present: IntArray) -> bool:
    if len(present) < FEWEST_SAMPLES or np.count_nonzero(missing) <= MOST_DROPPED * len(missing):
        return False
    if sheet.rig.table.blanks == "fill":
        return True
    return bool(np.mean(np.diff(present) > 1) >= SLOWER)


def _fill(
    mapped: MappedSignal,
    values: FloatArray,
    t: FloatArray,
    rows: IntArray,
    present: IntArray,
    missing: Mask,
    longest: int,
) -> FloatArray:
    values = values.copy()
    gaps = np.flatnonzero(missing)
    gaps = gaps[(gaps > present[0]) & (gaps < present[-1] + longest)]
    if mapped.signal.hold is Hold.ZERO:
        before = present[np.searchsorted(present, gaps) - 1]
        values[rows[gaps]] = values[rows[before]]
        return values
    gaps = gaps[gaps < present[-1]]
    for column in range(values.shape[1]):
        known = values[rows[present], column]
        values[rows[gaps], column] = np.interp(t[rows[gaps]], t[rows[present]], known)
    return values


def _choices(sheet: Sheet, mapped: MappedSignal, rows: IntArray, present: IntArray) -> str:
    name = mapped.signal.name
    blank = int(rows[np.setdiff1d(np.arange(len(rows)), present)[0]])
    return (
        f"{sheet.path}: {name} has a value in {len(present)} of {len(rows)} rows, the first empty cell is in "
        f"{sheet.place(blank)}, column {sheet.column(mapped.columns[0])}: a slower channel. It is an output, "
        f"so values in between would be invented. Choose in {sheet.rig.path}: leave {name} out of "
        "[channels]; or "
        f'[table] bad_rows = "drop" for the rows in which it stands; or [table] blanks = "fill" to join its '
        f"samples by {'steps' if mapped.signal.hold is Hold.ZERO else 'straight lines'}"
    )
