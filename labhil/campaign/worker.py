"""The worker of a lab: studies every recording that is finished, one after another, as the lab file says.

Each study is a process of its own (``campaign.studies``); its result lies beside the recording, whole or not
at all. What it is doing, and what came of it, is published on ``lab/@worker/progress`` and
``lab/@worker/result`` as JSON; what came of it stands in the folder's ``results.jsonl``, too.
"""

from __future__ import annotations

import json
import queue
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from labhil.bus.keys import WORKER_PROGRESS, WORKER_RESULT
from labhil.bus.session import Bus
from labhil.campaign.result_log import catalogue, unstudied_recordings, verdict_of
from labhil.campaign.studies.jobs import Job, Jobs
from labhil.campaign.studies.study import Task
from labhil.errors import LabhilError
from labhil.host_clock import unix_ns

SETTLED = 1.0
"""How long a file has to be left alone before it is looked at, s."""

Say = Callable[[str], None]


class Worker:
    """Works on what is finished in ``folder`` after it began; close it to end what it is doing.

    What was recorded since one was there last comes first. Whatever is wrong with a recording, the next one
    is studied: each study has a process and a time limit.

    Args:
        folder: Where recordings appear.
        tasks: What is done with a recording; raises LabhilError for one that cannot be read.
        bus: Where progress and results are published.
        say: Takes lines for a person.
        longest: Time after which a study is ended by force, s; one with a limit of its own gets twice that
            limit in addition.
    """

    def __init__(
        self,
        folder: Path,
        tasks: Callable[[Path], Iterable[Task]],
        bus: Bus,
        say: Say,
        *,
        longest: float = 3600.0,
    ) -> None:
        self._folder, self._tasks, self._bus, self._say = folder, tasks, bus, say
        self._longest = longest
        self._seen = set(folder.glob("*.mcap")) - self._unstudied()
        self._waiting: list[Task] = []
        self._lines: queue.Queue[tuple[int, dict[str, Any]]] = queue.Queue()
        self._jobs = Jobs(lambda number, line: self._lines.put((number, line)), time.monotonic)

    @property
    def idle(self) -> bool:
        """Whether there is nothing to do for the moment."""
        return not self._waiting and not self._jobs.at_work

    def look(self) -> None:
        """Take the lines of studies, find finished recordings, begin the next study; called repeatedly."""
        while not self._lines.empty():
            self._follow(*self._lines.get())
        for job in self._jobs.at_work:
            self._end_overdue(job)
        for path in sorted(self._folder.glob("*.mcap")):
            if path not in self._seen and _is_settled(path):
                self._seen.add(path)
                self._take(path)
        if self._waiting and not self._jobs.at_work:
            job = self._jobs.start(self._waiting.pop(0))
            self._publish(WORKER_PROGRESS, job, {"said": job.said})

    def close(self) -> None:
        """End what is at work; recordings and results are whole, as ever."""
        self._jobs.close()

    def _unstudied(self) -> set[Path]:
        unstudied = unstudied_recordings(self._folder)
        if unstudied:
            names = ", ".join(path.name for path in unstudied)
            self._say(f"recorded while nobody studied what came in, so now: {names}")
        return set(unstudied)

    def _take(self, path: Path) -> None:
        try:
            self._waiting += self._tasks(path)
        except LabhilError as error:
            self._say(f"{path.name}: not studied: {error}")
            self._catalogue(path, {"study": None, "state": "failed", "said": str(error)})

    def _end_overdue(self, job: Job) -> None:
        limit = self._longest + 2.0 * (job.task.seconds or 0.0)
        if time.monotonic() - job.started > limit:
            self._jobs.cancel(job)
            job.said = f"ended by force after {limit:.4g} s"
            self._end(job)

    def _follow(self, number: int, line: dict[str, Any]) -> None:
        was = self._jobs.all[number].state
        job = self._jobs.take(number, line)
        if was != "at work":
            return
        if job.state == "at work":
            self._publish(WORKER_PROGRESS, job, {"said": job.said})
        else:
            self._end(job)

    def _end(self, job: Job) -> None:
        """Publish, print and log the outcome of a study."""
        self._publish(WORKER_RESULT, job, {"result": job.done, "said": job.said})
        came = [job.done] if job.state == "done" and job.said == "done" else [job.done, job.said]
        self._say(f"{job.title}: {', '.join(str(part) for part in came if part is not None)}")
        task, result = job.task, job.result
        entry = {
            "study": task.kind,
            "device": task.device,
            "state": job.state,
            "result": None if result is None else result.name,
            "verdict": None if result is None else verdict_of(result),
            "said": job.said,
            "seconds": round(time.monotonic() - job.started, 1),
            "terms": None if task.terms is None else list(task.terms),
            "estimator": task.estimator,
            "model": None if task.model is None else str(task.model),
        }
        self._catalogue(task.recordings[0], entry)

    def _catalogue(self, recording: Path, entry: dict[str, Any]) -> None:
        try:
            catalogue(self._folder, entry, recording)
        except OSError as error:
            self._say(f"{recording.name}: what came of it could not be noted down: {error}")

    def _publish(self, key: str, job: Job, more: dict[str, Any]) -> None:
        data = {"t_ns": unix_ns(), "study": job.task.to_json(), "state": job.state, **more}
        self._bus.session.put(key, json.dumps(data, ensure_ascii=False).encode())


def _is_settled(path: Path) -> bool:
    try:
        return time.time() - path.stat().st_mtime > SETTLED
    except OSError:
        return False  # gone between listing and looking
