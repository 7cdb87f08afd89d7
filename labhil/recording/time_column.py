"""Time of a table: choice of its column, and times of the rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labhil.errors import TableError
from labhil.recording import timeline
from labhil.recording.bad_rows import MAX_DROPPED
from labhil.recording.formats.time_text import DAY, TimeKind
from labhil.recording.sheet import MappedSignal, Sheet
from labhil.recording.stated_units import format_channel
from labhil.recording.units import Unit
from labhil.signals import FloatArray, IntArray

Mask = NDArray[np.bool_]

MIN_RATE, TYPICAL_RATE, MAX_RATE = 0.5, 100.0, 1e5
"""Sampling rates of rigs, Hz. The likely unit of times gives a rate in this range, near the typical one."""

TIME_UNITS = {"ms": 1e-3, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "days": DAY}

COUNTER_PERIODS = (2.0**16, 2.0**32)
HOUR = 3600.0
MAX_OUT_OF_ORDER = 0.1
"""Largest fraction of rows outside all stretches of increasing times; beyond it the rows are not sorted."""


@dataclass(frozen=True)
class TimeColumn:
    """A column of times.

    Attributes:
        mapped: the column.
        seconds: times (rows,), s; NaN where there is none.
        raw: values in the file, (rows,).
        kind: kind of these values.
        alternatives: other columns that could be the time, and what is against them.
    """

    mapped: MappedSignal
    seconds: FloatArray
    raw: FloatArray
    kind: TimeKind
    alternatives: str = ""

    def label(self, sheet: Sheet) -> str:
        """Column and unit, for messages."""
        scale = float(self.mapped.scale[0])
        unit = "s" if scale == 1.0 else f"s, × {scale:g}"
        if self.kind is not TimeKind.NUMBER:
            unit = f"{self.kind}, UTC without a time zone" if self.kind is TimeKind.DATE else str(self.kind)
        return f"column {sheet.column(self.mapped.columns[0])} ({unit})"


@dataclass(frozen=True)
class RowTimes:
    """Times of the rows.

    Attributes:
        t: times (rows,) from any zero, s; NaN for a row that does not follow the others.
        other_parts: rows (rows,) of stretches that were not selected.
        notes: what was changed.
    """

    t: FloatArray
    other_parts: Mask
    notes: tuple[str, ...] = ()


def read_time_column(sheet: Sheet, mapped: MappedSignal) -> TimeColumn:
    """Read a column of times."""
    values = sheet.columns.times(mapped.columns[0])
    raw = values.values
    seconds = mapped.to_signal_unit(raw[:, None])[:, 0] if values.kind is TimeKind.NUMBER else raw
    return TimeColumn(mapped, np.where(sheet.columns.complete, seconds, np.nan), raw, values.kind)


def choose_time_column(sheet: Sheet, candidates: Sequence[MappedSignal]) -> TimeColumn:
    """Choose the time among several columns: complete and increasing, a clock, no counter of the rows.

    Args:
        sheet: the table.
        candidates: the columns.

    Returns:
        The time, with the reasons against the other columns.
    """
    columns = [read_time_column(sheet, mapped) for mapped in candidates]
    if len(columns) == 1:
        return columns[0]
    most = max(int(np.count_nonzero(np.isfinite(column.seconds))) for column in columns)
    criteria = [_criteria(column, most) for column in columns]
    best = max(range(len(columns)), key=lambda number: (tuple(criteria[number].values()), -number))
    others = []
    for column, met in zip(columns, criteria, strict=True):
        if column is not columns[best]:
            worse = [why for why, good in met.items() if not good and criteria[best][why]]
            reason = f": it {worse[0]}" if worse else ""
            others.append(f"{sheet.column(column.mapped.columns[0])} is not used{reason}")
    return replace(columns[best], alternatives="; ".join(others))


def _criteria(time_column: TimeColumn, most: int) -> dict[str, bool]:
    """Criteria of a time, the most important first, by what messages say if they are not met."""
    finite = time_column.seconds[np.isfinite(time_column.seconds)]
    rising = np.diff(finite) > 0
    typical = timeline.median_step(finite)
    rate = 1.0 / typical if typical > 0 else 0.0
    raw = time_column.raw[np.isfinite(time_column.raw)]
    return {
        "is not complete": len(finite) >= (1.0 - MAX_DROPPED) * most,
        "does not increase from row to row": len(rising) > 0 and bool(np.mean(rising) >= 1.0 - MAX_DROPPED),
        "counts the rows": time_column.kind is not TimeKind.NUMBER or not _counts_rows(raw),
        "has an unlikely rate": MIN_RATE <= rate <= MAX_RATE,
    }


def _counts_rows(raw: FloatArray) -> bool:
    """Whether values increase by 1 from row to row."""
    return len(raw) > 1 and bool(np.mean(np.diff(raw) == 1.0) >= 1.0 - MAX_DROPPED)


def order_rows(sheet: Sheet, time_column: TimeColumn, copied: Mask) -> RowTimes:
    """Determine the times of the rows: undo wraps, spread repeated times, select a stretch.

    Args:
        sheet: the table.
        time_column: its time.
        copied: rows (rows,) with the values of the row before.

    Returns:
        The times.

    Raises:
        TableError: Times repeat irregularly, run backwards or restart; it names the cause and the remedy.
    """
    rows = np.flatnonzero(np.isfinite(time_column.seconds))
    times = time_column.seconds[rows] - (
        time_column.mapped.offset[0] if time_column.kind is TimeKind.NUMBER else 0.0
    )
    other_parts = np.zeros(len(time_column.seconds), dtype=np.bool_)
    if len(rows) < 2:
        return RowTimes(time_column.seconds, other_parts)
    _refuse_backwards(sheet, time_column, rows, times)
    notes = []
    wrap = timeline.find_wrap(times, _wrap_periods(time_column))
    if wrap is not None:
        times = timeline.unwrap(times, wrap)
        notes.append(_wrap_note(sheet, time_column, rows, wrap))
    repeated = np.flatnonzero(np.diff(times) == 0) + 1
    if len(repeated) > max(1.0, MAX_DROPPED * len(rows)):
        rows, times, note = _resolve_repeats(
            sheet, time_column, rows, times, bool(copied[rows[repeated]].all())
        )
        notes.append(note)
    stretches = timeline.increasing_stretches(times)
    selected, others = _select_stretch(sheet, time_column, rows, times, stretches, notes)
    t = np.full(len(time_column.seconds), np.nan)
    t[rows[selected]] = times[selected]
    other_parts[rows[others]] = True
    return RowTimes(t, other_parts, tuple(notes))


def _refuse_backwards(sheet: Sheet, time_column: TimeColumn, rows: IntArray, times: FloatArray) -> None:
    steps = np.diff(times)
    if len(steps) > 1 and np.mean(steps < 0) > 0.9:
        raise TableError(
            f"{sheet.path}: expected times that increase, found {time_column.label(sheet)} running backwards "
            f"from {sheet.place(int(rows[0]))} on: the newest row is the first; sort the rows by time"
        )


def _wrap_periods(time_column: TimeColumn) -> list[tuple[float, float | None]]:
    """Period and reading at a restart (None: any) of the clocks that may have made the times, s."""
    day: list[tuple[float, float | None]] = [(DAY, DAY)]
    if time_column.kind is TimeKind.DATE:
        return [(HOUR, None)]
    if time_column.kind is TimeKind.OF_DAY:
        return [*day, (DAY / 2, 13 * HOUR), (HOUR, HOUR), (HOUR, None)]
    counters = [(counts * unit, counts * unit) for counts in COUNTER_PERIODS for unit in (1e-6, 1e-3)]
    finite = time_column.raw[np.isfinite(time_column.raw)]
    if (finite == np.rint(finite)).all():
        scale = float(time_column.mapped.scale[0])
        # signed counters restart at half their period
        counters += [(n * scale, n * scale / part) for n in COUNTER_PERIODS for part in (1, 2)]
    return day + counters


def _wrap_note(sheet: Sheet, time_column: TimeColumn, rows: IntArray, wrap: timeline.Wrap) -> str:
    names = {DAY: "the clock of a day passes midnight", DAY / 2: "a clock of twelve hours restarts"}
    if time_column.kind is not TimeKind.NUMBER:
        names[HOUR] = "the hour is set back, as at the end of summer time, or restarts"
    cause = names.get(wrap.period)
    if cause is None:
        scale = float(time_column.mapped.scale[0])
        bits = 32 if any(np.isclose(wrap.period, 2.0**32 * unit) for unit in (scale, 1e-3, 1e-6)) else 16
        cause = f"a counter of {bits} bits restarts"
    times = "" if len(wrap.at) == 1 else f" and {len(wrap.at) - 1} times more"
    place = sheet.place(int(rows[wrap.at[0]]))
    return f"time goes back by {wrap.period:.10g} s in {place}{times}: {cause}; this is undone"


def _resolve_repeats(
    sheet: Sheet, time_column: TimeColumn, rows: IntArray, times: FloatArray, copies: bool
) -> tuple[IntArray, FloatArray, str]:
    """Rows with times, and a note: at the stated rate, spread evenly, or the first row of each time."""
    repeats = timeline.find_repeats(times)
    rate, dropping = sheet.rig.table.rate, sheet.rig.table.bad_rows == "drop"
    if rate is not None:
        return rows, rows / rate, f"time repeats ({repeats.text}): rows come at [table] rate = {rate:g} Hz"
    if repeats.spread is not None and not copies:
        return (
            rows,
            repeats.spread,
            f"time repeats ({repeats.text}): rows are spread evenly between the stamps",
        )
    if dropping:
        first = np.concatenate(([True], np.diff(times) != 0))
        return rows[first], times[first], f"time repeats ({repeats.text}): the first row of each stamp stays"
    place = sheet.place(int(rows[np.flatnonzero(np.diff(times) == 0)[0] + 1]))
    what = "copies of the same row" if copies else "no even number to spread"
    span = float(times[-1] - times[0])
    likely = (len(rows) - int(repeats.sizes[-1])) / span if span > 0 else 0.0
    example = f" = {likely:.4g}" if likely else ""
    raise TableError(
        f"{sheet.path}: expected a time for each row, found a time that repeats in "
        f"{time_column.label(sheet)}, the first in {place}: {repeats.text}, {what}. In {sheet.rig.path}, "
        f"[table] rate{example} (Hz) puts the rows at that rate, or "
        '[table] bad_rows = "drop" keeps the first row of each stamp'
    )


def _select_stretch(
    sheet: Sheet,
    time_column: TimeColumn,
    rows: IntArray,
    times: FloatArray,
    stretches: list[IntArray],
    notes: list[str],
) -> tuple[IntArray, IntArray]:
    """Indices of the selected stretch and of all others; adds a note about the choice."""
    part = sheet.rig.table.part
    if sum(map(len, stretches)) < (1.0 - MAX_OUT_OF_ORDER) * len(rows) and sheet.rig.table.bad_rows != "drop":
        back = np.flatnonzero(np.diff(times) < 0) + 1
        raise TableError(
            f"{sheet.path}: expected times that increase from row to row, found {len(back)} steps back in "
            f"{time_column.label(sheet)}, the first in {sheet.place(int(rows[back[0]]))}: are the rows "
            "sorted by time?"
        )
    if part is not None and part > len(stretches):
        raise TableError(
            f"{sheet.rig.path}: table.part: expected a part from 1 to {len(stretches)} of {sheet.path}, "
            f"found {part}"
        )
    if len(stretches) == 1:
        return stretches[0], np.zeros(0, dtype=np.int64)
    listed = [
        f"part {number}: {len(part_rows)} rows, {sheet.columns.row_word}s "
        f"{sheet.columns.lines[part_rows[0]]} to {sheet.columns.lines[part_rows[-1]]}"
        for number, part_rows in enumerate((rows[stretch] for stretch in stretches), 1)
    ]
    shown = "; ".join(listed[:6]) + (f"; and {len(listed) - 6} more" if len(listed) > 6 else "")
    restart = int(stretches[1][0])
    cause = (
        f"time goes back from {times[stretches[0][-1]]:.10g} to {times[restart]:.10g} s in "
        f"{sheet.place(int(rows[restart]))} ({_restart_cause(times, stretches)})"
    )
    if part is None and sheet.rig.table.bad_rows != "drop":
        raise TableError(
            f"{sheet.path}: expected one stretch of increasing times in {time_column.label(sheet)}, found "
            f"{len(stretches)}: {cause}: {shown}. Choose one in {sheet.rig.path} with [table] part = 1, …"
        )
    number = part - 1 if part is not None else int(np.argmax([len(stretch) for stretch in stretches]))
    notes.append(f"{cause}; part {number + 1} is taken: {shown}")
    others = [np.arange(s[0], s[-1] + 1) for other, s in enumerate(stretches) if other != number]
    return stretches[number], np.concatenate(others)


def _restart_cause(times: FloatArray, stretches: list[IntArray]) -> str:
    before, after = float(times[stretches[0][-1]]), float(times[stretches[1][0]])
    near = timeline.MAX_STEP * timeline.median_step(times)
    if len(stretches) > len(times) // (4 * timeline.MAX_WRONG_ROWS):
        return "again and again: are the rows sorted by time?"
    if abs(after - float(times[stretches[0][0]])) <= near or abs(after) <= near:
        return "the clock restarts: a reboot, or two recordings in one file"
    for period, name in ((DAY, "a day"), (HOUR, "an hour, as at the end of summer time")):
        if abs(before - after - period) <= 0.01 * period:
            return f"by about {name}"
    return "the clock was set back"


def time_notes(sheet: Sheet, time_column: TimeColumn, t: FloatArray, row: IntArray) -> list[str]:
    """Describe the time of a table: column, unit, rate and holes, and a doubt about an unlikely rate.

    Args:
        sheet: the table.
        time_column: its time.
        t: times of the imported rows, (n,) s.
        row: numbers of these rows, (n,).

    Returns:
        Lines for users.
    """
    rate = 1.0 / float(np.median(np.diff(t)))
    line = f"time: {time_column.label(sheet)}, {rate:.6g} Hz, {_describe_holes(sheet, t, row)}"
    notes = [f"{line}; {time_column.alternatives}" if time_column.alternatives else line]
    if time_column.kind is not TimeKind.NUMBER:
        return notes
    raw = time_column.raw[row]
    if not MIN_RATE <= rate <= MAX_RATE:
        notes.append(
            f"are times in s? The median step is {1.0 / rate:.4g} s{_likely_unit(sheet, time_column, rate)}"
        )
    elif time_column.mapped.scale[0] == 1.0 and _counts_rows(raw):
        line = format_channel(sheet, time_column.mapped, Unit("s", 1e-3))
        notes.append(
            "are times in s? They go up by one from row to row, as milliseconds at 1 kHz do, for which "
            f"[channels] needs {line}, or a counter of rows"
        )
    return notes


def _describe_holes(sheet: Sheet, t: FloatArray, row: IntArray, max_listed: int = 3) -> str:
    after = timeline.rows_after_holes(t)
    if not len(after):
        return "no holes"
    lengths = t[after] - t[after - 1]
    longest = np.argsort(-lengths, kind="stable")[:max_listed]
    shown = ", ".join(
        f"{lengths[number]:.6g} s before {sheet.place(int(row[after[number]]))}" for number in sorted(longest)
    )
    if len(after) == 1:
        return f"1 hole: {shown}"
    return f"{len(after)} holes, {'the longest ' if len(after) > max_listed else ''}{shown}"


def _likely_unit(sheet: Sheet, time_column: TimeColumn, rate: float) -> str:
    """Likely unit of the times, with its line in the rig file, for messages; empty if there is none."""
    per_unit = rate * float(time_column.mapped.scale[0])  # rows per unit of the column
    likely = {
        name: abs(np.log10(per_unit / unit / TYPICAL_RATE))
        for name, unit in TIME_UNITS.items()
        if MIN_RATE <= per_unit / unit <= MAX_RATE
    }
    if not likely:
        return ""
    name = min(likely, key=lambda unit: likely[unit])
    line = format_channel(sheet, time_column.mapped, Unit("s", TIME_UNITS[name]))
    return f"; in {name} they would come at {per_unit / TIME_UNITS[name]:.4g} Hz: [channels] {line}"
