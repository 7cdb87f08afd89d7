"""The tables of others, ours out: columns by the rig file's rules, in our names and in SI units."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labhil.errors import DiskFailedError, RecordingFailedError, TableError, suggestion
from labhil.recording.columns import read_columns
from labhil.recording.formats.columns import Columns
from labhil.recording.reader import RIG_ATTACHMENT
from labhil.recording.timeline import longest_run
from labhil.recording.writer import RecordingWriter
from labhil.rig import Channel, Column, RigFile
from labhil.signals import Batch, Direction, FloatArray, IntArray, Signal, Stream
from labhil.terminal import printable_name

TIME_COLUMNS = ("t", "time", "timestamp")
MOST_NAMES = 40
"""Columns that a message lists."""

UNSTEADY = 0.02
"""A mean rate that differs from the median one by more than this share is told."""

LONGEST_TIME = 9e9
"""s; what fits into int64 nanoseconds."""

FIELD_COUNT = "field_count"
NOT_FINITE = "not_finite"
TIME = "time"

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class ImportedTable:
    """A table in our names and SI units.

    ``t`` (n,) is in s from the first kept row, which stood at ``time_origin`` in the file; ``values`` has
    shape (n, stream.width); ``row`` (n,) is each kept row's number among the ``rows`` of the file, so
    that what was dropped is a hole in it. ``dropped`` counts bad rows by reason, ``outside`` for each
    limited signal the kept rows that lie outside its limits, and ``flagged`` (n,) marks these. ``notes`` say
    how the rows came to be, where that is not plain.
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

    def __len__(self) -> int:
        return len(self.row)


class _Mapped(NamedTuple):
    """A signal and the columns it is made of, each with its scale and offset."""

    signal: Signal
    columns: tuple[int, ...]
    scale: FloatArray
    offset: FloatArray


@dataclass(frozen=True)
class _Sheet:
    """A file, its columns, and the rig file that says how to read them."""

    path: Path
    columns: Columns
    rig: RigFile

    def available(self) -> str:
        """What columns there are, for messages."""
        if self.columns.names is None:
            return f"no header and {self.columns.width} columns, 0 to {self.columns.width - 1}"
        names = self.columns.names
        more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
        return f"the columns {', '.join(map(printable_name, names[:MOST_NAMES]))}{more}"

    def line(self, row: int) -> str:
        """Where a row stands, for messages."""
        return f"{self.path}, {self.columns.row_word} {self.columns.lines[row]}"


def import_table(data: Path, rig: RigFile) -> ImportedTable:
    """Read a table by the rules of ``[table]`` and ``[channels]`` in a rig file.

    TableError names the file, the column, what was expected and what was found: where a column is
    missing, where no row is good, and for any bad row if the rig file says ``bad_rows = "fail"``.
    """
    content, sha256 = _content(data)
    sheet = _Sheet(data, read_columns(data, content, rig.table, _wanted(rig)), rig)
    mapped, time_channel = _signals(sheet), _time_channel(sheet)
    taken = [(one, _scaled(sheet, one)) for one in mapped]
    values = np.hstack([scaled for _, scaled in taken])
    time = None
    if time_channel is not None:
        taken.insert(0, (time_channel, _scaled(sheet, time_channel)))
        time = taken[0][1][:, 0]
    finite = _finite_rows(sheet, taken)
    row = _rows_in_time(sheet, finite, time)
    t = _seconds(sheet, row, time)
    stream = Stream("state", tuple(one.signal for one in mapped), float(1.0 / np.median(np.diff(t))))
    outside, flagged = _outside(stream, values[row], rig)
    complete = sheet.columns.complete
    return ImportedTable(
        source=data,
        sha256=sha256,
        rig=rig,
        stream=stream,
        row=row,
        t=t,
        values=values[row],
        time_origin=0.0 if time is None else float(time[row[0]]),
        rows=len(finite),
        dropped={
            FIELD_COUNT: int(np.count_nonzero(~complete)),
            NOT_FINITE: int(np.count_nonzero(complete & ~finite)),
            TIME: int(np.count_nonzero(finite)) - len(row),
        },
        outside=outside,
        flagged=flagged,
        notes=sheet.columns.notes,
    )


def write_import(table: ImportedTable, out: Path) -> Path:
    """Write an imported table as a recording, in place of one that is there; returns its path.

    The device bears the name of the rig's kind; the rig file and the counts of what was dropped go with
    it. The same table always makes the same samples: the host's time is the table's, from 0.
    """
    t_ns = np.rint(table.t * 1e9).astype(np.int64)
    told = {
        "source": table.source.name,
        "sha256": table.sha256,
        "rows": str(table.rows),
        "kept": str(len(table)),
        "time_origin": repr(table.time_origin),
        **{f"dropped.{reason}": str(count) for reason, count in table.dropped.items()},
        **{f"outside_limits.{name}": str(count) for name, count in table.outside.items()},
        **{f"note.{number}": note for number, note in enumerate(table.notes)},
    }
    with RecordingWriter(out) as writer:
        try:
            writer.attach(RIG_ATTACHMENT, "application/toml", table.rig.text.encode())
            writer.metadata("import", told)
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
        FIELD_COUNT: "wrong number of fields",
        NOT_FINITE: "text, NaN or nothing in a mapped column",
        TIME: "time outside the longest increasing run",
    }
    lines += [f"dropped: {count} rows, {why[reason]}" for reason, count in table.dropped.items() if count]
    lines += [
        f"outside [limits], kept: {count} rows of {name}" for name, count in table.outside.items() if count
    ]
    return lines


def _content(path: Path) -> tuple[bytes, str]:
    """The bytes of a file and their SHA-256; of a folder none, and the SHA-256 over its files by name."""
    try:
        if not path.is_dir():
            content = path.read_bytes()
            return content, hashlib.sha256(content).hexdigest()
        digest = hashlib.sha256()
        for inner in sorted(path.iterdir()):
            if inner.is_file():
                digest.update(inner.name.encode() + b"\x00" + inner.read_bytes())
    except OSError as error:
        raise TableError(f"{path}: cannot be read: {error.strerror}") from error
    return b"", digest.hexdigest()


def _wanted(rig: RigFile) -> tuple[str, ...]:
    """The column names that the rig file asks for: the time, the outputs, the others."""
    kind = rig.kind
    signals = (*kind.outputs, *kind.inputs, *kind.optional, *kind.auxiliary)
    if not rig.channels:
        return (*TIME_COLUMNS, *(column for signal in signals for column in signal.columns()))
    channels = [rig.channels[name] for name in ("t", *(s.name for s in signals)) if name in rig.channels]
    sources = (source for channel in channels for source in channel.sources())
    return tuple(source for source in sources if isinstance(source, str))


def _signals(sheet: _Sheet) -> tuple[_Mapped, ...]:
    """The signals that are in the file, with their columns."""
    mapped = tuple(
        _mapped(sheet, signal, channel)
        for signal in sheet.rig.kind.signals()
        if (channel := _channel_of(sheet, signal)) is not None
    )
    found = {one.signal.name for one in mapped}
    kind = sheet.rig.kind
    outputs = [signal.name for signal in kind.outputs]
    if not any(found >= set(names) for names in kind.driven_by):
        raise TableError(_missing(sheet, "an input", [" and ".join(names) for names in kind.driven_by]))
    if not found & set(outputs):
        raise TableError(_missing(sheet, "an output", outputs))
    return mapped


def _channel_of(sheet: _Sheet, signal: Signal) -> Channel | None:
    """Where a signal stands: as [channels] says, or without that in the columns that bear its name."""
    if sheet.rig.channels:
        return sheet.rig.channels.get(signal.name)
    columns: list[Column] = list(signal.columns())
    return Channel(columns=columns) if set(columns) & set(sheet.columns.names or ()) else None


def _missing(sheet: _Sheet, what: str, names: list[str]) -> str:
    expected = f"{sheet.path}: {what} is missing: expected {' or '.join(names)}"
    if sheet.rig.channels:
        return f"{expected} in [channels] of {sheet.rig.path}, found {', '.join(sheet.rig.channels)}"
    near = "".join(suggestion(name, sheet.columns.names or ()) for name in names)
    return (
        f"{expected} among the columns, or a [channels] table that maps it{near}; found {sheet.available()}"
    )


def _time_channel(sheet: _Sheet) -> _Mapped | None:
    """The column of the time, or None where the rows come at a rate."""
    names = [name for name in TIME_COLUMNS if name in (sheet.columns.names or ())]
    channel = sheet.rig.channels.get("t") or (Channel(column=names[0]) if names else None)
    if channel is not None:
        return _mapped(sheet, Signal("t", "s", Direction.STATUS), channel)
    if sheet.rig.table.rate is None:
        raise TableError(
            f"{sheet.path}: no time: expected a column {' or '.join(TIME_COLUMNS)} (s), a [channels] entry "
            f"for t, or [table] rate (Hz) in {sheet.rig.path}; found {sheet.available()}"
        )
    return None


def _mapped(sheet: _Sheet, signal: Signal, channel: Channel) -> _Mapped:
    sources = channel.sources()
    if len(sources) != signal.width:
        raise TableError(
            f"{sheet.rig.path}: channels.{signal.name}: expected {signal.width} columns, found {len(sources)}"
        )
    places = tuple(_place(sheet, signal.name, source) for source in sources)
    scale, offset = (np.broadcast_to(factor, len(places)) for factor in (channel.scale, channel.offset))
    return _Mapped(signal, places, np.asarray(scale, float), np.asarray(offset, float))


def _place(sheet: _Sheet, name: str, source: Column) -> int:
    """The number of a column that is given by name or by number."""
    names = sheet.columns.names or ()
    if isinstance(source, int):
        if source < sheet.columns.width:
            return source
        raise TableError(f"{sheet.path}: {name}: expected a column {source}, found {sheet.available()}")
    found = sheet.columns.find(source)
    if len(found) == 1:
        return found[0]
    if found:
        raise TableError(f"{sheet.path}: {name}: expected one column {source!r}, found several")
    near = suggestion(source, names)
    raise TableError(f"{sheet.path}: {name}: expected a column {source!r}{near}, found {sheet.available()}")


def _scaled(sheet: _Sheet, mapped: _Mapped) -> FloatArray:
    raw = np.column_stack([sheet.columns.numbers(column, mapped.signal.hold) for column in mapped.columns])
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite makes a bad row
        return np.asarray(raw * mapped.scale + mapped.offset, dtype=np.float64)


def _finite_rows(sheet: _Sheet, taken: list[tuple[_Mapped, FloatArray]]) -> Mask:
    """Which rows have the right number of fields and a finite number in every mapped column."""
    complete = sheet.columns.complete
    finite: Mask = complete & np.isfinite(np.hstack([values for _, values in taken])).all(axis=1)
    if not finite.any():
        raise TableError(_no_good_row(sheet, taken))
    if sheet.rig.table.bad_rows == "drop" or finite.all():
        return finite
    row = int(np.flatnonzero(~finite)[0])
    if not complete[row]:
        found = sheet.columns.counts[row]
        raise TableError(f"{sheet.line(row)}: expected {sheet.columns.width} fields, found {found}")
    for one, values in taken:
        for column, value in zip(one.columns, values[row], strict=True):
            if not np.isfinite(value):
                raise TableError(_no_number(sheet, one.signal.name, column, row))
    return finite


def _no_good_row(sheet: _Sheet, taken: list[tuple[_Mapped, FloatArray]]) -> str:
    row = int(np.flatnonzero(sheet.columns.complete)[0])
    for one, values in taken:
        for column, scaled in zip(one.columns, values.T, strict=True):
            if not np.isfinite(scaled).any():
                blamed = _no_number(sheet, one.signal.name, column, row)
                return f"{blamed}; no other row has a number there either"
    return f"{sheet.path}: expected rows with finite numbers in all mapped columns, found none"


def _no_number(sheet: _Sheet, name: str, column: int, row: int) -> str:
    found = sheet.columns.text(column, row)
    where = column if sheet.columns.names is None else repr(sheet.columns.names[column])
    hint = ' (with [table] decimal = "," it would be one)' if "," in found else ""
    return f"{sheet.line(row)}: column {where} ({name}): expected a finite number, found {found}{hint}"


def _rows_in_time(sheet: _Sheet, finite: Mask, time: FloatArray | None) -> IntArray:
    """The finite rows that follow one another in time."""
    candidates = np.flatnonzero(finite)
    run = candidates if time is None else candidates[longest_run(time[candidates])]
    if len(run) < len(candidates) and time is not None and sheet.rig.table.bad_rows == "fail":
        row = int(np.setdiff1d(candidates, run)[0])
        raise TableError(f"{sheet.line(row)}: expected a time that follows the others, found {time[row]:g} s")
    if len(run) < 2:
        raise TableError(
            f"{sheet.path}: expected two good rows or more with increasing times, found {len(run)}"
        )
    return run


def _seconds(sheet: _Sheet, row: IntArray, time: FloatArray | None) -> FloatArray:
    """Times of the kept rows in s, from the first."""
    if time is None:
        return np.asarray((row - row[0]) / sheet.rig.table.rate, dtype=np.float64)
    t: FloatArray = time[row] - time[row[0]]
    if t[-1] > LONGEST_TIME:
        raise TableError(
            f"{sheet.path}: expected times in s, found a span of {t[-1]:g} s; [channels] t can have a scale"
        )
    return t


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
