"""Running studies: one process each; several may run at once, and each can be cancelled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from labhil.campaign.studies.process import Helper
from labhil.campaign.studies.study import Task

CANCEL_PATIENCE = 1.0
MODULE = "labhil.campaign.studies.study"
KINDS_WITH_RESULT = ("fit", "diagnose", "compare")
"""Kinds of study whose answer is the path of their result."""


@dataclass(slots=True)
class Job:
    """A study and its process.

    Attributes:
        number: its index among the jobs.
        task: the study.
        helper: the process.
        started: time of its start by the clock of the jobs, s.
        state: "at work", "done", "failed" or "cancelled".
        message: its newest line of text.
        done: its answer.
        result: the file that it wrote.
    """

    number: int
    task: Task
    helper: Helper
    started: float
    state: str = "at work"
    message: str = "starting"
    done: Any = None
    result: Path | None = None

    @property
    def title(self) -> str:
        """Its title for people."""
        return self.task.title


class Jobs:
    """The studies of a screen or a service.

    Args:
        on_line: is called with (number, line) for each line of a job, in threads of the jobs.
        clock: returns the time, s.
    """

    def __init__(self, on_line: Callable[[int, dict[str, Any]], object], clock: Callable[[], float]) -> None:
        self._on_line, self._clock = on_line, clock
        self.all: list[Job] = []

    def start(self, task: Task) -> Job:
        """Start a study."""
        number = len(self.all)
        helper = Helper(task.title, MODULE, task.to_json(), partial(self._on_line, number))
        self.all.append(Job(number, task, helper, self._clock()))
        return self.all[-1]

    @property
    def running(self) -> list[Job]:
        """Jobs that have not ended."""
        return [job for job in self.all if job.state == "at work"]

    def handle_line(self, number: int, line: dict[str, Any]) -> Job:
        """Update a job by one of its lines; to be called in a single thread."""
        job = self.all[number]
        if "ended" in line:
            job.helper.close(CANCEL_PATIENCE)  # else its pipes stay open, in a service that runs for months
        if job.state != "at work":
            return job
        if "progress" in line:
            job.message = str(line["progress"])
        elif "done" in line:
            job.state, job.done, job.message = "done", line["done"], str(line.get("verdict", "done"))
            path = line.get("path", job.done if job.task.kind in KINDS_WITH_RESULT else None)
            job.result = None if path is None else Path(str(path))
        elif "failed" in line:
            job.state, job.message = "failed", str(line["failed"])
        elif "ended" in line:
            job.state, job.message = "failed", line["complaint"] or f"its process ended with {line['ended']}"
        return job

    def finish_early(self, job: Job) -> None:
        """End a fit or a diagnosis with the best result so far; its file states that it was ended early."""
        if job.state == "at work":
            job.message = "ending with the best so far"
            job.helper.send({"end": True})

    def cancel(self, job: Job) -> None:
        """Cancel a study; files stay complete."""
        if job.state == "at work":
            job.state, job.message = "cancelled", "cancelled; nothing was changed"
            job.helper.close(CANCEL_PATIENCE)

    def close(self) -> None:
        """Cancel all studies."""
        for job in self.all:
            job.helper.close(CANCEL_PATIENCE)
