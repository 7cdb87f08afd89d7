"""List of the recordings and results in folders, with a filter by tag, rig, time and text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from labhil.documents import LARGEST, parse_json
from labhil.errors import LabhilError, UsageError
from labhil.recording.contents import FREE_TEXT, recording_status, start_time, tags_of
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording

RESULTS = {
    "labhil.fit/1": "fit",
    "labhil.diagnosis/1": "diagnosis",
    "labhil.verification/1": "verification",
    "labhil.comparison/1": "comparison",
    "labhil.campaign/1": "campaign",
}
MAX_RESULT_SIZE = LARGEST


@dataclass(frozen=True, slots=True)
class Entry:
    """A file: a recording, a campaign, or the result of a fit, diagnosis, verification or comparison.

    Attributes:
        path: the file.
        kind: kind of the file.
        start: time of the first sample, or time of modification without such a time.
        status: status of a recording, verdict of a result.
        rig: rig kind.
        duration: duration of a recording, s.
        tags: tags of a recording.
        summary: short description.
        text: text that a filter searches.
    """

    path: Path
    kind: str
    start: datetime
    status: str = ""
    rig: str | None = None
    duration: float | None = None
    tags: tuple[str, ...] = ()
    summary: str = ""
    text: str = field(default="", repr=False)

    def to_json(self) -> dict[str, Any]:
        """Item of ``labhil.list/1``."""
        return {
            "path": str(self.path),
            "kind": self.kind,
            "start": self.start.isoformat(),
            "status": self.status,
            "rig": self.rig,
            "duration": self.duration,
            "tags": list(self.tags),
            "summary": self.summary,
        }


@dataclass(frozen=True, slots=True)
class Filter:
    """Filter of files: all ``tags``, ``rig`` kind, ``since`` ≤ start < ``until``, ``text`` anywhere."""

    tags: tuple[str, ...] = ()
    rig: str | None = None
    since: datetime | None = None
    until: datetime | None = None
    text: str | None = None

    def matches(self, entry: Entry) -> bool:
        """Whether a file matches, regardless of upper and lower case."""
        entry_tags = {tag.casefold() for tag in entry.tags}
        return (
            all(tag.casefold() in entry_tags for tag in self.tags)
            and (self.rig is None or entry.rig == self.rig)
            and (self.since is None or entry.start >= self.since)
            and (self.until is None or entry.start < self.until)
            and (self.text is None or self.text.casefold() in entry.text.casefold())
        )


def list_folder(folders: Sequence[Path], wanted: Filter | None = None) -> list[Entry]:
    """List the files in folders and their subfolders, the newest first.

    Args:
        folders: the folders.
        wanted: filter; None for all files.

    Returns:
        The files.

    Raises:
        UsageError: A folder does not exist.
    """
    wanted = Filter() if wanted is None else wanted
    entries: dict[Path, Entry] = {}
    for folder in folders:
        if not folder.is_dir():
            raise UsageError(f"{folder}: expected a folder with recordings, found none")
        for entry in _entries(folder):
            entries.setdefault(entry.path.resolve(), entry)
    return sorted((entry for entry in entries.values() if wanted.matches(entry)), key=_newest_first)


def _newest_first(entry: Entry) -> tuple[float, str]:
    return -entry.start.timestamp(), str(entry.path)


def _entries(folder: Path) -> Iterator[Entry]:
    for path in sorted(folder.rglob("*")):
        if any(part.startswith(".") for part in path.relative_to(folder).parts) or not path.is_file():
            continue
        if path.name.endswith((".mcap", ".mcap.part")):
            yield _recording_entry(path)
        elif path.suffix == ".json":
            result = _result_entry(path)
            if result is not None:
                yield result


def _recording_entry(path: Path) -> Entry:
    written = _modified_at(path)
    try:
        recording = read_recording(path)
    except LabhilError as error:
        summary = str(error).removeprefix(f"{path}: ")
        return Entry(path, "recording", written, "unreadable", summary=summary, text=f"{path} {summary}")
    tags = tags_of(recording)
    experiment = recording.metadata.get("experiment", {})
    summary = ", ".join(experiment[key] for key in ("name", *FREE_TEXT) if experiment.get(key))
    return Entry(
        path,
        "recording",
        start_time(recording) or written,
        recording_status(recording),
        recording.rig.kind.name if recording.rig is not None else None,
        recording.duration,
        tags,
        summary,
        " ".join([str(path), summary, *tags, *_mark_messages(recording)]),
    )


def _mark_messages(recording: Recording) -> Iterator[str]:
    for event in recording.events:
        if event.body.get("kind") == "mark":
            yield str(event.body.get("message", ""))


def _result_entry(path: Path) -> Entry | None:
    try:
        if path.stat().st_size > MAX_RESULT_SIZE:
            return None
        data = parse_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    kind = RESULTS.get(str(data.get("schema"))) if isinstance(data, dict) else None
    if kind is None:
        return None
    recordings = data.get("recordings")
    parts = [part for part in recordings if isinstance(part, dict)] if isinstance(recordings, list) else []
    rig = data.get("rig") or next((part.get("rig") for part in parts), None)
    subject = ", ".join(Path(str(part["path"])).name for part in parts if "path" in part)
    if kind == "campaign":
        runs = data.get("runs") if isinstance(data.get("runs"), list) else []
        done = sum(isinstance(run, dict) and run.get("status") == "done" for run in runs)
        status, subject = f"{done} of {len(runs)}", str(data.get("experiment", ""))
    else:
        status = str(data.get("verdict") or "")
    rig = str(rig) if rig is not None else None
    return Entry(path, kind, _modified_at(path), status, rig, None, (), subject, f"{path} {subject} {status}")


def _modified_at(path: Path) -> datetime:
    try:
        return datetime.fromtimestamp(path.stat().st_mtime, UTC)
    except OSError:
        return datetime.fromtimestamp(0, UTC)


def format_list(entries: Sequence[Entry]) -> Iterator[str]:
    """Yield a line per file, with aligned columns."""
    rows = [
        (
            f"{entry.start.astimezone():%Y-%m-%d %H:%M:%S}",
            entry.kind,
            entry.status,
            entry.rig or "–",
            "" if entry.duration is None else f"{entry.duration:.4g} s",
            str(entry.path),
            " ".join(part for part in (" ".join(f"#{tag}" for tag in entry.tags), entry.summary) if part),
        )
        for entry in entries
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def parse_moment(text: str, option: str) -> datetime:
    """Parse a date or time in local time; UsageError names the ``option``."""
    try:
        return datetime.fromisoformat(text).astimezone()
    except ValueError as error:
        raise UsageError(f"{option} {text!r}: expected a date like 2026-05-31 or 2026-05-31T14:00") from error
