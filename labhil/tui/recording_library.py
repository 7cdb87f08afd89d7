"""The files of a folder, as a screen lists them: recordings, results, experiments."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

from labhil.documents import LARGEST, parse_json, parse_toml, read_document
from labhil.errors import LabhilError
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording

LARGEST_READ = 256 << 20
"""Recordings of more bytes are listed by their size alone: reading them takes seconds."""

GROWING = 3.0
"""A file without its final name that was written to so many s ago has somebody who writes it."""

LARGEST_RESULT = LARGEST
SCHEMAS = {
    "labhil.fit/1": "fit",
    "labhil.diagnosis/1": "diagnosis",
    "labhil.comparison/1": "comparison",
    "labhil.verification/1": "verification",
}


@dataclass(frozen=True, slots=True)
class LibraryEntry:
    """One recording. What cannot be read is None, and ``fault`` says why.

    ``duration`` in s of the device's world; ``status`` is "done", "failed", "imported", "no end",
    "growing" while somebody writes it, or "unreadable".
    """

    path: Path
    size: int
    modified: float
    rig: str | None = None
    duration: float | None = None
    samples: int | None = None
    gaps: int | None = None
    status: str = ""
    reason: str = ""
    fault: str = ""

    @property
    def when(self) -> str:
        """When it was written, local time."""
        return datetime.fromtimestamp(self.modified).astimezone().strftime("%d %b %H:%M")


class RecordingLibrary:
    """The recordings of a folder, read once and again only where they change."""

    def __init__(self, folder: Path, clock: Callable[[], float] = time.time) -> None:
        self.folder, self._clock = folder, clock
        self._known: dict[tuple[Path, int, float], LibraryEntry] = {}

    def look(self) -> Iterator[list[LibraryEntry]]:
        """Yield the list again and again while it is read, the newest recording first.

        A file that grows is not read: it would be read anew with each look.
        """
        found = sorted(_recordings(self.folder), key=lambda key: -key[2])
        self._known = {key: self._known[key] for key in found if key in self._known}
        shelved = [self._known.get(key, LibraryEntry(*key)) for key in found]
        yield list(shelved)
        for index, key in enumerate(found):
            if key in self._known:
                continue
            if key[0].suffix == ".part" and abs(self._clock() - key[2]) < GROWING:
                shelved[index] = LibraryEntry(*key, status="growing")
            else:
                shelved[index] = self._known[key] = describe(*key)
            yield list(shelved)


def _recordings(folder: Path) -> Iterator[tuple[Path, int, float]]:
    for pattern in ("*.mcap", "*.mcap.part"):
        for path in folder.glob(pattern):
            try:
                about = path.stat()
            except OSError:
                continue  # renamed between listing and looking
            yield path, about.st_size, about.st_mtime


def describe(path: Path, size: int, modified: float) -> LibraryEntry:
    """Read one recording; what is wrong with it stands in ``fault``."""
    if size > LARGEST_READ:
        return LibraryEntry(path, size, modified, fault="large: open it to read it")
    try:
        recording = read_recording(path)
    except LabhilError as error:
        return LibraryEntry(path, size, modified, status="unreadable", fault=str(error))
    status, reason = how_it_ended(recording)
    measured = [data for data in recording.streams if data.stream.name != "command"]
    return LibraryEntry(
        path,
        size,
        modified,
        rig=recording.rig.kind.name if recording.rig is not None else None,
        duration=recording.duration,
        samples=sum(len(data) for data in measured),
        gaps=sum(data.lost for data in recording.streams),
        status=status,
        reason=reason,
        fault=recording.damage,
    )


def how_it_ended(recording: Recording) -> tuple[str, str]:
    """The exit status of the run as a word, and its reason."""
    told = recording.metadata.get("end", {})
    status, reason = told.get("exit_status", ""), told.get("reason", "")
    if not recording.complete or not told:
        return "no end", recording.damage
    if "experiment" not in recording.metadata:
        return "imported", reason
    return ("done" if status in ("0", "done") else f"failed ({status})"), reason


@dataclass(frozen=True, slots=True)
class ResultFile:
    """The JSON of a fit or a diagnosis."""

    path: Path
    kind: str
    modified: float


def results(folder: Path) -> list[ResultFile]:
    """The results in a folder, the newest first; other JSON is left out."""
    found = []
    for path in folder.glob("*.json"):
        try:
            about = path.stat()
        except OSError:
            continue  # gone between listing and looking
        kind = _kind(path, about.st_size, about.st_mtime_ns)
        if kind is not None:
            found.append(ResultFile(path, kind, about.st_mtime))
    return sorted(found, key=lambda result: -result.modified)


@lru_cache(maxsize=4096)
def _kind(path: Path, size: int, _modified_ns: int) -> str | None:
    """What a file of that size and age holds, None where it is no result; looked into once."""
    if size > LARGEST_RESULT:
        return None
    try:
        return SCHEMAS.get(parse_json(path.read_text(encoding="utf-8")).get("schema"))
    except (OSError, ValueError, AttributeError, TypeError):
        return None


@dataclass(frozen=True, slots=True)
class ExperimentFile:
    """An experiment file; ``packaged`` ones come with labhil."""

    path: Path
    name: str
    packaged: bool


def experiments(folder: Path) -> list[ExperimentFile]:
    """The experiments in a folder, then those that come with labhil."""
    examples = Path(str(files("labhil.experiment") / "examples"))
    own = [(path, False) for path in sorted(folder.glob("*.toml"))]
    packaged = [(path, True) for path in sorted(examples.glob("*.toml"))]
    found = []
    for path, is_packaged in [*own, *packaged]:
        try:
            data = parse_toml(read_document(path))
        except (OSError, ValueError):
            continue
        section = data.get("experiment")
        if isinstance(section, dict):
            found.append(ExperimentFile(path, str(section.get("name", path.stem)), is_packaged))
    return found
