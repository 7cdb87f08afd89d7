"""labhil, with a note of how long a file was each time it was forced to the disk:

    python benchmarks/measuring/noted_syncs.py NOTES run experiment.toml

A line of NOTES is the number of a file (its inode) and the bytes that are certain to be on the disk.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path


def note_syncs(notes: Path) -> None:
    """Let ``os.fdatasync`` and ``os.fsync`` of this process note what they forced to the disk."""
    descriptor = os.open(notes, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    for name in ("fdatasync", "fsync"):
        setattr(os, name, _note_calls(getattr(os, name), descriptor))


def _note_calls(sync: Callable[[int], None], notes: int) -> Callable[[int], None]:
    def noted(file: int) -> None:
        stat = os.fstat(file)  # before: what comes in meanwhile is not certain
        sync(file)
        os.write(notes, f"{stat.st_ino} {stat.st_size}\n".encode())

    return noted


def synced(notes: Path, path: Path) -> int:
    """How many bytes of a file are certain to be on the disk."""
    inode = str(path.stat().st_ino)
    lines = notes.read_text(encoding="ascii").splitlines() if notes.exists() else []
    return max((int(size) for number, size in map(str.split, lines) if number == inode), default=0)


if __name__ == "__main__":
    note_syncs(Path(sys.argv.pop(1)))
    from labhil.cli import main

    main()
