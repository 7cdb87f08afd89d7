"""The bytes of a large file without having them in memory, and what is made of them on a disk.

A long recording is larger than the memory of a small machine. Its file is mapped, and its pages are let go
once they have been read; numbers that are made of it go to a temporary file without a name, mapped in turn.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import tempfile
import weakref
from pathlib import Path
from typing import BinaryIO

import numpy as np

from labhil.bounds import read_file
from labhil.errors import DiskFailedError
from labhil.signals import FloatArray

MIN_MAPPED_SIZE = 1 << 26
"""Bytes (64 MiB) from which on a file is mapped."""

RELEASE_INTERVAL = 1 << 24
"""Bytes that are looked at before their pages are let go."""

BLOCK_ROWS = 1 << 16
"""Rows that are turned into columns at a time."""

FileBytes = bytes | mmap.mmap


def bytes_of(path: Path) -> FileBytes:
    """Return the bytes of a file or a pipe, a large file's mapped; OSError as ``bounds.read_file``."""
    if not path.is_file() or path.stat().st_size < MIN_MAPPED_SIZE:
        return read_file(path)
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def release_pages(data: FileBytes, end: int) -> None:
    """Give back the memory of what was read before ``end``; it can be read again."""
    if isinstance(data, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        whole_pages = end - end % mmap.PAGESIZE
        if whole_pages:
            data.madvise(mmap.MADV_DONTNEED, 0, whole_pages)


def release_array(values: FloatArray) -> None:
    """Give back the memory of numbers that a :class:`Spool` holds; they can be read again."""
    base: object = values
    while isinstance(base, np.ndarray):
        base = base.base
    held = base.obj if isinstance(base, memoryview) else base
    if isinstance(held, mmap.mmap):
        release_pages(held, len(held))


def sha256_of(data: FileBytes) -> str:
    """Return the SHA-256 of the bytes, in hexadecimal digits."""
    digest = hashlib.sha256()
    for start in range(0, len(data), RELEASE_INTERVAL):
        digest.update(data[start : start + RELEASE_INTERVAL])
        release_pages(data, start)
    return digest.hexdigest()


class Spool:
    """Rows of numbers on the disk, in a temporary file that nobody has to take away.

    DiskFailedError, from any method, where there is no room for them.
    """

    def __init__(self, width: int) -> None:
        self._width, self._count = width, 0
        self._file = temporary_file()
        weakref.finalize(self, self._file.close)

    def add(self, rows: FloatArray) -> None:
        """Append rows, shape (k, width)."""
        self._count += len(rows)
        write_all(self._file, np.ascontiguousarray(rows).data)

    def finish(self) -> FloatArray:
        """Return all rows, shape (n, width), column after column: of one column, only that one is read."""
        size = 8 * self._width * self._count
        self._file.flush()
        with self._file, temporary_file() as turned:
            try:
                turned.truncate(size)
                rows = mmap.mmap(self._file.fileno(), size, access=mmap.ACCESS_READ)
                for start in range(0, self._count, BLOCK_ROWS):
                    self._turn(rows, turned, start)
            except OSError as error:
                raise _no_room(error) from error
            mapped = mmap.mmap(turned.fileno(), size, access=mmap.ACCESS_READ)
        return np.frombuffer(mapped, dtype=np.float64).reshape(self._width, self._count).T

    def _turn(self, rows: mmap.mmap, turned: BinaryIO, start: int) -> None:
        count = min(BLOCK_ROWS, self._count - start)
        offset = 8 * self._width * start
        block = np.frombuffer(rows[offset : offset + 8 * self._width * count], dtype=np.float64)
        for column, values in enumerate(np.ascontiguousarray(block.reshape(count, self._width).T)):
            os.pwrite(turned.fileno(), values.data, 8 * (column * self._count + start))
        release_pages(rows, offset)


def temporary_file() -> BinaryIO:
    """Return a file without a name; not where files are kept in memory, unless the user wants it there."""
    chosen = any(os.environ.get(name) for name in ("TMPDIR", "TEMP", "TMP"))
    folder = None if chosen or not os.access("/var/tmp", os.W_OK) else "/var/tmp"
    try:
        return tempfile.TemporaryFile(dir=folder)
    except OSError as error:
        raise _no_room(error) from error


def write_all(file: BinaryIO, data: memoryview | bytes) -> None:
    """Write to a temporary file; DiskFailedError where there is no room."""
    try:
        file.write(data)
    except OSError as error:
        raise _no_room(error) from error


def _no_room(error: OSError) -> DiskFailedError:
    return DiskFailedError(
        f"a temporary file for a large recording cannot be written: {error.strerror or error}; make room, or "
        "let the environment variable TMPDIR name a folder on another disk"
    )
