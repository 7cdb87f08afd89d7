"""Messages from threads and panes to the app."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from textual.message import Message

from labhil.tui.recording_library import LibraryEntry


@dataclass
class RunLine(Message):
    """Carry a line of the run process."""

    line: dict[str, Any]


@dataclass
class StudyLine(Message):
    """Carry a line of the process of job ``number``."""

    number: int
    line: dict[str, Any]


@dataclass
class LibraryRead(Message):
    """Carry the recordings of the folder that have been read."""

    recordings: list[LibraryEntry]


@dataclass
class StartRequested(Message):
    """Request a run of the experiment file at ``path``."""

    path: str


@dataclass
class StudyRequested(Message):
    """Request a study; ``task`` is a labhil.campaign.studies.study.Task."""

    task: Any
