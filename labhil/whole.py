"""Files that are whole or not there: written beside their name, which they get at the end."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from labhil.errors import DiskFailedError, LabhilError, UsageError

DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""What a disk says that is full or broken; anything else is the fault of the path."""


def write_error(path: Path, error: OSError, what: str = "") -> LabhilError:
    """The error of a file that could not be written: of the disk, or of the path."""
    message = f"{path}: {what + ' ' if what else ''}cannot be written: {error.strerror or error}"
    if error.errno in DISK:
        return DiskFailedError(f"{message}; make room and try again, nothing half is left")
    return UsageError(message)


@contextmanager
def whole(path: Path, what: str = "") -> Iterator[Path]:
    """Yield where to write what shall be ``path`` at the end; what is there already stays until then.

    ``what`` names it in a message. DiskFailedError where the disk is full or fails, UsageError where the
    path is at fault. Nothing half is left. What is no file (a terminal, a pipe) is written to as it is.
    """
    special = path.exists() and not path.is_file()
    # the extension stays: it is what some writers go by
    draft = path if special else path.with_name(f"{path.stem}.part{path.suffix}")
    try:
        yield draft
        if not special:
            draft.replace(path)
    except OSError as error:
        raise write_error(path, error, what) from error
    finally:
        if not special:
            with suppress(OSError):
                draft.unlink(missing_ok=True)
