"""Studies at work: one process each, several may run, each can be cancelled."""

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
WRITES = ("fit", "diagnose", "compare")
"""Kinds of study that answer with the path of their result."""


@dataclass(slots=True)
class Job:
    """One study. ``state`` is "at work", "done", "failed" or "cancelled"; ``said`` its newest line."""

    number: int
    task: Task
    helper: Helper
    started: float
    state: str = "at work"
    said: str = "starting"
    done: Any = None
    result: Path | None = None
    """The file that it wrote, where it is one."""

    @property
    def title(self) -> str:
        """What it is, for a person."""
        return self.task.title


class Jobs:
    """Studies of one screen or service. ``on_line`` gets (number, line) in threads of the jobs' own."""

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
    def at_work(self) -> list[Job]:
        """Those that are not over."""
        return [job for job in self.all if job.state == "at work"]

    def take(self, number: int, line: dict[str, Any]) -> Job:
        """Follow the lines of a job; called in one thread."""
        job = self.all[number]
        if "ended" in line:
            job.helper.close(CANCEL_PATIENCE)  # its pipes would stay open, and a service lives for months
        if job.state != "at work":
            return job
        if "progress" in line:
            job.said = str(line["progress"])
        elif "done" in line:
            job.state, job.done, job.said = "done", line["done"], str(line.get("verdict", "done"))
            written = line.get("path", job.done if job.task.kind in WRITES else None)
            job.result = None if written is None else Path(str(written))
        elif "failed" in line:
            job.state, job.said = "failed", str(line["failed"])
        elif "ended" in line:
            job.state, job.said = "failed", line["complaint"] or f"its process ended with {line['ended']}"
        return job

    def end(self, job: Job) -> None:
        """Let a fit or a diagnosis end with the best so far; its file says that it was ended early."""
        if job.state == "at work":
            job.said = "ending with the best so far"
            job.helper.tell({"end": True})

    def cancel(self, job: Job) -> None:
        """End a study; files are as they were before, or whole."""
        if job.state == "at work":
            job.state, job.said = "cancelled", "cancelled; nothing was changed"
            job.helper.close(CANCEL_PATIENCE)

    def close(self) -> None:
        """End all of them."""
        for job in self.all:
            job.helper.close(CANCEL_PATIENCE)
