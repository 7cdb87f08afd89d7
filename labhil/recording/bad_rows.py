"""Rows that cannot be read: which they are, how many may go, and what a message says of them."""

from __future__ import annotations

from ast import literal_eval
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labhil.errors import TableError
from labhil.recording.formats.notation import Notation, other_notations
from labhil.recording.formats.time_text import is_time
from labhil.recording.sheet import MappedSignal, Sheet
from labhil.signals import FloatArray

FIELD_COUNT = "field_count"
NOT_FINITE = "not_finite"
TIME = "time"

REASONS = {
    FIELD_COUNT: "with a wrong number of fields",
    NOT_FINITE: "with text, NaN or nothing in a mapped column",
    TIME: "with a time that does not follow the others",
}

MOST_DROPPED = 0.01
"""Share of the rows that may be dropped without being asked for: beyond it the losses shape what is fitted.
One row is always allowed: a logger that is switched off cuts its last line."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class BadRows:
    """Masks (rows,) of rows that are bad, by reason; ``first`` quotes the first of each reason."""

    rows: int
    masks: Mapping[str, Mask]
    first: Mapping[str, str]

    def count(self, reason: str) -> int:
        """How many rows are bad for this reason."""
        return int(np.count_nonzero(self.masks[reason]))

    @property
    def counts(self) -> dict[str, int]:
        """How many rows are bad, by reason."""
        return {reason: self.count(reason) for reason in self.masks}


SignalValues = Sequence[tuple[MappedSignal, FloatArray]]
"""Mapped columns with their values (rows, columns), the time first where a column holds it."""


def finite_rows(sheet: Sheet, taken: SignalValues) -> Mask:
    """Which rows have the right number of fields and a finite number in every mapped column.

    TableError where none has.
    """
    numbers = np.hstack([values for _, values in taken])
    finite: Mask = sheet.columns.complete & np.isfinite(numbers).all(axis=1)
    if not finite.any():
        raise TableError(_no_good_row(sheet, taken))
    return finite


def find_bad_rows(sheet: Sheet, taken: SignalValues, finite: Mask, followed: Mask, excused: Mask) -> BadRows:
    """Name the bad rows: those that are not ``finite`` or do not follow in time, unless they are ``excused``.

    TableError with the first of them under ``bad_rows = "fail"``, and where more than ``MOST_DROPPED`` of the
    rows are bad and the rig file does not ask for ``"drop"``.
    """
    complete = sheet.columns.complete
    masks = {
        FIELD_COUNT: ~complete,
        NOT_FINITE: complete & ~finite & ~excused,
        TIME: finite & ~followed & ~excused,
    }
    first = {
        reason: _blame(sheet, taken, int(np.flatnonzero(mask)[0]))
        for reason, mask in masks.items()
        if mask.any()
    }
    bad = BadRows(len(finite), masks, first)
    total = sum(bad.counts.values())
    stated = sheet.rig.table.bad_rows
    if total and stated == "fail":
        row = int(np.flatnonzero(np.any(list(masks.values()), axis=0))[0])
        raise TableError(f"{sheet.path}, {_blame(sheet, taken, row)}")
    if total > max(1, MOST_DROPPED * len(finite)) and stated is None:
        raise TableError(_too_many(sheet, bad, total))
    return bad


def _too_many(sheet: Sheet, bad: BadRows, total: int) -> str:
    parts = [
        f"{bad.count(reason)} {REASONS[reason]}, the first in {quoted}"
        for reason, quoted in bad.first.items()
    ]
    return (
        f"{sheet.path}: expected rows that can be read, found {total} of {bad.rows} "
        f"({100.0 * total / bad.rows:.3g} %) that cannot: {'; '.join(parts)}. Correct what reads them, or "
        f'write [table] bad_rows = "drop" in {sheet.rig.path} to go on without these rows'
    )


def _blame(sheet: Sheet, taken: SignalValues, row: int) -> str:
    """What is wrong with one row, with its place."""
    if not sheet.columns.complete[row]:
        return f"{sheet.place(row)}: expected {sheet.columns.width} fields, found {sheet.columns.counts[row]}"
    for mapped, values in taken:
        for column, value in zip(mapped.columns, values[row], strict=True):
            if not np.isfinite(value):
                return _no_number(sheet, taken, mapped, column, row)
    mapped, values = taken[0]
    text = sheet.columns.text(mapped.columns[0], row)
    return f"{sheet.place(row)}: expected a time that follows the others, found {text} ({values[row, 0]:g} s)"


def _no_number(sheet: Sheet, taken: SignalValues, mapped: MappedSignal, column: int, row: int) -> str:
    """That a number is missing where it should be, what stands there, and what would make a number of it."""
    text, name = sheet.columns.text(column, row), mapped.signal.name
    hint = _hint(sheet, taken, name, _as_written(text))
    return (
        f"{sheet.place(row)}: column {sheet.column(column)} ({name}): expected a finite number, "
        f"found {text}{hint}"
    )


def _as_written(quoted: str) -> str:
    """The text that a message quotes, with its blanks and signs as they stand in the file."""
    try:
        text = literal_eval(quoted)
    except (ValueError, SyntaxError):
        return quoted
    return text if isinstance(text, str) else quoted


def _hint(sheet: Sheet, taken: SignalValues, name: str, text: str) -> str:
    """Which keys of ``[table]`` would make a number of a text, if they make the table better as a whole."""
    if is_time(text):
        return "" if name == "t" else " (a date or a time of day, which counts only as t)"
    columns = [column for mapped, _ in taken for column in mapped.columns]
    readable = sum(int(np.count_nonzero(np.isfinite(values))) for _, values in taken)
    hints = [
        hint
        for notation, hint in other_notations(text, Notation.of(sheet.rig.table))
        if sum(sheet.columns.readable(column, notation) for column in columns) > readable
    ]
    return f" ({'; '.join(hints)})" if hints else ""


def _no_good_row(sheet: Sheet, taken: SignalValues) -> str:
    complete = np.flatnonzero(sheet.columns.complete)
    for mapped, values in taken:
        for column, scaled in zip(mapped.columns, values.T, strict=True):
            if not np.isfinite(scaled).any():
                complaint = _no_number(sheet, taken, mapped, column, int(complete[0]))
                return f"{sheet.path}, {complaint}; no other row has a number there either"
    return f"{sheet.path}: expected rows with finite numbers in all mapped columns, found none"
