"""The worker of a lab: it studies every finished recording in turn, by the policies of the lab file.

Each study is a separate process (``campaign.studies``) that writes a complete result beside the recording, or
none. Progress and results are published as JSON on ``lab/@worker/progress`` and ``lab/@worker/result``;
results are logged in the folder's ``results.jsonl``, too.
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
from labhil.campaign.result_log import append_entry, unstudied_recordings, verdict_of
from labhil.campaign.studies.jobs import Job, Jobs
from labhil.campaign.studies.study import Task
from labhil.errors import LabhilError
from labhil.host_clock import unix_ns

Say = Callable[[str], None]


class Worker:
    """Studies the recordings that are finished in a folder from now on, until it is closed.

    Recordings that earlier workers missed come first. A recording that cannot be studied does not stop the
    worker: each study has a process and a time limit.

    Args:
        folder: folder of the recordings.
        tasks: returns the studies of a recording; raises LabhilError for one that cannot be read.
        bus: the bus that progress and results are published on.
        say: is called with lines of text.
        time_limit: time after which a study is cancelled, s; twice a study's own limit is added.
        settling_time: time without changes after which a file is taken as finished, s.
    """

    def __init__(
        self,
        folder: Path,
        tasks: Callable[[Path], Iterable[Task]],
        bus: Bus,
        say: Say,
        *,
        time_limit: float = 3600.0,
        settling_time: float = 1.0,
    ) -> None:
        self._folder, self._tasks_of, self._bus, self._say = folder, tasks, bus, say
        self._time_limit, self._settling_time = time_limit, settling_time
        self._seen = set(folder.glob("*.mcap")) - self._missed_recordings()
        self._waiting: list[Task] = []
        self._incoming: queue.Queue[tuple[int, dict[str, Any]]] = queue.Queue()
        self._jobs = Jobs(lambda number, line: self._incoming.put((number, line)), time.monotonic)

    @property
    def idle(self) -> bool:
        """Whether no study is running or waiting."""
        return not self._waiting and not self._jobs.running

    def poll(self) -> None:
        """Handle lines of studies, look for finished recordings, start the next study; call it repeatedly."""
        while not self._incoming.empty():
            self._handle_line(*self._incoming.get())
        for job in self._jobs.running:
            self._cancel_overdue(job)
        for path in sorted(self._folder.glob("*.mcap")):
            if path not in self._seen and self._is_settled(path):
                self._seen.add(path)
                self._enqueue(path)
        if self._waiting and not self._jobs.running:
            job = self._jobs.start(self._waiting.pop(0))
            self._publish(WORKER_PROGRESS, job, {"said": job.message})

    def close(self) -> None:
        """Cancel the running study; recordings and results stay complete."""
        self._jobs.close()

    def _missed_recordings(self) -> set[Path]:
        unstudied = unstudied_recordings(self._folder)
        if unstudied:
            names = ", ".join(path.name for path in unstudied)
            self._say(f"recorded while nobody studied what came in, so now: {names}")
        return set(unstudied)

    def _is_settled(self, path: Path) -> bool:
        try:
            return time.time() - path.stat().st_mtime > self._settling_time
        except OSError:
            return False  # deleted since it was listed

    def _enqueue(self, path: Path) -> None:
        try:
            self._waiting += self._tasks_of(path)
        except LabhilError as error:
            self._say(f"{path.name}: not studied: {error}")
            self._log(path, {"study": None, "state": "failed", "said": str(error)})

    def _cancel_overdue(self, job: Job) -> None:
        limit = self._time_limit + 2.0 * (job.task.seconds or 0.0)
        if time.monotonic() - job.started > limit:
            self._jobs.cancel(job)
            job.message = f"ended by force after {limit:.4g} s"
            self._finish(job)

    def _handle_line(self, number: int, line: dict[str, Any]) -> None:
        was = self._jobs.all[number].state
        job = self._jobs.handle_line(number, line)
        if was != "at work":
            return
        if job.state == "at work":
            self._publish(WORKER_PROGRESS, job, {"said": job.message})
        else:
            self._finish(job)

    def _finish(self, job: Job) -> None:
        """Publish, print and log the outcome of a study."""
        self._publish(WORKER_RESULT, job, {"result": job.done, "said": job.message})
        outcome = [job.done] if job.state == "done" and job.message == "done" else [job.done, job.message]
        self._say(f"{job.title}: {', '.join(str(part) for part in outcome if part is not None)}")
        task, result = job.task, job.result
        entry = {
            "study": task.kind,
            "device": task.device,
            "state": job.state,
            "result": None if result is None else result.name,
            "verdict": None if result is None else verdict_of(result),
            "said": job.message,
            "seconds": round(time.monotonic() - job.started, 1),
            "terms": None if task.terms is None else list(task.terms),
            "estimator": task.estimator,
            "model": None if task.model is None else str(task.model),
        }
        self._log(task.recordings[0], entry)

    def _log(self, recording: Path, entry: dict[str, Any]) -> None:
        try:
            append_entry(self._folder, entry, recording)
        except OSError as error:
            self._say(f"{recording.name}: its result could not be logged: {error}")

    def _publish(self, key: str, job: Job, fields: dict[str, Any]) -> None:
        data = {"t_ns": unix_ns(), "study": job.task.to_json(), "state": job.state, **fields}
        self._bus.session.put(key, json.dumps(data, ensure_ascii=False).encode())
