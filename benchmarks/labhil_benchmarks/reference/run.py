"""Run the studies part by part on two cores; each part is kept as soon as it is there."""

from __future__ import annotations

import json
import multiprocessing
import os
import queue
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from labhil.analysis.results import finite
from labhil.atomic_file import write_json_file
from labhil.errors import RunStoppedError, UsageError
from labhil_benchmarks.reference.findings import findings
from labhil_benchmarks.reference.parts import FULL, PARTS, QUICK, Effort, Part, parts_of
from labhil_benchmarks.reference.published import NUMBERS
from labhil_benchmarks.reference.result import (
    Estimated,
    Limits,
    LinearModels,
    Reference,
    Way,
    estimated_from,
    limits_from,
    linear_from,
)
from labhil_benchmarks.reference.studies import STUDIES, studies_of
from labhil_benchmarks.reference.study import Bench, Study
from labhil_benchmarks.reference.tables import Computed, tables_of

Progress = Callable[[str], None]
Job = tuple[str, str]

WORKERS = 2
PATIENCE = 2.0
"""Seconds between two lines of progress of one worker."""

_messages: Any = None
"""The queue on which a worker process reports its progress."""

_parent = 0
"""The process that a worker works for."""


def run_reference(
    tables: Sequence[str] = NUMBERS,
    *,
    quick: bool = False,
    seed: int = 0,
    progress: Progress = lambda text: None,
    cache: Path | None = None,
    effort: Effort | None = None,
    workers: int = WORKERS,
) -> Reference:
    """Fill these tables of the text's chapter 5; everything follows from ``seed``.

    ``quick`` spends a twentieth of the swarm's iterations and few rough starts (``effort`` sets the numbers).
    Parts in the folder ``cache`` are not computed again, and finished parts stay there when the run is
    interrupted. With one worker nothing runs in another process.
    Raises UnknownNameError for a table that does not exist, UsageError for a negative seed.
    """
    if seed < 0:
        raise UsageError(f"--seed: expected 0 or more, found {seed}")
    began = time.perf_counter()
    spent = effort or (QUICK if quick else FULL)
    studies = studies_of(tables)
    kept = Kept(cache, seed, spent)
    jobs = [(study.name, part) for part in PARTS for study in studies if part in parts_of(study)]
    missing = [job for job in jobs if kept.read(job) is None]
    if len(missing) < len(jobs):
        progress(f"{len(jobs) - len(missing)} of {len(jobs)} parts were computed before")
    if workers > 1 and len(missing) > 1:
        _in_processes(missing, seed, spent, kept, progress, workers)
    else:
        for job in missing:
            progress(f"{job[0]}: {job[1]}")
            kept.write(job, compute(job, seed, spent, progress))
    computed = [_collect(study, kept) for study in studies]
    filled = [table for study in computed for table in tables_of(study) if table.number in tables]
    filled.sort(key=lambda table: NUMBERS.index(table.number))
    budget = budget_text(spent)
    return Reference(tuple(filled), findings(computed), quick, seed, budget, time.perf_counter() - began)


def budget_text(effort: Effort) -> str:
    """What was spent, in words."""
    share = "all" if effort.share == 1.0 else f"{100 * effort.share:.3g} %"
    return f"{share} of the text's iterations of the swarm, {effort.starts} rough starts of least squares"


def compute(job: Job, seed: int, effort: Effort, progress: Progress) -> Part:
    """One part of one study."""
    name, part = job
    bench = Bench.of(STUDIES[name], seed)
    return PARTS[part](bench, seed, effort, lambda text: progress(f"{name}, {part}: {text}"))


class Kept:
    """Finished parts: in memory, and as one JSON file each where a folder is given."""

    def __init__(self, folder: Path | None, seed: int, effort: Effort) -> None:
        self._folder = folder
        self._suffix = f"{seed}.{effort.share:g}.{effort.starts}.json"
        self._parts: dict[Job, Part] = {}
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def read(self, job: Job) -> Part | None:
        """The part, if it is there; a file that cannot be read counts as absent."""
        path = self._path(job)
        if job not in self._parts and path is not None and path.exists():
            try:
                self._parts[job] = _part_from(job[1], json.loads(path.read_text(encoding="utf-8")))
            except (OSError, ValueError, KeyError, TypeError):
                return None
        return self._parts.get(job)

    def write(self, job: Job, part: Part) -> None:
        """Keep a part."""
        self._parts[job] = part
        path = self._path(job)
        if path is not None:
            unfinished = path.with_suffix(".part")
            write_json_file(finite(asdict(part)), unfinished)
            unfinished.replace(path)

    def _path(self, job: Job) -> Path | None:
        return None if self._folder is None else self._folder / f"{job[0]}.{job[1]}.{self._suffix}"


def _part_from(name: str, data: Mapping[str, Any]) -> Part:
    if name == "limits":
        return limits_from(data)
    return linear_from(data) if name == "linear" else estimated_from(data)


def _collect(study: Study, kept: Kept) -> Computed:
    parts = {name: kept.read((study.name, name)) for name in parts_of(study)}
    limits, linear = parts["limits"], parts.get("linear")
    assert isinstance(limits, Limits)
    ways = {way: part for way in Way if isinstance(part := parts.get(way), Estimated)}
    return Computed(study, limits, ways, linear if isinstance(linear, LinearModels) else None)


def _in_processes(
    missing: Sequence[Job], seed: int, effort: Effort, kept: Kept, progress: Progress, workers: int
) -> None:
    """Compute parts in worker processes, keep each as it comes, report progress."""
    context = multiprocessing.get_context("spawn")
    messages = context.Queue()
    before = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(workers, context, _begin, (messages,))
    futures: dict[Future[Part], Job] = {
        executor.submit(_compute_in_worker, job, seed, effort): job for job in missing
    }
    try:
        for count, (job, part) in enumerate(_as_they_come(futures, messages, progress), 1):
            kept.write(job, part)
            progress(f"{count} of {len(missing)} parts done: {job[0]}, {job[1]}")
        executor.shutdown()
    except BaseException:
        # the part in work is lost, finished ones are kept; it may be minutes from its end
        executor.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        raise


def _as_they_come(
    futures: Mapping[Future[Part], Job], messages: Any, progress: Progress
) -> Iterator[tuple[Job, Part]]:
    waiting = set(futures)
    while waiting:
        done, waiting = wait(waiting, timeout=0.5, return_when=FIRST_COMPLETED)
        with _until_empty():
            while True:
                progress(messages.get_nowait())
        for future in done:
            yield futures[future], future.result()


@contextmanager
def _until_empty() -> Iterator[None]:
    try:
        yield
    except queue.Empty:
        return


def _begin(messages: Any) -> None:
    """Set a worker process up: Ctrl+C is the parent's to handle."""
    global _messages, _parent
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _messages, _parent = messages, os.getppid()


def _compute_in_worker(job: Job, seed: int, effort: Effort) -> Part:
    last = [0.0]

    def wanted() -> None:
        # what was queued before the parent died must not be begun either
        if os.getppid() != _parent:
            raise RunStoppedError("the process that asked for this part is gone")

    def tell(text: str) -> None:
        now = time.monotonic()
        wanted()
        if now - last[0] >= PATIENCE:
            last[0] = now
            _messages.put(text)

    wanted()
    return compute(job, seed, effort, tell)
