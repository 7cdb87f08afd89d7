"""Containers that hold far more than their size, point elsewhere, or never end."""

from __future__ import annotations

import sqlite3
import struct
import tempfile
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

import numpy as np

from labhil_benchmarks.bad_files import samples
from labhil_benchmarks.bad_files.inside import HEADER, MAGIC, chunk, record

ZEROS = bytes(300_000_000)
_TEXT = struct.Struct("<I")
PROFILE_ROS2 = _TEXT.pack(4) + b"ros2" + _TEXT.pack(0)


def mcap_of(chunk_body: bytes, header: bytes = bytes(8)) -> bytes:
    """Return an MCAP file of one chunk."""
    end = record(15, bytes(4)) + record(2, bytes(20)) + MAGIC
    return MAGIC + record(HEADER, header) + record(6, chunk_body) + end


def nested_chunks() -> bytes:
    """Return a chunk in a chunk in a chunk."""
    inner = record(6, chunk(ZEROS, "zstd"))
    return mcap_of(chunk(record(6, chunk(inner, "zstd")), "zstd"))


def wide_sheet() -> bytes:
    """Return a workbook whose every row has its only cell in the last column but a few."""
    cells = b"".join(b'<row r="%d"><c r="XFD%d"><v>1</v></c></row>' % (k, k) for k in range(1, 200_000))
    name = b'<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
    sheet = name + cells + b"</sheetData></worksheet>"
    return packed_into(samples.tables()["a.xlsx"], {"xl/worksheets/sheet1.xml": sheet})


def packed_into(data: bytes, parts: Mapping[str, bytes]) -> bytes:
    """Return a ZIP file with these parts in the place of those of their names."""
    out = BytesIO()
    with zipfile.ZipFile(BytesIO(data)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            if name not in parts:
                new.writestr(name, old.read(name))
        for name, content in parts.items():
            new.writestr(name, content)
    return out.getvalue()


def lying_zip(data: bytes) -> bytes:
    """A workbook with a bomb whose size in the ZIP file's own lists is small."""
    packed = bytearray(packed_into(data, {"xl/sharedStrings.xml": ZEROS}))
    size = struct.pack("<I", len(ZEROS))
    while size in packed:
        place = packed.index(size)
        packed[place : place + 4] = struct.pack("<I", 100)
    return bytes(packed)


def laughs(root: str) -> bytes:
    """XML whose entities mean one another, ten each."""
    lines = ['<!ENTITY a0 "ha">']
    lines += [f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12)]
    return f'<?xml version="1.0"?><!DOCTYPE x [{"".join(lines)}]><{root}>&a11;</{root}>'.encode()


def mat(element: bytes) -> bytes:
    """Return a MAT file of version 5 with one element, packed or not."""
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    packed = element[:1] == b"\x78"
    return head + struct.pack("<II", 15 if packed else 14, len(element)) + element


def matrix(rows: int, columns: int) -> bytes:
    """The element of a matrix of doubles that claims a size."""
    inside = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, rows, columns)
    inside += struct.pack("<HH4s", 1, 1, b"t\x00\x00\x00") + struct.pack(
        "<II", 9, min(8 * rows * columns, 2**32 - 1)
    )
    return struct.pack("<II", 14, min(len(inside) + 8 * rows * columns, 2**32 - 1)) + inside


def cells(depth: int) -> bytes:
    """Cells within one another."""
    inside = b""
    for _ in range(depth):
        head = struct.pack("<IIII", 6, 8, 1, 0) + struct.pack("<IIii", 5, 8, 1, 1) + struct.pack("<II", 1, 0)
        element = head + inside
        inside = struct.pack("<II", 14, len(element)) + element
    return inside[8:]


def hdf5_bomb() -> bytes:
    """Return an HDF5 file of 240 MB of zeros."""
    import h5py

    out = BytesIO()
    with h5py.File(out, "w") as file:
        file.create_dataset("t", data=np.zeros(30_000_000), compression="gzip", chunks=(10_000_000,))
    return out.getvalue()


def hdf5_links() -> bytes:
    """Links to other files and to itself, and a data set whose bytes are those of another file."""
    import h5py

    out = BytesIO()
    with h5py.File(out, "w") as file:
        file["t"] = np.arange(5.0)
        file["other"] = h5py.ExternalLink("/etc/passwd", "/")
        file["self"] = h5py.SoftLink("/")
        file["servo_angle"] = h5py.SoftLink("/nowhere")
        file.create_dataset("ball_position", (5,), "f8", external=[("/etc/passwd", 0, 40)])
    return out.getvalue()


def parquet_bomb() -> bytes:
    """Return a Parquet file of 320 MB of zeros."""
    import pyarrow
    import pyarrow.parquet

    out = BytesIO()
    column = pyarrow.array(np.zeros(20_000_000))
    pyarrow.parquet.write_table(pyarrow.table({"t": column, "servo_angle": column}), out, compression="zstd")
    return out.getvalue()


def endless_view(data: bytes) -> bytes:
    """A bag whose table of messages is a view without an end."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        path.write_bytes(data)
        with sqlite3.connect(path) as database:
            database.execute("alter table messages rename to old")
            database.execute(
                "create view messages as with recursive n(k) as (select 1 union all select k + 1 from n) "
                "select n.k as id, topic_id, timestamp + n.k as timestamp, data from n, old where old.id = 1"
            )
        database.close()
        return path.read_bytes()
