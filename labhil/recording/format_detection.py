"""Choice of the reader of a foreign file, by its content, and otherwise by its extension."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

from labhil.bounds import ImplausibleError
from labhil.errors import TableError
from labhil.recording.chunks import is_mcap, scan_mcap
from labhil.recording.formats.columns import Columns
from labhil.recording.formats.isolated import read_isolated
from labhil.recording.formats.text import read_text
from labhil.rig_sections import Table
from labhil.terminal import printable_name

SUPPORTED = "text tables, MAT files, Parquet, XLSX and ROS 2 bags"

UNSUPPORTED = {
    b"\xd0\xcf\x11\xe0": "an XLS workbook of the old kind: save it as .xlsx",
    b"\x1f\x8b": "a file packed by gzip: unpack it first",
    b"#ROSBAG": "a ROS 1 bag: convert it with `rosbags-convert`",
    b"ARROW1": "a Feather (Arrow) file: save it as Parquet",
}

MCAP_PROFILE = slice(17, 25)
"""Bytes of an MCAP file with its profile: a length (u32) and a text."""


def read_foreign_table(path: Path, data: bytes, table: Table, wanted: Sequence[str]) -> Columns:
    """Read a foreign file as columns.

    Args:
        path: the file, or the folder of a bag.
        data: content of the file; empty for a folder.
        table: section ``[table]`` of the rig file.
        wanted: names of columns in the rig file, outputs first, which identify a header and the topic of a
            bag whose messages are the rows.

    Returns:
        The table.

    Raises:
        TableError: The file is empty or of an unsupported kind.
        MissingExtraError: The package that reads it is not installed.
    """
    if path.is_dir():
        return _read_folder(path, table, wanted)
    if not data.strip():
        raise TableError(f"{path}: expected a table, found an empty file")
    if data.startswith(b"PK\x03\x04") and _is_workbook(path):
        return read_isolated("workbook", path, table, wanted)
    if data.startswith(b"SQLite format 3") or is_mcap(data):
        return _read_bag_file(path, data, table, wanted)
    kind = _binary_kind(path, data)
    if kind is not None:
        return read_isolated(kind, path, table, wanted)
    unreadable = next((what for magic, what in UNSUPPORTED.items() if data.startswith(magic)), "")
    if unreadable:
        raise TableError(f"{path}: expected one of {SUPPORTED}, found {unreadable}")
    return read_text(path, data, table, wanted)


def _binary_kind(path: Path, data: bytes) -> str | None:
    """Kind of a file whose columns have names and binary numbers; None for other files."""
    if data.startswith(b"MATLAB 5.0") or (path.suffix.lower() == ".mat" and b"\x00" in data[:20]):
        return "mat"
    if data.startswith((b"MATLAB 7.3", b"\x89HDF")):
        return "hdf5"
    return "parquet" if data.startswith(b"PAR1") else None


def _read_folder(path: Path, table: Table, wanted: Sequence[str]) -> Columns:
    if not (path / "metadata.yaml").is_file():
        content = ", ".join(sorted(inner.name for inner in path.iterdir())[:5]) or "nothing"
        raise TableError(
            f"{path}: expected a file, or the folder of a ROS 2 bag with its metadata.yaml, "
            f"found a folder with {content}"
        )
    return read_isolated("bag", path, table, wanted)


def _is_workbook(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as file:
            inside = file.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise TableError(
            f"{path}: expected a workbook (XLSX), found one that is cut or damaged: {error}"
        ) from error
    if "xl/workbook.xml" not in inside:
        raise TableError(
            f"{path}: expected one of {SUPPORTED}, found a zipped file with "
            f"{', '.join(inside[:3])}: unpack it first"
        )
    return True


def _read_bag_file(path: Path, data: bytes, table: Table, wanted: Sequence[str]) -> Columns:
    if not is_mcap(data):
        if path.suffix != ".db3":
            raise TableError(
                f"{path}: expected a ROS 2 bag's SQLite file to end in .db3, found {path.suffix!r}"
            )
        return read_isolated("bag", path, table, wanted)
    if data[MCAP_PROFILE] == b"\x04\x00\x00\x00ros2":
        return read_isolated("bag", path, table, wanted)
    try:
        channels = scan_mcap(data).channels.values()
    except ImplausibleError as error:
        raise TableError(f"{path}: {error}") from error
    if any("labhil.stream" in channel.metadata for channel in channels):
        raise TableError(f"{path}: expected a table, found a labhil recording, which needs no import")
    topics = ", ".join(
        printable_name(f"{channel.topic} ({channel.message_encoding or 'no encoding'})")
        for channel in channels
    )
    description = f"of another program with {topics}" if topics else "without channels"
    cdr = any(channel.message_encoding == "cdr" for channel in channels)
    hint = "; `ros2 bag convert` writes one whose profile is ros2" if cdr else ""
    raise TableError(
        f"{path}: expected one of {SUPPORTED} (of MCAP files those with the profile ros2 and CDR messages), "
        f"found an MCAP file {description}{hint}"
    )
