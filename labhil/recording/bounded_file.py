"""An open file that is never asked for more bytes than it has."""

from __future__ import annotations

import os
from typing import BinaryIO


class BoundedFile:
    """A binary file of which a damaged length reserves no memory.

    A file object reserves all that it is asked for before it reads: one wrong bit in the length of a record
    would take gigabytes.

    Args:
        file: The open file.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = os.fstat(file.fileno()).st_size

    def read(self, size: int = -1) -> bytes:
        """Read ``size`` bytes, or as many as there are behind the present place."""
        left = max(self._size - self._file.tell(), 0)
        return self._file.read(size if 0 <= size <= left else left)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place in the file and return it."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """The present place."""
        return self._file.tell()

    def seekable(self) -> bool:
        """Whether any place can be reached."""
        return self._file.seekable()
