"""What the working parts tell the screen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from textual.message import Message

from labhil.tui.recording_library import LibraryEntry


@dataclass
class RunSaid(Message):
    """A line of the run process."""

    line: dict[str, Any]


@dataclass
class StudySaid(Message):
    """A line of the process of job ``number``."""

    number: int
    line: dict[str, Any]


@dataclass
class ShelfRead(Message):
    """The recordings of the folder, as far as they are read."""

    recordings: list[LibraryEntry]


@dataclass
class StartWanted(Message):
    """Somebody wants this experiment to run."""

    path: str


@dataclass
class StudyWanted(Message):
    """Somebody wants this to be worked out; ``task`` is a labhil.campaign.studies.study.Task."""

    task: Any


@dataclass
class ResultWanted(Message):
    """Somebody wants to see this result file."""

    path: str
