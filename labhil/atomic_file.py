"""Files that are either complete or absent: written under a temporary name, then renamed."""

from __future__ import annotations

import errno
import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from labhil.errors import DiskFailedError, LabhilError, UsageError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
DISK = (*FULL, errno.EIO, errno.EROFS)
"""What a disk says that is full, broken or read-only; anything else is the fault of the path."""


def write_error(path: Path, error: OSError, what: str = "") -> LabhilError:
    """The error of a file that could not be written: of the disk, or of the path."""
    message = f"{path}: {what + ' ' if what else ''}cannot be written: {error.strerror or error}"
    if error.errno in DISK:
        advice = "make room and try again" if error.errno in FULL else "give a disk that can be written to"
        return DiskFailedError(f"{message}; {advice}, nothing half is left")
    return UsageError(message)


def make_folder(folder: Path, purpose: str) -> None:
    """Make a folder, where there is none, that files can be written into.

    Args:
        folder: The folder.
        purpose: What it is for, for messages: "the recordings".

    Raises:
        UsageError: It cannot be made, or nothing can be written into it.
        DiskFailedError: The disk is full or fails.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except FileExistsError as error:
        raise UsageError(f"{folder}: expected a directory for {purpose}, found a file") from error
    except OSError as error:
        if error.errno in DISK:
            raise write_error(folder, error) from error
        raise UsageError(
            f"{folder}: expected a directory for {purpose}, found that nothing can be written there "
            f"({error.strerror}); give another one"
        ) from error


@contextmanager
def atomic_file(path: Path, what: str = "") -> Iterator[Path]:
    """Write a file under a temporary name, which replaces ``path`` when the block ends without an error.

    A terminal or a pipe is written to directly.

    Args:
        path: The file; an existing one stays as it is until then.
        what: What it is, for messages.

    Yields:
        The file to write to.

    Raises:
        DiskFailedError: The disk is full or fails; no partial file is left.
        UsageError: The path is at fault.
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


def write_json_file(data: Any, path: Path) -> None:
    """Write a result as indented JSON, UTF-8; numbers that are not finite have been made None before.

    Raises:
        UsageError: The path cannot be written.
        DiskFailedError: The disk is full or fails.
    """
    text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False)
    with atomic_file(path, "the result") as draft:
        draft.write_text(text + "\n", encoding="utf-8")
