"""Why a file cannot be read, for its user: there is none of that name, it is a folder, or of another kind."""

from __future__ import annotations

import difflib
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

BEGIN = 1 << 16
"""Bytes at the beginning of a file by which its kind is recognised."""

MOST_CANDIDATES = 20
"""Files with near names whose beginning is read."""


@dataclass(frozen=True, slots=True)
class FileKind:
    """A kind of file that commands take.

    Attributes:
        plural: What several of them are called.
        suffix: How their names end.
        mark: What is in the beginning of every one.
    """

    plural: str
    suffix: str
    mark: re.Pattern[bytes] = re.compile(b"")

    def matches(self, path: Path) -> bool:
        """Whether a file is of this kind, by its name and its beginning."""
        with suppress(OSError):
            if path.suffix.lower() == self.suffix and path.is_file():
                with path.open("rb") as file:
                    return self.mark.search(file.read(BEGIN)) is not None
        return False


EXPERIMENT = FileKind("experiment files", ".toml", re.compile(rb"^\s*\[experiment\]", re.MULTILINE))
RIG = FileKind("rig files", ".toml", re.compile(rb"^\s*\[(rig|model)\]", re.MULTILINE))
LAB = FileKind("lab files", ".toml", re.compile(rb"^\s*\[lab\]", re.MULTILINE))
LINKS = FileKind("tables of links", ".toml", re.compile(rb"^\s*\[\[joint\]\]", re.MULTILINE))
CAMPAIGN = FileKind("campaign files", ".json")
RECORDING = FileKind("recordings", ".mcap")
RESULT = FileKind("results", ".json", re.compile(rb'"labhil\.(fit|diagnosis|verification|comparison)/'))


def reason_unreadable(path: Path, error: OSError | ValueError, kind: FileKind) -> str:
    """Return why a file cannot be read, and what its user may have meant.

    Args:
        path: The file.
        error: What reading it raised.
        kind: What it was expected to be.

    Returns:
        The end of a message, after "FILE: cannot be read: ".
    """
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        if not path.parent.is_dir():
            return f"there is no folder {path.parent}"
        return f"there is no such file{nearest_file(path, kind)}"
    if isinstance(error, IsADirectoryError):
        return f"it is a folder; give the {kind.plural} in it, like {path / f'*{kind.suffix}'}"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error)


def nearest_file(path: Path, kind: FileKind) -> str:
    """Return ``"; the nearest there is levels.toml"``, of this kind; empty where its folder has none."""
    names: list[str] = []
    with suppress(OSError):
        names = sorted(file.name for file in path.parent.iterdir() if file.suffix.lower() == kind.suffix)
    near = difflib.get_close_matches(path.name, names, n=MOST_CANDIDATES, cutoff=0.0)
    found = next((name for name in near if kind.matches(path.parent / name)), "")
    return f"; the nearest there is {found}" if found else ""


def beginning_of(data: bytes, length: int = 8) -> str:
    """Return how a file begins that is not what was expected: as text, or its bytes in hexadecimal digits.

    Example:
        >>> beginning_of(b"# The bench"), beginning_of(bytes([0x89, 0x48, 0x44, 0x46]))
        ("the text '# The be'", 'the bytes 89 48 44 46')
    """
    begin = bytes(data[:length])
    text = begin.decode("utf-8", "replace")
    if text.translate({10: " ", 9: " ", 13: " "}).isprintable() and "\ufffd" not in text[:-1]:
        return f"the text {text!r}"
    return f"the bytes {begin.hex(' ')}"
