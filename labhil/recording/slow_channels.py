"""Interpolation of channels that are sampled more slowly than the rows of their table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labhil.errors import TableError
from labhil.recording.bad_rows import MAX_DROPPED
from labhil.recording.sheet import MappedSignal, Sheet, SignalValues
from labhil.signals import Direction, FloatArray, Hold, IntArray

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class FilledSignals:
    """Signals after interpolation.

    Attributes:
        signals: signals with their values.
        edge: rows (rows,) before the first or after the last sample of a slow channel.
        notes: what was interpolated.
    """

    signals: list[tuple[MappedSignal, FloatArray]]
    edge: Mask
    notes: tuple[str, ...]


def fill_slow_channels(sheet: Sheet, signals: SignalValues, t: FloatArray) -> FilledSignals:
    """Interpolate slow channels, by the hold of their signals.

    Args:
        sheet: the table.
        signals: its signals.
        t: times (rows,), s; NaN where a row is not used.

    Returns:
        The signals.

    Raises:
        TableError: A slow channel is an output, whose measured values are not interpolated unless the rig
            file has ``blanks = "fill"``; with ``bad_rows = "drop"`` its empty cells remain.
    """
    rows = np.flatnonzero(sheet.columns.complete & np.isfinite(t))
    edge = np.zeros(len(t), dtype=np.bool_)
    notes, result = [], []
    for mapped, values in signals:
        missing = _missing(sheet, mapped)[rows]
        present = np.flatnonzero(np.isfinite(values[rows]).all(axis=1))
        if not _is_slow(sheet, missing, present):
            result.append((mapped, values))
            continue
        if mapped.signal.direction is Direction.OUTPUT and sheet.rig.table.blanks != "fill":
            if sheet.rig.table.bad_rows == "drop":
                result.append((mapped, values))
                continue
            raise TableError(_choices_message(sheet, mapped, rows, present))
        longest = int(np.diff(present).max())
        result.append((mapped, _interpolate(mapped, values, t, rows, present, missing, longest)))
        first, last = int(present[0]), int(present[-1])
        edge[rows[max(0, first - longest) : first]] = True
        edge[rows[last + 1 : last + 1 + longest]] = True
        hold = "it keeps the last one" if mapped.signal.hold is Hold.ZERO else "it goes along straight lines"
        notes.append(
            f"{mapped.signal.name} is slower: {len(present)} samples in {len(rows)} rows; between its "
            f"samples {hold}"
        )
    finite = np.all([np.isfinite(values).all(axis=1) for _, values in result], axis=0)
    return FilledSignals(result, edge & ~finite, tuple(notes))


def _missing(sheet: Sheet, mapped: MappedSignal) -> Mask:
    return np.any([sheet.columns.missing(column) for column in mapped.columns], axis=0)


def _is_slow(
    sheet: Sheet, missing: Mask, present: IntArray, min_samples: int = 5, min_gap_fraction: float = 1 / 3
) -> bool:
    """Whether a channel is slow, and does not only lack values.

    It has ``min_samples``, and before ``min_gap_fraction`` of them an empty cell (three samples in four
    rows). A channel that stopped for a while has few empty cells between samples.
    """
    if len(present) < min_samples or np.count_nonzero(missing) <= MAX_DROPPED * len(missing):
        return False
    if sheet.rig.table.blanks == "fill":
        return True
    return bool(np.mean(np.diff(present) > 1) >= min_gap_fraction)


def _interpolate(
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


def _choices_message(sheet: Sheet, mapped: MappedSignal, rows: IntArray, present: IntArray) -> str:
    name = mapped.signal.name
    blank = int(rows[np.setdiff1d(np.arange(len(rows)), present)[0]])
    way = "steps" if mapped.signal.hold is Hold.ZERO else "straight lines"
    return (
        f"{sheet.path}: {name} has a value in {len(present)} of {len(rows)} rows, the first empty cell is in "
        f"{sheet.place(blank)}, column {sheet.column(mapped.columns[0])}: a slower channel. It is an output, "
        f"so values in between would be invented. Choose in {sheet.rig.path}: leave {name} out of "
        '[channels]; or [table] bad_rows = "drop" for the rows in which it has a value; or '
        f'[table] blanks = "fill" to join its samples by {way}'
    )
