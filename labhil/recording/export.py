"""Export of recordings as tables or ROS 2 bags."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from labhil.atomic_file import atomic_file, write_error
from labhil.errors import RecordingError, UsageError, suggestion
from labhil.extras import require
from labhil.recording.formats.bag_writer import write_bag
from labhil.recording.formats.matlab import write_mat
from labhil.recording.formats.parquet import write_parquet
from labhil.recording.formats.workbook import write_workbook
from labhil.recording.memory_maps import BLOCK_ROWS, release_array
from labhil.recording.recording import Recording, StreamData
from labhil.signals import FloatArray, Stream

BAG = ".rosbag2"
"""Extension of a ROS 2 bag, which is a folder."""


def write_csv(stream: Stream, t: FloatArray, values: FloatArray, out: Path) -> None:
    """Write a header, times ``t`` (n,) and values (n, columns), with the digits of exact doubles."""
    with out.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(("t", *stream.columns())) + "\n")
        for start in range(0, len(t), BLOCK_ROWS):
            block = slice(start, start + BLOCK_ROWS)
            rows = np.column_stack([t[block], values[block]]).tolist()
            file.writelines(",".join(map(repr, row)) + "\n" for row in rows)
            release_array(values)


WRITERS: Mapping[str, Callable[[Stream, FloatArray, FloatArray, Path], None]] = {
    ".csv": write_csv,
    ".parquet": write_parquet,
    ".mat": write_mat,
    ".xlsx": write_workbook,
}

PACKAGES = {".parquet": "pyarrow", ".xlsx": "openpyxl"}
"""Packages that writers need."""


def choose_stream(recording: Recording, name: str | None = None) -> StreamData:
    """Choose the stream for a table: by name, or ``state``, or the only one.

    Args:
        recording: the recording.
        name: ``/device/stream``, if there is one.

    Returns:
        The stream.

    Raises:
        RecordingError: There is no such stream, it has no samples, or there are several.
    """
    filled = {f"/{data.device}/{data.stream.name}": data for data in recording.streams if len(data)}
    if name is not None:
        topic = f"/{name.strip('/')}"
        if topic not in filled:
            actual = ", ".join(filled) or "none with samples"
            raise RecordingError(
                f"{recording.path}: expected a stream {topic}{suggestion(topic, filled)}, found {actual}"
            )
        return filled[topic]
    chosen = {key: data for key, data in filled.items() if data.stream.name == "state"} or filled
    if len(chosen) == 1:
        return next(iter(chosen.values()))
    nothing = (
        "found none with samples" if recording.streams else f"found {recording.describe_missing_streams()}"
    )
    actual = f"found {', '.join(chosen)}; choose with --stream or --device" if chosen else nothing
    raise RecordingError(f"{recording.path}: expected one stream to export, {actual}")


def export_csv(recording: Recording, out: Path, stream: StreamData | None = None) -> Path:
    """Write a stream as CSV: a header, the time ``t`` (s), and the signals (SI units) as exact doubles.

    Args:
        recording: the recording.
        out: the file.
        stream: the stream; None for the one of :func:`choose_stream`.

    Returns:
        Path of the file.

    Raises:
        UsageError: The file cannot be written.
    """
    return _write_atomically(write_csv, choose_stream(recording) if stream is None else stream, out)


def export(recording: Recording, out: Path, stream: str | None = None) -> Path:
    """Write a recording in the format of the file's extension.

    Args:
        recording: the recording.
        out: the file; a bag contains all streams with samples, a table one.
        stream: ``/device/stream``; None for all streams of a bag or the one of :func:`choose_stream`.

    Returns:
        Path of the file.

    Raises:
        UsageError: The extension is unknown, or the file cannot be written.
        DiskFailedError: The disk is full.
    """
    suffix = out.suffix.lower()
    if suffix == BAG:
        return _write_bag(recording, out, stream)
    if suffix not in WRITERS:
        raise UsageError(
            f"{out}: expected an extension {', '.join(WRITERS)} or {BAG}, found {suffix or 'none'!r}"
        )
    if suffix in PACKAGES:
        require(PACKAGES[suffix], f"{out}: writing such a file")
    return _write_atomically(WRITERS[suffix], choose_stream(recording, stream), out)


def _write_bag(recording: Recording, out: Path, stream: str | None) -> Path:
    filled = [data for data in recording.streams if len(data)]
    if stream is not None or not filled:
        filled = [choose_stream(recording, stream)]
    try:
        write_bag(filled, out)
    except OSError as error:
        raise write_error(out, error) from error
    return out


def _write_atomically(
    write: Callable[[Stream, FloatArray, FloatArray, Path], None], data: StreamData, out: Path
) -> Path:
    """Write a draft beside ``out``, so that there never is a partial table."""
    if out.is_dir():
        raise UsageError(f"{out}: expected a file to write, found a folder")
    with atomic_file(out) as draft:
        write(data.stream, data.t, data.values, draft)
    return out
