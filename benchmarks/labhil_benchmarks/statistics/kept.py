"""Long work in many pieces: each is done once, on all cores, and kept in a file as soon as it is there."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from labhil.analysis.results import finite
from labhil.cores import cores

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Result = TypeVar("Result", bound="DataclassInstance")
Job = tuple[Any, ...]
"""The arguments of one piece of work, its name first."""

Progress = Callable[[str], None]


def each_once(
    wanted: Sequence[Job],
    work: Callable[..., Result],
    path: Path,
    parse: Callable[[dict[str, Any]], Result],
    job_of: Callable[[Result], Job],
    progress: Progress,
) -> list[Result]:
    """What ``work`` makes of every job, in their order; results (data classes) are lines of ``path``.

    Those that stand there already are read by ``parse`` and not made again; ``job_of`` gives which they
    are. ``work`` must be a function that another process can import.
    """
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    done = {job_of(result): result for result in (parse(json.loads(line)) for line in lines if line)}
    missing = [job for job in wanted if job not in done]
    if missing:
        with path.open("a", encoding="utf-8") as file, ProcessPoolExecutor(cores()) as executor:
            futures = [executor.submit(work, *job) for job in missing]
            try:
                for count, future in enumerate(as_completed(futures), 1):
                    result = future.result()
                    file.write(json.dumps(finite(asdict(result)), ensure_ascii=False) + "\n")
                    file.flush()
                    done[job_of(result)] = result
                    progress(f"{missing[0][0]}: {count} of {len(missing)}")
            except KeyboardInterrupt:
                executor.shutdown(cancel_futures=True)
                raise
    return [done[job] for job in wanted]


def numbers(data: dict[str, Any], absent: float = float("nan")) -> dict[str, Any]:
    """JSON has no infinities: null is what was not finite."""
    return {key: absent if value is None else value for key, value in data.items()}
