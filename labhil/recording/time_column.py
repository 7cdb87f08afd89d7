"""The time of a table: which column it is, and the rows that follow one another in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labhil.errors import TableError
from labhil.recording import timeline
from labhil.recording.bad_rows import MOST_DROPPED
from labhil.recording.formats.time_text import DAY, TimeKind
from labhil.recording.sheet import MappedSignal, Sheet
from labhil.recording.stated_units import format_channel
from labhil.recording.units import Unit
from labhil.signals import FloatArray, IntArray

Mask = NDArray[np.bool_]

SLOWEST_RATE, FASTEST_RATE = 0.5, 1e5
"""Hz; such rigs are sampled between these. Outside, the times are likely not in s."""

USUAL_RATE = 100.0
"""Hz; of several units that give a likely rate, the one that comes nearest counts as the likely one."""

TIME_UNITS = {"ms": 1e-3, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "days": DAY}

COUNTERS = (2.0**16, 2.0**32)
HOUR = 3600.0
MOST_OUT_OF_ORDER = 0.1
"""Share of rows outside all stretches of increasing times beyond which these are not what was recorded."""

MOST_HOLES = 3
"""Holes that are listed, the longest first."""


@dataclass(frozen=True)
class TimeColumn:
    """A column that holds the time: ``seconds`` (rows,), NaN where there is none.

    ``passed_over`` says which other columns could have been it, and what speaks against them.
    """

    mapped: MappedSignal
    seconds: FloatArray
    raw: FloatArray
    kind: TimeKind
    passed_over: str = ""

    def label(self, sheet: Sheet) -> str:
        """The column and its unit, for messages."""
        scale = float(self.mapped.scale[0])
        unit = "s" if scale == 1.0 else f"s, × {scale:g}"
        if self.kind is not TimeKind.NUMBER:
            unit = f"{self.kind}, UTC where no zone stands" if self.kind is TimeKind.DATE else str(self.kind)
        return f"column {sheet.column(self.mapped.columns[0])} ({unit})"


@dataclass(frozen=True)
class RowTimes:
    """The rows in time: ``t`` (rows,) in s from any zero, NaN where a row does not follow the others.

    ``elsewhere`` (rows,) are rows of stretches that were not asked for; ``notes`` say what was done.
    """

    t: FloatArray
    elsewhere: Mask
    notes: tuple[str, ...] = ()


def read_time_column(sheet: Sheet, mapped: MappedSignal) -> TimeColumn:
    """Read one column as a time."""
    stamps = sheet.columns.times(mapped.columns[0])
    raw = stamps.values
    seconds = mapped.to_signal_unit(raw[:, None])[:, 0] if stamps.kind is TimeKind.NUMBER else raw
    return TimeColumn(mapped, np.where(sheet.columns.complete, seconds, np.nan), raw, stamps.kind)


def choose_time_column(sheet: Sheet, candidates: Sequence[MappedSignal]) -> TimeColumn:
    """Choose the column that is complete and increases, a clock rather than a counter of the rows."""
    clocks = [read_time_column(sheet, mapped) for mapped in candidates]
    if len(clocks) == 1:
        return clocks[0]
    most = max(int(np.count_nonzero(np.isfinite(clock.seconds))) for clock in clocks)
    merits = [_merits(clock, most) for clock in clocks]
    best = max(range(len(clocks)), key=lambda number: (tuple(merits[number].values()), -number))
    chosen = clocks[best]
    others = []
    for clock, merit in zip(clocks, merits, strict=True):
        if clock is not chosen:
            worse = [why for why, good in merit.items() if not good and merits[best][why]]
            others.append(
                f"{sheet.column(clock.mapped.columns[0])} is not used{': it ' + worse[0] if worse else ''}"
            )
    return TimeColumn(chosen.mapped, chosen.seconds, chosen.raw, chosen.kind, "; ".join(others))


def _merits(clock: TimeColumn, most: int) -> dict[str, bool]:
    """What speaks for a column, weightiest first, each named by what it says against one without it."""
    known = clock.seconds[np.isfinite(clock.seconds)]
    rising = np.diff(known) > 0
    usual = timeline.median_step(known)
    rate = 1.0 / usual if usual > 0 else 0.0
    raw = clock.raw[np.isfinite(clock.raw)]
    return {
        "is not complete": len(known) >= (1.0 - MOST_DROPPED) * most,
        "does not increase from row to row": len(rising) > 0 and bool(np.mean(rising) >= 1.0 - MOST_DROPPED),
        "counts the rows": clock.kind is not TimeKind.NUMBER or not _counts(raw),
        "has an unlikely rate": SLOWEST_RATE <= rate <= FASTEST_RATE,
    }


def _counts(raw: FloatArray) -> bool:
    """Whether numbers go up by one from row to row."""
    return len(raw) > 1 and bool(np.mean(np.diff(raw) == 1.0) >= 1.0 - MOST_DROPPED)


def order_rows(sheet: Sheet, clock: TimeColumn, copied: Mask) -> RowTimes:
    """Find the rows that follow one another in time, undo wraps, and spread repeated stamps.

    ``copied`` (rows,) marks rows whose values are those of the row before. TableError names the cause and
    the way out where stamps repeat without order, run backwards, or begin anew.
    """
    rows = np.flatnonzero(np.isfinite(clock.seconds))
    times = clock.seconds[rows] - (clock.mapped.offset[0] if clock.kind is TimeKind.NUMBER else 0.0)
    nowhere = np.zeros(len(clock.seconds), dtype=np.bool_)
    if len(rows) < 2:
        return RowTimes(clock.seconds, nowhere)
    _refuse_backwards(sheet, clock, rows, times)
    notes = []
    wrap = timeline.find_wrap(times, _periods(clock))
    if wrap is not None:
        times = timeline.unwrap(times, wrap)
        notes.append(_wrap_note(sheet, clock, rows, wrap))
    repeated = np.flatnonzero(np.diff(times) == 0) + 1
    if len(repeated) > max(1.0, MOST_DROPPED * len(rows)):
        rows, times, note = _resolve_repeats(sheet, clock, rows, times, bool(copied[rows[repeated]].all()))
        notes.append(note)
    runs = timeline.increasing_stretches(times)
    chosen, elsewhere = _choose_stretch(sheet, clock, rows, times, runs, notes)
    t = np.full(len(clock.seconds), np.nan)
    t[rows[chosen]] = times[chosen]
    nowhere[rows[elsewhere]] = True
    return RowTimes(t, nowhere, tuple(notes))


def _refuse_backwards(sheet: Sheet, clock: TimeColumn, rows: IntArray, times: FloatArray) -> None:
    steps = np.diff(times)
    if len(steps) > 1 and np.mean(steps < 0) > 0.9:
        raise TableError(
            f"{sheet.path}: expected times that increase, found {clock.label(sheet)} running backwards from "
            f"{sheet.place(int(rows[0]))} on: the newest row stands first; sort the rows by time"
        )


def _periods(clock: TimeColumn) -> list[tuple[float, float | None]]:
    """The clocks that begin anew, as (period, reading at which they do), in s."""
    day: list[tuple[float, float | None]] = [(DAY, DAY)]
    if clock.kind is TimeKind.DATE:
        return [(HOUR, None)]
    if clock.kind is TimeKind.OF_DAY:
        return [*day, (DAY / 2, 13 * HOUR), (HOUR, HOUR), (HOUR, None)]
    of_counters = [(turns * unit, turns * unit) for turns in COUNTERS for unit in (1e-6, 1e-3)]
    whole = clock.raw[np.isfinite(clock.raw)]
    if (whole == np.rint(whole)).all():
        scale = float(clock.mapped.scale[0])
        # counters with a sign begin anew at half their period
        of_counters += [(turns * scale, turns * scale / part) for turns in COUNTERS for part in (1, 2)]
    return day + of_counters


def _wrap_note(sheet: Sheet, clock: TimeColumn, rows: IntArray, wrap: timeline.Wrap) -> str:
    names = {DAY: "the clock of a day passes midnight", DAY / 2: "a clock of twelve hours begins anew"}
    if clock.kind is not TimeKind.NUMBER:
        names[HOUR] = "the hour is set back, as at the end of summer time, or begins anew"
    cause = names.get(wrap.period)
    if cause is None:
        scale = float(clock.mapped.scale[0])
        bits = 32 if any(np.isclose(wrap.period, 2.0**32 * unit) for unit in (scale, 1e-3, 1e-6)) else 16
        cause = f"a counter of {bits} bits begins anew"
    times = "" if len(wrap.at) == 1 else f" and {len(wrap.at) - 1} times more"
    place = sheet.place(int(rows[wrap.at[0]]))
    return f"time goes back by {wrap.period:.10g} s in {place}{times}: {cause}; this is undone"


def _resolve_repeats(
    sheet: Sheet, clock: TimeColumn, rows: IntArray, times: FloatArray, copies: bool
) -> tuple[IntArray, FloatArray, str]:
    """Rows and their times where stamps repeat: at the stated rate, spread, or the first of each stamp."""
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
    line = sheet.place(int(rows[np.flatnonzero(np.diff(times) == 0)[0] + 1]))
    what = "copies of the same row" if copies else "no even number to spread"
    span = float(times[-1] - times[0])
    likely = (len(rows) - int(repeats.sizes[-1])) / span if span > 0 else 0.0
    example = f" = {likely:.4g}" if likely else ""
    raise TableError(
        f"{sheet.path}: expected a time for each row, found a time that repeats in {clock.label(sheet)}, "
        f"the first in {line}: {repeats.text}, {what}. In {sheet.rig.path}, [table] rate{example} (Hz) puts "
        'the rows at that rate, or [table] bad_rows = "drop" keeps the first row of each stamp'
    )


def _choose_stretch(
    sheet: Sheet, clock: TimeColumn, rows: IntArray, times: FloatArray, runs: list[IntArray], notes: list[str]
) -> tuple[IntArray, IntArray]:
    """The stretch that counts, and the rows of the others."""
    part = sheet.rig.table.part
    if sum(map(len, runs)) < (1.0 - MOST_OUT_OF_ORDER) * len(rows) and sheet.rig.table.bad_rows != "drop":
        back = np.flatnonzero(np.diff(times) < 0) + 1
        raise TableError(
            f"{sheet.path}: expected times that increase from row to row, found {len(back)} steps back in "
            f"{clock.label(sheet)}, the first in {sheet.place(int(rows[back[0]]))}: are the rows sorted by "
            "time?"
        )
    if part is not None and part > len(runs):
        raise TableError(
            f"{sheet.rig.path}: table.part: expected a part from 1 to {len(runs)} of {sheet.path}, "
            f"found {part}"
        )
    if len(runs) == 1:
        return runs[0], np.zeros(0, dtype=np.int64)
    listed = [
        f"part {number}: {len(run)} rows, {sheet.columns.row_word}s {sheet.columns.lines[rows[run[0]]]} to "
        f"{sheet.columns.lines[rows[run[-1]]]}"
        for number, run in enumerate(runs, 1)
    ]
    shown = "; ".join(listed[:6]) + (f"; and {len(listed) - 6} more" if len(listed) > 6 else "")
    restart = int(runs[1][0])
    cause = (
        f"time goes back from {times[runs[0][-1]]:.10g} to {times[restart]:.10g} s in "
        f"{sheet.place(int(rows[restart]))} ({_cause(times, runs)})"
    )
    if part is None and sheet.rig.table.bad_rows != "drop":
        raise TableError(
            f"{sheet.path}: expected one stretch of increasing times in {clock.label(sheet)}, found "
            f"{len(runs)}: {cause}: {shown}. Choose one in {sheet.rig.path} with [table] part = 1, …"
        )
    number = part - 1 if part is not None else int(np.argmax([len(run) for run in runs]))
    notes.append(f"{cause}; part {number + 1} is taken: {shown}")
    spans = [np.arange(run[0], run[-1] + 1) for place, run in enumerate(runs) if place != number]
    return runs[number], np.concatenate(spans)


def _cause(times: FloatArray, runs: list[IntArray]) -> str:
    before, after = float(times[runs[0][-1]]), float(times[runs[1][0]])
    near = timeline.REACH * timeline.median_step(times)
    if len(runs) > len(times) // (4 * timeline.LONGEST_SLIP):
        return "again and again: are the rows sorted by time?"
    if abs(after - float(times[runs[0][0]])) <= near or abs(after) <= near:
        return "the clock begins anew: a restart, or two recordings in one file"
    for period, name in ((DAY, "a day"), (HOUR, "an hour, as at the end of summer time")):
        if abs(before - after - period) <= 0.01 * period:
            return f"by about {name}"
    return "the clock was set back"


def time_notes(sheet: Sheet, clock: TimeColumn, t: FloatArray, row: IntArray) -> list[str]:
    """Which column served as time, its unit, rate and holes; and a doubt where the rate is an unlikely one.

    ``t`` and ``row`` (n,) are the times and numbers of the rows that were kept.
    """
    rate = 1.0 / float(np.median(np.diff(t)))
    line = f"time: {clock.label(sheet)}, {rate:.6g} Hz, {_holes(sheet, t, row)}"
    notes = [f"{line}; {clock.passed_over}" if clock.passed_over else line]
    if clock.kind is not TimeKind.NUMBER:
        return notes
    raw = clock.raw[row]
    if not SLOWEST_RATE <= rate <= FASTEST_RATE:
        notes.append(f"are times in s? The median step is {1.0 / rate:.4g} s{_likely(sheet, clock, rate)}")
    elif clock.mapped.scale[0] == 1.0 and _counts(raw):
        notes.append(
            "are times in s? They go up by one from row to row, as milliseconds at 1 kHz do, for which "
            f"[channels] needs {format_channel(sheet, clock.mapped, Unit('s', 1e-3))}, or a counter of rows"
        )
    return notes


def _holes(sheet: Sheet, t: FloatArray, row: IntArray) -> str:
    after = timeline.hole_steps(t)
    if not len(after):
        return "no holes"
    lengths = t[after] - t[after - 1]
    longest = np.argsort(-lengths, kind="stable")[:MOST_HOLES]
    shown = ", ".join(
        f"{lengths[number]:.6g} s before {sheet.place(int(row[after[number]]))}" for number in sorted(longest)
    )
    if len(after) == 1:
        return f"1 hole: {shown}"
    return f"{len(after)} holes, {'the longest ' if len(after) > MOST_HOLES else ''}{shown}"


def _likely(sheet: Sheet, clock: TimeColumn, rate: float) -> str:
    """Which unit the numbers of a time are likely in, with the line that says so; or nothing."""
    per_unit = rate * float(clock.mapped.scale[0])  # rows per unit of the column
    likely = {
        name: abs(np.log10(per_unit / unit / USUAL_RATE))
        for name, unit in TIME_UNITS.items()
        if SLOWEST_RATE <= per_unit / unit <= FASTEST_RATE
    }
    if not likely:
        return ""
    name = min(likely, key=lambda unit: likely[unit])
    line = format_channel(sheet, clock.mapped, Unit("s", TIME_UNITS[name]))
    return f"; in {name} they would come at {per_unit / TIME_UNITS[name]:.4g} Hz: [channels] {line}"
