"""Choice of the reader of a foreign file, by its content, and otherwise by its extension."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

from labhil.errors import TableError
from labhil.recording.chunks import is_mcap
from labhil.recording.formats.columns import Columns
from labhil.recording.formats.isolated import read_isolated
from labhil.recording.formats.lerobot import is_dataset
from labhil.recording.formats.npz import is_npz
from labhil.recording.formats.text import read_text
from labhil.rig_sections import Table

SUPPORTED = "text tables, MAT files, Parquet, LeRobot datasets, NPZ, XLSX, MCAP files and ROS 2 bags"

UNSUPPORTED = {
    b"\xd0\xcf\x11\xe0": "an XLS workbook of the old kind: save it as .xlsx",
    b"\x1f\x8b": "a file packed by gzip: unpack it first",
    b"#ROSBAG": "a ROS 1 bag: convert it with `rosbags-convert`",
    b"ARROW1": "a Feather (Arrow) file: save it as Parquet",
}

HDF5 = b"\x89HDF"
HDF5_IN_MAT = slice(512, 516)
"""Bytes of a MAT file of version 7.3 with the beginning of HDF5; a text precedes them."""

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
    if table.episode is not None and not (is_dataset(path) or data.startswith(b"PAR1")):
        raise TableError(
            f"{path}: expected a LeRobot dataset or a file of one, as [table] episode or --episode counts "
            "its episodes, found none"
        )
    if path.is_dir():
        return _read_folder(path, table, wanted)
    if not data.strip():
        raise TableError(f"{path}: expected a table, found an empty file")
    if data.startswith(b"PK\x03\x04"):
        zipped = "npz" if is_npz(path) else "workbook"
        if zipped == "npz" or _is_workbook(path):
            return read_isolated(zipped, path, table, wanted)
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
    if data[HDF5_IN_MAT] == HDF5:  # some programs write another text before it
        return "hdf5"
    if data.startswith(b"MATLAB 5.0") or (path.suffix.lower() == ".mat" and b"\x00" in data[:20]):
        return "mat"
    if data.startswith((b"MATLAB 7.3", HDF5)):
        return "hdf5"
    return "parquet" if data.startswith(b"PAR1") else None


def _read_folder(path: Path, table: Table, wanted: Sequence[str]) -> Columns:
    if is_dataset(path):
        return read_isolated("lerobot", path, table, wanted)
    if not (path / "metadata.yaml").is_file():
        content = ", ".join(sorted(inner.name for inner in path.iterdir())[:5]) or "nothing"
        raise TableError(
            f"{path}: expected a file, or the folder of a ROS 2 bag with its metadata.yaml, or of a LeRobot "
            f"dataset with its meta/info.json, found a folder with {content}"
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
    kind = "bag" if data[MCAP_PROFILE] == b"\x04\x00\x00\x00ros2" else "mcap"
    return read_isolated(kind, path, table, wanted)
