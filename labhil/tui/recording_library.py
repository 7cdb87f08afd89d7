"""The files of a folder: recordings, results and experiments, as the screen lists them."""

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
from labhil.recording.contents import free_text_of, is_imported
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording

LARGEST_READ = 256 << 20
"""Largest recording that is read for the list, bytes: reading more takes seconds."""

GROWING_TIME = 3.0
"""Time after its last change in which a file without its final name counts as growing, s."""

LARGEST_RESULT = LARGEST
SCHEMAS = {
    "labhil.fit/1": "fit",
    "labhil.diagnosis/1": "diagnosis",
    "labhil.comparison/1": "comparison",
    "labhil.verification/1": "verification",
}
KINDS_WITH_MODEL = ("fit", "diagnosis")


@dataclass(frozen=True, slots=True)
class LibraryEntry:
    """Describe one recording; a field that cannot be read is None.

    Attributes:
        path: The file.
        size: Bytes.
        modified: Unix time of its last change, s.
        rig: Rig kind.
        duration: s of the time of the device.
        samples: Number of samples.
        gaps: Number of samples that are missing.
        status: "done", "failed", "imported", "no end", "growing" while it is written, or "unreadable".
        reason: Reason of the end of the run.
        fault: Why a field cannot be read.
        words: What the experiment file says in words, by key: operator, sample, notes, tags.
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
    words: tuple[tuple[str, str], ...] = ()

    @property
    def when(self) -> str:
        """Time of its last change, local time."""
        return datetime.fromtimestamp(self.modified).astimezone().strftime("%d %b %H:%M")


class RecordingLibrary:
    """List the recordings of a folder; each is read once, and again where it changes.

    Args:
        folder: The folder.
        clock: Unix time, s.
    """

    def __init__(self, folder: Path, clock: Callable[[], float] = time.time) -> None:
        self.folder, self._clock = folder, clock
        self._entries: dict[tuple[Path, int, float], LibraryEntry] = {}

    def scan(self) -> Iterator[list[LibraryEntry]]:
        """Yield the list repeatedly while it is read, the newest recording first.

        A growing file is not read, since every scan would read it again.
        """
        keys = sorted(_recordings(self.folder), key=lambda key: -key[2])
        self._entries = {key: self._entries[key] for key in keys if key in self._entries}
        entries = [self._entries.get(key, LibraryEntry(*key)) for key in keys]
        yield list(entries)
        for index, key in enumerate(keys):
            if key in self._entries:
                continue
            if key[0].suffix == ".part" and abs(self._clock() - key[2]) < GROWING_TIME:
                entries[index] = LibraryEntry(*key, status="growing")
            else:
                entries[index] = self._entries[key] = read_entry(*key)
            yield list(entries)


def _recordings(folder: Path) -> Iterator[tuple[Path, int, float]]:
    for pattern in ("*.mcap", "*.mcap.part"):
        for path in folder.glob(pattern):
            try:
                status = path.stat()
            except OSError:
                continue  # renamed between listing and looking
            yield path, status.st_size, status.st_mtime


def read_entry(path: Path, size: int, modified: float) -> LibraryEntry:
    """Read one recording for the list; ``fault`` holds the error, if any.

    Args:
        path: The file.
        size: Its bytes.
        modified: Unix time of its last change, s.
    """
    if size > LARGEST_READ:
        return LibraryEntry(path, size, modified, fault="large: open it to read it")
    try:
        recording = read_recording(path)
    except LabhilError as error:
        return LibraryEntry(path, size, modified, status="unreadable", fault=str(error))
    status, reason = run_outcome(recording)
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
        words=tuple(free_text_of(recording).items()),
    )


def run_outcome(recording: Recording) -> tuple[str, str]:
    """Return the exit status of the run as a word, and its reason."""
    end_metadata = recording.metadata.get("end", {})
    status, reason = end_metadata.get("exit_status", ""), end_metadata.get("reason", "")
    if not recording.complete or not end_metadata:
        return "no end", recording.damage
    if is_imported(recording.metadata):
        return "imported", reason
    return ("done" if status in ("0", "done") else f"failed ({status})"), reason


@dataclass(frozen=True, slots=True)
class ResultFile:
    """Describe the JSON file of a fit, a diagnosis, a comparison or a verification."""

    path: Path
    kind: str
    modified: float


def list_results(folder: Path) -> list[ResultFile]:
    """Return the results in a folder, the newest first; other JSON files are left out."""
    result_files = []
    for path in folder.glob("*.json"):
        try:
            status = path.stat()
        except OSError:
            continue  # gone between listing and looking
        kind = _kind(path, status.st_size, status.st_mtime_ns)
        if kind is not None:
            result_files.append(ResultFile(path, kind, status.st_mtime))
    return sorted(result_files, key=lambda result: -result.modified)


def list_models(folder: Path) -> list[ResultFile]:
    """Return the results that have a model, the newest first."""
    return [result for result in list_results(folder) if result.kind in KINDS_WITH_MODEL]


@lru_cache(maxsize=4096)
def _kind(path: Path, size: int, _modified_ns: int) -> str | None:
    """Kind of the result in a file of that size and age; None where it is no result. Cached."""
    if size > LARGEST_RESULT:
        return None
    try:
        return SCHEMAS.get(parse_json(path.read_text(encoding="utf-8")).get("schema"))
    except (OSError, ValueError, AttributeError, TypeError):
        return None


@dataclass(frozen=True, slots=True)
class ExperimentFile:
    """Describe an experiment file.

    Attributes:
        path: The file.
        name: Name of the experiment; that of the file where it cannot be read.
        packaged: Whether it comes with labhil.
        readable: Whether the file is TOML.
    """

    path: Path
    name: str
    packaged: bool
    readable: bool = True


def list_experiments(folder: Path) -> list[ExperimentFile]:
    """Return the experiments in a folder, then those that come with labhil.

    A file that cannot be read is listed too: it may be an experiment with an error in it.
    """
    examples = Path(str(files("labhil.experiment") / "examples"))
    local = [(path, False) for path in sorted(folder.glob("*.toml"))]
    packaged = [(path, True) for path in sorted(examples.glob("*.toml"))]
    experiment_files = []
    for path, is_packaged in [*local, *packaged]:
        try:
            data = parse_toml(read_document(path))
        except FileNotFoundError:
            continue  # gone between listing and looking
        except (OSError, ValueError):
            experiment_files.append(ExperimentFile(path, path.name, is_packaged, readable=False))
            continue
        section = data.get("experiment")
        if isinstance(section, dict):
            experiment_files.append(ExperimentFile(path, str(section.get("name", path.stem)), is_packaged))
    return experiment_files
