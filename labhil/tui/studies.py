"""Fits, diagnoses, verifications and exports that the screen starts, and their announcements."""

from __future__ import annotations

import time

from textual.app import App

from labhil.campaign.studies.jobs import Job, Jobs
from labhil.tui.dialogs import Notice
from labhil.tui.messages import StudyLine, StudyRequested

WITHOUT_RESULT_FILE = ("export", "verify")
"""Kinds of studies whose answer is no file in the list of results."""


def has_result(job: Job) -> bool:
    """Return whether a job has ended with a file that the list of results shows."""
    return job.state == "done" and job.task.kind not in WITHOUT_RESULT_FILE


class Studies:
    """Start studies in processes of their own, follow them, and announce their ends.

    Args:
        app: Gets each line of a process as :class:`StudyLine`, and shows notes and dialogs.
    """

    def __init__(self, app: App[None]) -> None:
        self._app = app
        self.jobs = Jobs(lambda number, line: app.post_message(StudyLine(number, line)), time.monotonic)

    @property
    def at_work(self) -> list[Job]:
        """The studies that have not ended."""
        return list(self.jobs.running)

    def start(self, message: StudyRequested) -> bool:
        """Start a study; return whether it is shown in the list of results."""
        job = self.jobs.start(message.task)
        self._app.notify(f"{job.title}: at work", timeout=2)
        return job.task.kind not in WITHOUT_RESULT_FILE

    def follow(self, message: StudyLine) -> tuple[Job, bool]:
        """Handle a line of a process; return its job, and whether its state has changed."""
        before = self.jobs.all[message.number].state
        job = self.jobs.handle_line(message.number, message.line)
        return job, job.state != before

    def announce(self, job: Job) -> None:
        """Announce the end of a job: a failure with its reason, a verification with its answer."""
        if job.state == "failed":
            self._app.notify(job.message, title=job.title, severity="error", timeout=10)
        elif job.task.kind == "verify":
            self._app.push_screen(Notice(job.title, str(job.done)))
        elif job.state == "done":
            self._app.notify("done", title=job.title)
