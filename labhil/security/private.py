"""Files and folders that only their owner can read, and that are never overwritten."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from labhil.atomic_file import write_error
from labhil.errors import UsageError

FOLDER, FILE, PUBLIC = 0o700, 0o600, 0o644


def make_folder(path: Path) -> None:
    """Make a folder that only this user can read; UsageError where the path exists already."""
    try:
        path.mkdir(mode=FOLDER, parents=True)
        path.chmod(FOLDER)  # regardless of the umask
    except FileExistsError:
        raise UsageError(
            f"{path}: expected a name that is free, found something there already; nothing is overwritten:"
            " choose another, or remove it first"
        ) from None
    except OSError as error:
        raise write_error(path, error, "the folder") from error


def write_new(path: Path, content: bytes, mode: int = FILE) -> None:
    """Write a new file; it never has more permissions than ``mode``, not even for a moment."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        with os.fdopen(descriptor, "wb") as file:
            os.fchmod(descriptor, mode)
            file.write(content)
    except OSError as error:
        raise write_error(path, error) from error


def check_private(path: Path) -> Path:
    """Check a private key and return its path; UsageError where it is unreadable, or others can read it."""
    try:
        with path.open("rb") as file:
            file.read(1)
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        raise UsageError(
            f"{path}: expected a private key that can be read, found: {error.strerror}"
        ) from error
    if mode & 0o077:
        raise UsageError(
            f"{path}: expected a private key that only its owner can read (mode 0600), found mode {mode:04o};"
            f" if nobody else has read it: chmod 600 {path}"
        )
    return path
