"""Memory maps of files and of arrays that are larger than the memory of a small machine.

A large file is mapped, and its pages are released after they were read. Arrays from it are in a mapped
temporary file without a name.
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
"""Smallest size of a mapped file, bytes (64 MiB)."""

RELEASE_INTERVAL = 1 << 24
"""Bytes after which pages are released (16 MiB)."""

BLOCK_ROWS = 1 << 16
"""Rows that are processed together."""

FileBytes = bytes | mmap.mmap


def bytes_of(path: Path) -> FileBytes:
    """Read a file or pipe, or map a large file; OSError as in ``bounds.read_file``."""
    if not path.is_file() or path.stat().st_size < MIN_MAPPED_SIZE:
        return read_file(path)
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def release_pages(data: FileBytes, end: int) -> None:
    """Release the memory of a map before the position ``end``; it can be read again."""
    if isinstance(data, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        whole_pages = end - end % mmap.PAGESIZE
        if whole_pages:
            data.madvise(mmap.MADV_DONTNEED, 0, whole_pages)


def release_array(values: FloatArray) -> None:
    """Release the memory of an array of a :class:`Spool`; it can be read again."""
    base: object = values
    while isinstance(base, np.ndarray):
        base = base.base
    buffer = base.obj if isinstance(base, memoryview) else base
    if isinstance(buffer, mmap.mmap):
        release_pages(buffer, len(buffer))


def sha256_of(data: FileBytes) -> str:
    """SHA-256 of a file's content, in hexadecimal digits."""
    digest = hashlib.sha256()
    update_digest(digest, data)
    return digest.hexdigest()


def sha256_of_file(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits; raises OSError where it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def update_digest(digest: hashlib._Hash, data: FileBytes) -> None:
    """Feed a file's content to a digest, piece by piece."""
    for start in range(0, len(data), RELEASE_INTERVAL):
        digest.update(data[start : start + RELEASE_INTERVAL])
        release_pages(data, start)


class Spool:
    """Rows of numbers in a temporary file; any method raises DiskFailedError if the disk is full."""

    def __init__(self, width: int) -> None:
        self._width, self._count = width, 0
        self._file = temporary_file()
        weakref.finalize(self, self._file.close)

    def add(self, rows: FloatArray) -> None:
        """Append rows (k, width)."""
        self._count += len(rows)
        write_all(self._file, np.ascontiguousarray(rows).data)

    def finish(self) -> FloatArray:
        """All rows (n, width), in column order, so that reading a column does not read the others."""
        size = 8 * self._width * self._count
        with self._file, temporary_file() as transposed:
            try:
                self._file.flush()
                transposed.truncate(size)
                rows = mmap.mmap(self._file.fileno(), size, access=mmap.ACCESS_READ)
                for start in range(0, self._count, BLOCK_ROWS):
                    self._transpose_block(rows, transposed, start)
            except OSError as error:
                raise _disk_failure(error) from error
            mapped = mmap.mmap(transposed.fileno(), size, access=mmap.ACCESS_READ)
        return np.frombuffer(mapped, dtype=np.float64).reshape(self._width, self._count).T

    def _transpose_block(self, rows: mmap.mmap, transposed: BinaryIO, start: int) -> None:
        count = min(BLOCK_ROWS, self._count - start)
        offset = 8 * self._width * start
        block = np.frombuffer(rows[offset : offset + 8 * self._width * count], dtype=np.float64)
        for column, values in enumerate(np.ascontiguousarray(block.reshape(count, self._width).T)):
            _write_at(transposed.fileno(), values.tobytes(), 8 * (column * self._count + start))
        release_pages(rows, offset)


def _write_at(descriptor: int, data: bytes, offset: int) -> None:
    """Write all bytes at an offset; one call may write fewer, as on a disk that is almost full."""
    while data:
        written = os.pwrite(descriptor, data, offset)
        data, offset = data[written:], offset + written


def temporary_file() -> BinaryIO:
    """Create a file without a name, in ``TMPDIR`` or in /var/tmp, since /tmp may be in memory."""
    chosen = any(os.environ.get(name) for name in ("TMPDIR", "TEMP", "TMP"))
    folder = None if chosen or not os.access("/var/tmp", os.W_OK) else "/var/tmp"
    try:
        return tempfile.TemporaryFile(dir=folder)
    except OSError as error:
        raise _disk_failure(error) from error


def write_all(file: BinaryIO, data: memoryview | bytes) -> None:
    """Write to a temporary file; DiskFailedError if the disk is full."""
    try:
        file.write(data)
    except OSError as error:
        raise _disk_failure(error) from error


def _disk_failure(error: OSError) -> DiskFailedError:
    return DiskFailedError(
        f"a temporary file for a large recording cannot be written: {error.strerror or error}; make room, or "
        "let the environment variable TMPDIR name a folder on another disk"
    )
