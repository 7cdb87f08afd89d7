"""The worker of a lab: fits and diagnoses every recording that is finished, one after another.

Each study is a process of its own (``campaign.studies``); its result lies beside the recording, whole or not
at all. What it is doing, and what came of it, is published on ``lab/@worker/progress`` and
``lab/@worker/result`` as JSON.
"""

from __future__ import annotations

import json
import queue
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from labhil.bus.keys import WORKER_PROGRESS, WORKER_RESULT
from labhil.bus.session import Bus
from labhil.campaign.studies.jobs import Job, Jobs
from labhil.campaign.studies.study import Task
from labhil.host_clock import unix_ns

SETTLED = 1.0
"""How long a file has to be left alone before it is looked at, s."""

Say = Callable[[str], None]


class Worker:
    """Works on what is finished in ``folder`` after it began; close it to end what it is doing.

    ``analyse`` are the kinds of study that each recording gets, in order.
    """

    def __init__(self, folder: Path, analyse: Sequence[str], bus: Bus, say: Say) -> None:
        self._folder, self._analyse, self._bus, self._say = folder, tuple(analyse), bus, say
        self._seen = set(folder.glob("*.mcap"))
        self._waiting: list[Task] = []
        self._said: queue.SimpleQueue[tuple[int, dict[str, Any]]] = queue.SimpleQueue()
        self._jobs = Jobs(lambda number, line: self._said.put((number, line)), time.monotonic)

    @property
    def idle(self) -> bool:
        """Whether there is nothing to do for the moment."""
        return not self._waiting and not self._jobs.at_work

    def look(self) -> None:
        """Take what studies say, find finished recordings, begin the next study; called again and again."""
        while not self._said.empty():
            self._follow(*self._said.get())
        for path in sorted(self._folder.glob("*.mcap")):
            if path not in self._seen and time.time() - path.stat().st_mtime > SETTLED:
                self._seen.add(path)
                self._waiting += [Task(kind, (path,)) for kind in self._analyse]
        if self._waiting and not self._jobs.at_work:
            job = self._jobs.start(self._waiting.pop(0))
            self._tell(WORKER_PROGRESS, job, {"said": job.said})

    def close(self) -> None:
        """End what is at work; recordings and results are whole, as ever."""
        self._jobs.close()

    def _follow(self, number: int, line: dict[str, Any]) -> None:
        was = self._jobs.all[number].state
        job = self._jobs.take(number, line)
        if was != "at work":
            return
        if job.state == "at work":
            self._tell(WORKER_PROGRESS, job, {"said": job.said})
            return
        self._tell(WORKER_RESULT, job, {"result": job.done, "said": job.said})
        came = [job.done] if job.state == "done" and job.said == "done" else [job.done, job.said]
        self._say(f"{job.title}: {', '.join(str(part) for part in came if part is not None)}")

    def _tell(self, key: str, job: Job, more: dict[str, Any]) -> None:
        data = {"t_ns": unix_ns(), "study": job.task.to_json(), "state": job.state, **more}
        self._bus.session.put(key, json.dumps(data, ensure_ascii=False).encode())
