"""The tables of others, ours out: columns by the rig file's rules, in our names and in SI units."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labhil.bounds import read_file
from labhil.errors import DiskFailedError, RecordingFailedError, TableError, suggestion
from labhil.recording.bad_rows import WHY, bad_rows, finite_rows
from labhil.recording.channel_keys import with_channel_keys, with_stated_hold
from labhil.recording.columns import read_columns
from labhil.recording.formats.time_text import TimeKind
from labhil.recording.recording import IMPORT, TIME_COLUMN
from labhil.recording.rig_attachments import rig_attachments
from labhil.recording.sheet import Mapped, Sheet
from labhil.recording.slow_channels import fill_slow
from labhil.recording.stated_units import check_units
from labhil.recording.time_column import Clock, Ordered, best_clock, order_rows, read_clock, time_notes
from labhil.recording.writer import RecordingWriter, media_type
from labhil.rig import RigFile
from labhil.rig_sections import Channel, Column
from labhil.signals import Batch, Direction, FloatArray, IntArray, Signal, Stream

TIME_COLUMNS = ("t", "time", "timestamp")
UNSTEADY = 0.02
"""A mean rate that differs from the median one by more than this share is reported."""

SMALLER_UNITS = (1e-3, 1e-6, 1e-9)
SLOWEST = 2.0
"""Units of time, of which a message proposes the first that brings the usual step below so many s."""

LONGEST_TIME = 9e9
"""s; what fits into int64 nanoseconds."""

EDGE = "edge"
PART = "part"

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class ImportedTable:
    """A table in our names and SI units.

    ``t`` (n,) is in s from the first kept row, which stood at ``time_origin`` in the file; ``values`` has
    shape (n, stream.width); ``row`` (n,) is each kept row's number among the ``rows`` of the file, so
    that what was dropped is a hole in it. ``dropped`` counts bad rows by reason, ``outside`` for each
    limited signal the kept rows that lie outside its limits, and ``flagged`` (n,) marks these. ``notes`` say
    what served as the time, and how the rows came to be; ``first_bad`` quotes the first bad row by reason.
    ``time_column`` is what the column of the time is called in the file, "" where there is none.
    """

    source: Path
    sha256: str
    rig: RigFile
    stream: Stream
    row: IntArray
    t: FloatArray
    values: FloatArray
    time_origin: float
    rows: int
    dropped: Mapping[str, int]
    outside: Mapping[str, int]
    flagged: Mask
    notes: tuple[str, ...] = ()
    first_bad: Mapping[str, str] = field(default_factory=dict)
    time_column: str = ""

    def __len__(self) -> int:
        return len(self.row)


def import_table(data: Path, rig: RigFile) -> ImportedTable:
    """Read a table by the rules of ``[table]`` and ``[channels]`` in a rig file.

    TableError names the file, the column, what was expected and what was found: where a column is missing,
    where no row is good, where the time is ambiguous or units differ, for any bad row if the rig file says
    ``bad_rows = "fail"``, and for many of them unless it says ``"drop"``.
    """
    content, sha256 = _content(data)
    sheet = Sheet(data, read_columns(data, content, rig.table, _wanted_columns(rig)), rig)
    if sheet.columns.files:
        sha256 = _digest(data, sheet.columns.files)
    mapped, clock = _signals(sheet), _clock(sheet)
    timed = [clock.mapped] if clock is not None and clock.kind is TimeKind.NUMBER else []
    units = check_units(sheet, [*timed, *mapped])
    taken = [(column, _scale(sheet, column)) for column in mapped]
    ordered = _order_in_time(sheet, clock, taken)
    filled = fill_slow(sheet, taken, ordered.t)
    time = [] if clock is None else [(clock.mapped, clock.seconds[:, None])]
    finite = finite_rows(sheet, [*time, *filled.taken])
    followed = np.isfinite(ordered.t)
    row = np.flatnonzero(finite & followed)
    excused = filled.edge | ordered.elsewhere
    bad = bad_rows(sheet, [*time, *filled.taken], finite, followed, excused)
    t = _seconds(sheet, row, ordered.t)
    notes = [*sheet.columns.notes, *units, *ordered.notes, *filled.notes]
    notes += [_rate_note(sheet)] if clock is None else time_notes(sheet, clock, t, row)
    stream = Stream("state", tuple(column.signal for column in mapped), float(1.0 / np.median(np.diff(t))))
    values = np.hstack([scaled for _, scaled in filled.taken])[row]
    values, applied = with_channel_keys(stream, rig.channels, t, values)
    outside, flagged = _outside(stream, values, rig)
    also = {EDGE: filled.edge & ~ordered.elsewhere, PART: ordered.elsewhere & sheet.columns.complete}
    return ImportedTable(
        source=data,
        sha256=sha256,
        rig=rig,
        stream=stream,
        row=row,
        t=t,
        values=values,
        time_origin=0.0 if clock is None else float(clock.seconds[row[0]]),
        rows=len(finite),
        dropped={
            **bad.counts,
            **{reason: int(np.count_nonzero(mask)) for reason, mask in also.items() if mask.any()},
        },
        outside=outside,
        flagged=flagged,
        notes=(*notes, *applied),
        first_bad=bad.first,
        time_column=_name_of(sheet, clock),
    )


def with_episode(rig: RigFile, episode: int | None) -> RigFile:
    """The rig file with another ``[table] episode``; itself for None."""
    if episode is None:
        return rig
    return rig.model_copy(update={"table": rig.table.model_copy(update={"episode": episode})})


def write_import(table: ImportedTable, out: Path) -> Path:
    """Write an imported table as a recording, in place of one that is there; returns its path.

    The device bears the name of the rig's kind; the rig file and the counts of what was dropped go with
    it. The same table always makes the same bytes: the host's time is the table's, from 0.
    """
    t_ns = np.rint(table.t * 1e9).astype(np.int64)
    metadata = {
        "source": table.source.name,
        "sha256": table.sha256,
        "rows": str(table.rows),
        "kept": str(len(table)),
        "time_origin": repr(table.time_origin),
        **({TIME_COLUMN: table.time_column} if table.time_column else {}),
        **{f"dropped.{reason}": str(count) for reason, count in table.dropped.items()},
        **{f"outside_limits.{name}": str(count) for name, count in table.outside.items()},
        **{f"note.{number}": note for number, note in enumerate(table.notes)},
    }
    with RecordingWriter(out, flush_interval=math.inf) as writer:
        try:
            for name, content in rig_attachments(table.rig).items():
                writer.attach(name, media_type(name), content)
            writer.metadata(IMPORT, metadata)
            channel = writer.add_stream(table.rig.rig.kind, table.stream, {"source": table.source.name})
            writer.write(channel, Batch(table.row, t_ns, t_ns, table.values))
            writer.finish()
        except RecordingFailedError as failure:
            # half an import is worth nothing: the table is still there
            writer.part.unlink(missing_ok=True)
            raise DiskFailedError(
                f"{out}: the disk failed, nothing was imported: {failure.__cause__}; make room and try again"
            ) from failure
    return out


def describe_import(table: ImportedTable) -> list[str]:
    """What a person wants to know of an import, a line each."""
    signals = ", ".join(f"{signal.name} [{signal.unit}]" for signal in table.stream.signals)
    extent = f"{table.t[-1]:.6g} s at {table.stream.rate:.6g} Hz"
    mean = (len(table) - 1) / table.t[-1]
    if abs(mean / table.stream.rate - 1.0) > UNSTEADY:
        extent += f" (by the median step; {mean:.4g} rows a second on average)"
    lines = [f"{table.source}: {len(table)} of {table.rows} rows, {extent}", f"signals: {signals}"]
    lines += table.notes
    why = {
        **WHY,
        EDGE: "before the first or after the last sample of a slower channel",
        PART: "in other parts",
    }
    lines += [
        f"dropped: {count} rows {why[reason]}{_first_of(table, reason)}"
        for reason, count in table.dropped.items()
        if count
    ]
    lines += [
        f"outside [limits], kept: {count} rows of {name}" for name, count in table.outside.items() if count
    ]
    return lines


def _first_of(table: ImportedTable, reason: str) -> str:
    return f", the first in {table.first_bad[reason]}" if reason in table.first_bad else ""


def _content(path: Path) -> tuple[bytes, str]:
    """The bytes of a file and their SHA-256; of a folder none, and the SHA-256 over its files by name."""
    try:
        if not path.is_dir():
            content = read_file(path)
            return content, hashlib.sha256(content).hexdigest()
        inside = sorted(inner for inner in path.iterdir() if inner.is_file())
    except OSError as error:
        raise TableError(f"{path}: cannot be read: {error.strerror}") from error
    return b"", _digest(path, inside)


def _digest(path: Path, files: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    try:
        for file in files:
            digest.update(file.name.encode() + b"\x00" + file.read_bytes())
    except OSError as error:
        raise TableError(f"{path}: cannot be read: {error.strerror}") from error
    return digest.hexdigest()


def _wanted_columns(rig: RigFile) -> tuple[str, ...]:
    """The column names that the rig file asks for: the time, the outputs, the others."""
    kind = rig.kind
    signals = (*kind.outputs, *kind.inputs, *kind.optional, *kind.auxiliary)
    if not rig.channels:
        return (*TIME_COLUMNS, *(column for signal in signals for column in signal.columns()))
    channels = [rig.channels[name] for name in ("t", *(s.name for s in signals)) if name in rig.channels]
    sources = (source for channel in channels for source in channel.sources())
    return tuple(source for source in sources if isinstance(source, str))


def _signals(sheet: Sheet) -> tuple[Mapped, ...]:
    """The signals that are in the file, with their columns."""
    mapped = tuple(
        _map_signal(sheet, with_stated_hold(signal, channel), channel)
        for signal in sheet.rig.kind.signals()
        if (channel := _channel_of(sheet, signal)) is not None
    )
    present = {column.signal.name for column in mapped}
    kind = sheet.rig.kind
    outputs = [signal.name for signal in kind.outputs]
    if not any(present >= set(names) for names in kind.driven_by):
        raise TableError(_missing(sheet, "an input", [" and ".join(names) for names in kind.driven_by]))
    if not present & set(outputs):
        raise TableError(_missing(sheet, "an output", outputs))
    return mapped


def _channel_of(sheet: Sheet, signal: Signal) -> Channel | None:
    """Where a signal stands: as [channels] says, or without that in the columns that bear its name."""
    if sheet.rig.channels:
        return sheet.rig.channels.get(signal.name)
    columns: list[Column] = list(signal.columns())
    return Channel(columns=columns) if any(map(sheet.columns.find, signal.columns())) else None


def _missing(sheet: Sheet, what: str, names: list[str]) -> str:
    expected = f"{sheet.path}: {what} is missing: expected {' or '.join(names)}"
    if sheet.rig.channels:
        return f"{expected} in [channels] of {sheet.rig.path}, found {', '.join(sheet.rig.channels)}"
    near = "".join(suggestion(name, sheet.columns.names or ()) for name in names)
    return (
        f"{expected} among the columns, or a [channels] table that maps it{near}; found {sheet.available()}"
    )


def _clock(sheet: Sheet) -> Clock | None:
    """The column of the time, or None where the rows come at a rate."""
    time = Signal("t", "s", Direction.STATUS)
    if "t" in sheet.rig.channels:
        return read_clock(sheet, _map_signal(sheet, time, sheet.rig.channels["t"]))
    names = [name for name in TIME_COLUMNS if sheet.columns.find(name)]
    if names:
        return best_clock(sheet, [_map_signal(sheet, time, Channel(column=name)) for name in names])
    if sheet.rig.table.rate is None:
        raise TableError(
            f"{sheet.path}: no time: expected a column {' or '.join(TIME_COLUMNS)} (s), a [channels] entry "
            f"for t, or [table] rate (Hz) in {sheet.rig.path}; found {sheet.available()}"
        )
    return None


def _name_of(sheet: Sheet, clock: Clock | None) -> str:
    names = sheet.columns.names
    return "" if clock is None or names is None else names[clock.mapped.columns[0]]


def _order_in_time(sheet: Sheet, clock: Clock | None, taken: list[tuple[Mapped, FloatArray]]) -> Ordered:
    """The rows in time: by the column of the time, or one after another at the rate of ``[table]``."""
    rows = len(sheet.columns.counts)
    if clock is None:
        return Ordered(np.arange(rows) / float(sheet.rig.table.rate or 1.0), np.zeros(rows, dtype=np.bool_))
    values = np.hstack([scaled for _, scaled in taken])
    copied = np.zeros(rows, dtype=np.bool_)
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    copied[1:] = same.all(axis=1)
    return order_rows(sheet, clock, copied)


def _rate_note(sheet: Sheet) -> str:
    return f"time: no column; rows come at [table] rate = {sheet.rig.table.rate:g} Hz"


def _map_signal(sheet: Sheet, signal: Signal, channel: Channel) -> Mapped:
    sources = channel.sources()
    if len(sources) != signal.width:
        raise TableError(
            f"{sheet.rig.path}: channels.{signal.name}: expected {signal.width} columns, found {len(sources)}"
        )
    places = tuple(_place(sheet, signal.name, source) for source in sources)
    scale, offset = (np.broadcast_to(factor, len(places)) for factor in (channel.scale, channel.offset))
    return Mapped(signal, places, np.asarray(scale, float), np.asarray(offset, float))


def _place(sheet: Sheet, name: str, source: Column) -> int:
    """The number of a column that is given by name or by number."""
    names = sheet.columns.names or ()
    if isinstance(source, int):
        if source < sheet.columns.width:
            return source
        raise TableError(f"{sheet.path}: {name}: expected a column {source}, found {sheet.available()}")
    places = sheet.columns.find(source)
    if len(places) == 1:
        return places[0]
    if places:
        same = ", ".join(names[place] for place in places)
        raise TableError(f"{sheet.path}: {name}: expected one column {source!r}, found several: {same}")
    near = suggestion(source, names)
    raise TableError(f"{sheet.path}: {name}: expected a column {source!r}{near}, found {sheet.available()}")


def _scale(sheet: Sheet, mapped: Mapped) -> FloatArray:
    raw = np.column_stack([sheet.columns.numbers(column, mapped.signal.hold) for column in mapped.columns])
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite makes a bad row
        return mapped.in_ours(raw)


def _seconds(sheet: Sheet, row: IntArray, t: FloatArray) -> FloatArray:
    """Times of the kept rows in s, from the first."""
    if len(row) < 2:
        raise TableError(
            f"{sheet.path}: expected two good rows or more with increasing times, found {len(row)}"
        )
    seconds: FloatArray = t[row] - t[row[0]]
    if seconds[-1] > LONGEST_TIME:
        step = float(np.median(np.diff(seconds)))
        scale = next((factor for factor in SMALLER_UNITS if step * factor < SLOWEST), None)
        hint = "" if scale is None else f"; with scale = {scale:g} they span {seconds[-1] * scale:g} s"
        raise TableError(
            f"{sheet.path}: expected times in s, found a span of {seconds[-1]:g} s; [channels] t can have a "
            f"scale{hint}"
        )
    return seconds


def _outside(stream: Stream, values: FloatArray, rig: RigFile) -> tuple[dict[str, int], Mask]:
    flagged = np.zeros(len(values), dtype=np.bool_)
    counts = {}
    for signal in stream.signals:
        limit = rig.limits.get(signal.name)
        if limit is None:
            continue
        columns = values[:, stream.columns_of(signal.name)]
        out = ((columns < limit.min) | (columns > limit.max)).any(axis=1)
        counts[signal.name] = int(np.count_nonzero(out))
        flagged |= out
    return counts, flagged
