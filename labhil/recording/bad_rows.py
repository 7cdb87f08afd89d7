"""Bad rows of a table: which they are, how many may be dropped, and messages about them."""

from __future__ import annotations

from ast import literal_eval
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labhil.errors import TableError
from labhil.recording.formats.notation import Notation, other_notations
from labhil.recording.formats.time_text import is_time
from labhil.recording.sheet import MappedSignal, Sheet, SignalValues

FIELD_COUNT = "field_count"
NOT_FINITE = "not_finite"
TIME = "time"

REASONS = {
    FIELD_COUNT: "with a wrong number of fields",
    NOT_FINITE: "with text, NaN or nothing in a mapped column",
    TIME: "with a time that does not follow the others",
}

MAX_DROPPED = 0.01
"""Largest fraction of rows that are dropped without ``bad_rows = "drop"``; more would bias a fit.

One row is always dropped, since a logger cuts its last line when it is switched off.
"""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class BadRows:
    """Bad rows of a table.

    Attributes:
        rows: number of all rows.
        masks: bad rows (rows,) by reason.
        first: description of the first bad row by reason.
    """

    rows: int
    masks: Mapping[str, Mask]
    first: Mapping[str, str]

    def count(self, reason: str) -> int:
        """Number of bad rows for a reason."""
        return int(np.count_nonzero(self.masks[reason]))

    @property
    def counts(self) -> dict[str, int]:
        """Number of bad rows by reason."""
        return {reason: self.count(reason) for reason in self.masks}


def finite_rows(sheet: Sheet, signals: SignalValues) -> Mask:
    """Find rows with the right number of fields and finite numbers in all signals.

    Args:
        sheet: the table.
        signals: its signals, with the time.

    Returns:
        The rows, (rows,).

    Raises:
        TableError: There are none.
    """
    numbers = np.hstack([values for _, values in signals])
    finite: Mask = sheet.columns.complete & np.isfinite(numbers).all(axis=1)
    if not finite.any():
        raise TableError(_no_good_row_message(sheet, signals))
    return finite


def find_bad_rows(
    sheet: Sheet, signals: SignalValues, finite: Mask, followed: Mask, excused: Mask
) -> BadRows:
    """Find the bad rows, and refuse the table if there are too many.

    Args:
        sheet: the table.
        signals: its signals, the time first.
        finite: rows with finite numbers, (rows,).
        followed: rows whose times follow the others, (rows,).
        excused: rows that are not used for other reasons, (rows,).

    Returns:
        The bad rows.

    Raises:
        TableError: There are bad rows and the rig file has ``bad_rows = "fail"``, or over ``MAX_DROPPED`` of
            all rows are bad and it does not have ``"drop"``.
    """
    complete = sheet.columns.complete
    masks = {
        FIELD_COUNT: ~complete,
        NOT_FINITE: complete & ~finite & ~excused,
        TIME: finite & ~followed & ~excused,
    }
    first = {
        reason: _describe_bad_row(sheet, signals, int(np.flatnonzero(mask)[0]))
        for reason, mask in masks.items()
        if mask.any()
    }
    bad = BadRows(len(finite), masks, first)
    total = sum(bad.counts.values())
    stated = sheet.rig.table.bad_rows
    if total and stated == "fail":
        row = int(np.flatnonzero(np.any(list(masks.values()), axis=0))[0])
        raise TableError(f"{sheet.path}, {_describe_bad_row(sheet, signals, row)}")
    if total > max(1, MAX_DROPPED * len(finite)) and stated is None:
        raise TableError(_too_many_message(sheet, bad, total))
    return bad


def _too_many_message(sheet: Sheet, bad: BadRows, total: int) -> str:
    parts = [
        f"{bad.count(reason)} {REASONS[reason]}, the first in {quoted}"
        for reason, quoted in bad.first.items()
    ]
    return (
        f"{sheet.path}: expected rows that can be read, found {total} of {bad.rows} "
        f"({100.0 * total / bad.rows:.3g} %) that cannot: {'; '.join(parts)}. Correct what reads them, or "
        f'write [table] bad_rows = "drop" in {sheet.rig.path} to go on without these rows'
    )


def _describe_bad_row(sheet: Sheet, signals: SignalValues, row: int) -> str:
    """What is wrong with a row, with its position."""
    if not sheet.columns.complete[row]:
        return f"{sheet.place(row)}: expected {sheet.columns.width} fields, found {sheet.columns.counts[row]}"
    for mapped, values in signals:
        for column, value in zip(mapped.columns, values[row], strict=True):
            if not np.isfinite(value):
                return _describe_missing_number(sheet, signals, mapped, column, row)
    mapped, values = signals[0]
    text = sheet.columns.text(mapped.columns[0], row)
    return f"{sheet.place(row)}: expected a time that follows the others, found {text} ({values[row, 0]:g} s)"


def _describe_missing_number(
    sheet: Sheet, signals: SignalValues, mapped: MappedSignal, column: int, row: int
) -> str:
    """The content of a cell without a number, and the notation in which it is one."""
    text, name = sheet.columns.text(column, row), mapped.signal.name
    hint = _notation_hint(sheet, signals, name, _unquote(text))
    return (
        f"{sheet.place(row)}: column {sheet.column(column)} ({name}): expected a finite number, "
        f"found {text}{hint}"
    )


def _unquote(quoted: str) -> str:
    """The original text of one that is quoted for a message."""
    try:
        text = literal_eval(quoted)
    except (ValueError, SyntaxError):
        return quoted
    return text if isinstance(text, str) else quoted


def _notation_hint(sheet: Sheet, signals: SignalValues, name: str, text: str) -> str:
    """Keys of ``[table]`` with which a text is a number, if more cells of the table are numbers then."""
    if is_time(text):
        return "" if name == "t" else " (a date or a time of day, which counts only as t)"
    columns = [column for mapped, _ in signals for column in mapped.columns]
    readable = sum(int(np.count_nonzero(np.isfinite(values))) for _, values in signals)
    hints = [
        hint
        for notation, hint in other_notations(text, Notation.of(sheet.rig.table))
        if sum(sheet.columns.readable(column, notation) for column in columns) > readable
    ]
    return f" ({'; '.join(hints)})" if hints else ""


def _no_good_row_message(sheet: Sheet, signals: SignalValues) -> str:
    complete = np.flatnonzero(sheet.columns.complete)
    for mapped, values in signals:
        for column, scaled in zip(mapped.columns, values.T, strict=True):
            if not np.isfinite(scaled).any():
                cell = _describe_missing_number(sheet, signals, mapped, column, int(complete[0]))
                return f"{sheet.path}, {cell}; no other row has a number there either"
    return f"{sheet.path}: expected rows with finite numbers in all mapped columns, found none"
