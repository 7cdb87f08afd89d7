"""Messages of the working parts to the screen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from textual.message import Message

from labhil.tui.recording_library import LibraryEntry


@dataclass
class RunLine(Message):
    """A line of the run process."""

    line: dict[str, Any]


@dataclass
class StudyLine(Message):
    """A line of the process of job ``number``."""

    number: int
    line: dict[str, Any]


@dataclass
class LibraryRead(Message):
    """The recordings of the folder, as far as they are read."""

    recordings: list[LibraryEntry]


@dataclass
class StartRequested(Message):
    """A request to run this experiment."""

    path: str


@dataclass
class StudyRequested(Message):
    """A request for a study; ``task`` is a labhil.campaign.studies.study.Task."""

    task: Any
