"""Import of foreign tables: columns by the rules of a rig file, as signals in SI units.

``format_detection.py`` reads the file, ``time_column.py`` orders its rows, ``bad_rows.py`` drops bad ones.
"""

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
from labhil.recording.bad_rows import find_bad_rows, finite_rows
from labhil.recording.channel_keys import apply_channel_keys, with_declared_hold
from labhil.recording.format_detection import read_foreign_table
from labhil.recording.formats.time_text import TimeKind
from labhil.recording.memory_maps import bytes_of, update_digest
from labhil.recording.recording import IMPORT, TIME_COLUMN
from labhil.recording.rig_attachments import rig_attachments
from labhil.recording.sheet import MappedSignal, Sheet, SignalValues
from labhil.recording.slow_channels import fill_slow_channels
from labhil.recording.stated_units import check_units
from labhil.recording.time_column import (
    RowTimes,
    TimeColumn,
    choose_time_column,
    order_rows,
    read_time_column,
    time_notes,
)
from labhil.recording.writer import RecordingWriter, media_type
from labhil.rig import RigFile
from labhil.rig_sections import Channel, Column
from labhil.signals import Batch, Direction, FloatArray, IntArray, Signal, Stream
from labhil.unreadable import FileKind, reason_unreadable

TIME_COLUMNS = ("t", "time", "timestamp")
MAX_TIME = 9e9
"""Longest time that fits into int64 nanoseconds, s."""

EDGE = "edge"
PART = "part"

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class ImportedTable:
    """A table as signals in SI units.

    Attributes:
        source: the file.
        sha256: its SHA-256.
        rig: the rig file.
        stream: the signals.
        row: numbers of the n kept rows in the file, (n,).
        t: times from the first kept row, (n,) s.
        values: samples, (n, stream.width).
        time_origin: time of the first kept row in the file, s.
        rows: number of rows in the file.
        dropped: number of dropped rows by reason.
        outside: number of kept rows outside the limits, by signal.
        flagged: kept rows outside any limits, (n,).
        notes: lines about the choice of time and rows.
        first_bad: description of the first bad row by reason.
        time_column: name of the time in the file; "" without one.
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
    """Read a table by the sections ``[table]`` and ``[channels]`` of a rig file.

    Args:
        data: the file.
        rig: the rig file.

    Returns:
        The table.

    Raises:
        TableError: A column is missing, the time is ambiguous, units differ, no row is good, there is a bad
            row with ``bad_rows = "fail"``, or there are many without ``"drop"``. It names file and column.
    """
    content, sha256 = _read_content(data)
    sheet = Sheet(data, read_foreign_table(data, content, rig.table, _wanted_columns(rig)), rig)
    if sheet.columns.files:
        sha256 = _digest(data, sheet.columns.files)
    mapped, time_column = _map_signals(sheet), _find_time_column(sheet)
    timed = [time_column.mapped] if time_column is not None and time_column.kind is TimeKind.NUMBER else []
    units = check_units(sheet, [*timed, *mapped])
    signals = [(signal, _signal_values(sheet, signal)) for signal in mapped]
    times = _row_times(sheet, time_column, signals)
    filled = fill_slow_channels(sheet, signals, times.t)
    time = [] if time_column is None else [(time_column.mapped, time_column.seconds[:, None])]
    finite = finite_rows(sheet, [*time, *filled.signals])
    followed = np.isfinite(times.t)
    row = np.flatnonzero(finite & followed)
    excused = filled.edge | times.other_parts
    bad = find_bad_rows(sheet, [*time, *filled.signals], finite, followed, excused)
    t = _times_from_first(sheet, row, times.t)
    notes = [*sheet.columns.notes, *units, *times.notes, *filled.notes]
    if time_column is None:
        notes.append(f"time: no column; rows come at [table] rate = {rig.table.rate:g} Hz")
    else:
        notes += time_notes(sheet, time_column, t, row)
    stream = Stream("state", tuple(column.signal for column in mapped), float(1.0 / np.median(np.diff(t))))
    values = np.hstack([signal_values for _, signal_values in filled.signals])[row]
    values, key_notes = apply_channel_keys(stream, rig.channels, t, values)
    outside, flagged = _outside_limits(stream, values, rig)
    unused = {EDGE: filled.edge & ~times.other_parts, PART: times.other_parts & sheet.columns.complete}
    return ImportedTable(
        source=data,
        sha256=sha256,
        rig=rig,
        stream=stream,
        row=row,
        t=t,
        values=values,
        time_origin=0.0 if time_column is None else float(time_column.seconds[row[0]]),
        rows=len(finite),
        dropped={
            **bad.counts,
            **{reason: int(np.count_nonzero(mask)) for reason, mask in unused.items() if mask.any()},
        },
        outside=outside,
        flagged=flagged,
        notes=(*notes, *key_notes),
        first_bad=bad.first,
        time_column=_time_column_name(sheet, time_column),
    )


def with_episode(rig: RigFile, episode: int | None) -> RigFile:
    """Replace ``[table] episode`` of a rig file; None keeps it."""
    if episode is None:
        return rig
    return rig.model_copy(update={"table": rig.table.model_copy(update={"episode": episode})})


def write_import(table: ImportedTable, out: Path) -> Path:
    """Write an imported table as a recording with its rig file and the numbers of dropped rows.

    The device has the name of the rig kind. The same table always makes the same bytes, since the host's time
    is that of the table, from 0.

    Args:
        table: the table.
        out: the recording.

    Returns:
        Its path.

    Raises:
        RecordingError: The recording exists.
        DiskFailedError: The disk failed, and nothing was written.
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
            # a partial import is useless, since the table still exists
            writer.part.unlink(missing_ok=True)
            raise DiskFailedError(
                f"{out}: the disk failed, nothing was imported: {failure.__cause__}; make room and try again"
            ) from failure
    return out


def _read_content(path: Path) -> tuple[bytes, str]:
    """Content of a file and its SHA-256; of a folder b"", and the SHA-256 of its files and their names."""
    try:
        if not path.is_dir():
            content = read_file(path)
            return content, hashlib.sha256(content).hexdigest()
        inside = sorted(inner for inner in path.iterdir() if inner.is_file())
    except OSError as error:
        table = FileKind("tables", path.suffix.lower())
        raise TableError(f"{path}: cannot be read: {reason_unreadable(path, error, table)}") from error
    return b"", _digest(path, inside)


def _digest(path: Path, files: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    try:
        for file in files:
            digest.update(file.name.encode() + b"\x00")
            update_digest(digest, bytes_of(file))
    except OSError as error:
        raise TableError(f"{path}: cannot be read: {error.strerror}") from error
    return digest.hexdigest()


def _wanted_columns(rig: RigFile) -> tuple[str, ...]:
    """Names of columns in the rig file: time, outputs, other signals."""
    kind = rig.kind
    signals = (*kind.outputs, *kind.inputs, *kind.optional, *kind.auxiliary)
    if not rig.channels:
        return (*TIME_COLUMNS, *(column for signal in signals for column in signal.columns()))
    channels = [rig.channels[name] for name in ("t", *(s.name for s in signals)) if name in rig.channels]
    sources = (source for channel in channels for source in channel.sources())
    return tuple(source for source in sources if isinstance(source, str))


def _map_signals(sheet: Sheet) -> tuple[MappedSignal, ...]:
    """Signals in the file, with their columns."""
    mapped = tuple(
        _map_signal(sheet, with_declared_hold(signal, channel), channel)
        for signal in sheet.rig.kind.signals()
        if (channel := _channel_of(sheet, signal)) is not None
    )
    present = {column.signal.name for column in mapped}
    kind = sheet.rig.kind
    outputs = [signal.name for signal in kind.outputs]
    if not any(present >= set(names) for names in kind.driven_by):
        raise TableError(
            _missing_message(sheet, "an input", [" and ".join(names) for names in kind.driven_by])
        )
    if not present & set(outputs):
        raise TableError(_missing_message(sheet, "an output", outputs))
    return mapped


def _channel_of(sheet: Sheet, signal: Signal) -> Channel | None:
    """Columns of a signal, by [channels] or, without that section, by name; None without them."""
    if sheet.rig.channels:
        return sheet.rig.channels.get(signal.name)
    columns: list[Column] = list(signal.columns())
    return Channel(columns=columns) if any(map(sheet.columns.find, signal.columns())) else None


def _missing_message(sheet: Sheet, what: str, names: list[str]) -> str:
    expected = f"{sheet.path}: {what} is missing: expected {' or '.join(names)}"
    if sheet.rig.channels:
        return f"{expected} in [channels] of {sheet.rig.path}, found {', '.join(sheet.rig.channels)}"
    near = "".join(suggestion(name, sheet.columns.names or ()) for name in names)
    return (
        f"{expected} among the columns, or a [channels] table that maps it{near}; found {sheet.available()}"
    )


def _find_time_column(sheet: Sheet) -> TimeColumn | None:
    """Column of the time; None if the rig file states a rate instead."""
    time = Signal("t", "s", Direction.STATUS)
    if "t" in sheet.rig.channels:
        return read_time_column(sheet, _map_signal(sheet, time, sheet.rig.channels["t"]))
    names = [name for name in TIME_COLUMNS if sheet.columns.find(name)]
    if names:
        return choose_time_column(sheet, [_map_signal(sheet, time, Channel(column=name)) for name in names])
    if sheet.rig.table.rate is None:
        raise TableError(
            f"{sheet.path}: no time: expected a column {' or '.join(TIME_COLUMNS)} (s), a [channels] entry "
            f"for t, or [table] rate (Hz) in {sheet.rig.path}; found {sheet.available()}"
        )
    return None


def _time_column_name(sheet: Sheet, time_column: TimeColumn | None) -> str:
    names = sheet.columns.names
    return "" if time_column is None or names is None else names[time_column.mapped.columns[0]]


def _row_times(sheet: Sheet, time_column: TimeColumn | None, signals: SignalValues) -> RowTimes:
    """Times of the rows, by their column or by the rate in ``[table]``."""
    rows = len(sheet.columns.counts)
    if time_column is None:
        return RowTimes(np.arange(rows) / float(sheet.rig.table.rate or 1.0), np.zeros(rows, dtype=np.bool_))
    values = np.hstack([signal_values for _, signal_values in signals])
    copied = np.zeros(rows, dtype=np.bool_)
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    copied[1:] = same.all(axis=1)
    return order_rows(sheet, time_column, copied)


def _map_signal(sheet: Sheet, signal: Signal, channel: Channel) -> MappedSignal:
    sources = channel.sources()
    if len(sources) != signal.width:
        raise TableError(
            f"{sheet.rig.path}: channels.{signal.name}: expected {signal.width} columns, found {len(sources)}"
        )
    columns = tuple(_find_column(sheet, signal.name, source) for source in sources)
    scale, offset = (np.broadcast_to(factor, len(columns)) for factor in (channel.scale, channel.offset))
    return MappedSignal(signal, columns, np.asarray(scale, float), np.asarray(offset, float))


def _find_column(sheet: Sheet, name: str, source: Column) -> int:
    """Number of a column that is given by name or number."""
    names = sheet.columns.names or ()
    if isinstance(source, int):
        if source < sheet.columns.width:
            return source
        raise TableError(f"{sheet.path}: {name}: expected a column {source}, found {sheet.available()}")
    numbers = sheet.columns.find(source)
    if len(numbers) == 1:
        return numbers[0]
    if numbers:
        same = ", ".join(names[number] for number in numbers)
        raise TableError(f"{sheet.path}: {name}: expected one column {source!r}, found several: {same}")
    near = suggestion(source, names)
    raise TableError(f"{sheet.path}: {name}: expected a column {source!r}{near}, found {sheet.available()}")


def _signal_values(sheet: Sheet, mapped: MappedSignal) -> FloatArray:
    raw = np.column_stack([sheet.columns.numbers(column, mapped.signal.hold) for column in mapped.columns])
    return mapped.to_signal_unit(raw)


def _times_from_first(sheet: Sheet, row: IntArray, t: FloatArray) -> FloatArray:
    """Times (n,) of the kept rows from the first, s; a message on too large ones proposes a unit."""
    if len(row) < 2:
        raise TableError(
            f"{sheet.path}: expected two good rows or more with increasing times, found {len(row)}"
        )
    seconds: FloatArray = t[row] - t[row[0]]
    if seconds[-1] > MAX_TIME:
        step = float(np.median(np.diff(seconds)))
        scale = next((factor for factor in (1e-3, 1e-6, 1e-9) if step * factor < 2.0), None)
        hint = "" if scale is None else f"; with scale = {scale:g} they span {seconds[-1] * scale:g} s"
        raise TableError(
            f"{sheet.path}: expected times in s, found a span of {seconds[-1]:g} s; [channels] t can have a "
            f"scale{hint}"
        )
    return seconds


def _outside_limits(stream: Stream, values: FloatArray, rig: RigFile) -> tuple[dict[str, int], Mask]:
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
