"""A fit, a diagnosis, a verification, a comparison or an export in a separate process.

``python -m labhil.campaign.studies.study`` reads its task in one line, reports its progress (``{"progress":
…}``) and at the end the outcome (``{"done": …}`` or ``{"failed": …}``). Files get their names when they are
complete, so it may be ended at any time.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labhil.atomic_file import atomic_file, write_json_file
from labhil.campaign.studies.process import read_further_lines, read_request, write_line
from labhil.errors import LabhilError

CANCELLED = 130


@dataclass(frozen=True, slots=True)
class Task:
    """A study to be done.

    Attributes:
        kind: "fit", "diagnose", "verify", "compare" or "export".
        recordings: the recordings; of a comparison, the results whose models are compared.
        tests: test recordings.
        model: a result: the start of a fit, the reference of a diagnosis, the model of a verification.
        terms: terms of a fit's model or a diagnosis' baseline; None for those of the rig kind.
        estimator: estimator of a fit.
        seconds: time after which it ends with the best result so far, s.
        device: the device, where a recording has several.
    """

    kind: str
    recordings: tuple[Path, ...]
    tests: tuple[Path, ...] = ()
    model: Path | None = None
    terms: tuple[str, ...] | None = None
    estimator: str | None = None
    seconds: float | None = None
    device: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the task as plain data."""
        return {
            "kind": self.kind,
            "recordings": [str(path.absolute()) for path in self.recordings],
            "tests": [str(path.absolute()) for path in self.tests],
            "model": None if self.model is None else str(self.model.absolute()),
            "terms": None if self.terms is None else list(self.terms),
            "estimator": self.estimator,
            "seconds": self.seconds,
            "device": self.device,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Task:
        """Read what :meth:`to_json` wrote."""
        model, terms = data["model"], data["terms"]
        return cls(
            str(data["kind"]),
            tuple(map(Path, data["recordings"])),
            tuple(map(Path, data["tests"])),
            None if model is None else Path(model),
            None if terms is None else tuple(map(str, terms)),
            data["estimator"],
            data["seconds"],
            data["device"],
        )

    @property
    def title(self) -> str:
        """Its title for people."""
        names = ", ".join(path.name.removesuffix(".mcap").removesuffix(".json") for path in self.recordings)
        return f"{self.kind} {names}" + ("" if self.device is None else f" {self.device}")


def report_progress(text: str) -> None:
    """Report a stage of the study."""
    write_line({"progress": text})


def run_task(task: Task) -> dict[str, Any]:
    """Do a study, and return the last line for the parent process.

    Raises:
        LabhilError: the study failed.
    """
    first = task.recordings[0]
    stem = stem_of(task)
    if task.kind == "export":
        return {"done": [str(_export(path)) for path in task.recordings]}
    if task.kind == "verify":
        return _verify(task)
    if task.kind == "compare":
        return _compare(task)
    report_progress(f"reading {first.name}")
    if task.kind == "fit":
        from labhil.api.fit import fit
        from labhil.campaign.studies.curves import curves_of_fit

        estimator = task.estimator or "hybrid"
        fitted = fit(task.recordings, terms=task.terms, estimator=estimator, **_arguments(task, "start"))
        path = _write(first.parent, stem, "fit", fitted.to_dict(), curves_of_fit(fitted.study))
        return {"done": str(path), "verdict": fitted.statement}
    from labhil.api.diagnosis import diagnose
    from labhil.campaign.studies.curves import curves_of_diagnosis

    diagnosis = diagnose(task.recordings, baseline=task.terms, **_arguments(task, "reference"))
    path = _write(first.parent, stem, "diagnosis", diagnosis.to_dict(), curves_of_diagnosis(diagnosis.study))
    return {"done": str(path)}


def stem_of(task: Task) -> str:
    """Return the stem of the names of a study's results."""
    stem = task.recordings[0].name.removesuffix(".part").removesuffix(".mcap")
    return stem if task.device is None else f"{stem}.{task.device}"


def _arguments(task: Task, model: str) -> dict[str, Any]:
    """Arguments of a fit or a diagnosis; ``model`` is the name of the argument for the model."""
    return {
        "test": task.tests or None,
        model: task.model,
        "seconds": task.seconds,
        "device": task.device,
        "progress": report_progress,
        "warn": _warn,
    }


def _warn(lines: Iterable[str]) -> None:
    for line in lines:
        report_progress(line)


def _write(folder: Path, stem: str, kind: str, data: Any, curves: Mapping[str, Any]) -> Path:
    """Write a result, and beside it the curves of its figures."""
    path = free_name(folder, stem, f"{kind}.json")
    with atomic_file(path.with_suffix(".npz"), "the curves") as draft:
        np.savez_compressed(draft, **curves)
    write_json_file(data, path)
    return path


def free_name(folder: Path, stem: str, suffix: str) -> Path:
    """Return a free path in ``folder``: ``stem.suffix``, ``stem-2.suffix``, …"""
    path, number = folder / f"{stem}.{suffix}", 1
    while path.exists():
        number += 1
        path = folder / f"{stem}-{number}.{suffix}"
    return path


def _export(path: Path) -> Path:
    from labhil.recording.export import export
    from labhil.recording.reader import read_recording

    stem = path.name.removesuffix(".part").removesuffix(".mcap")
    report_progress(f"reading {path.name}")
    return export(read_recording(path), free_name(path.parent, stem, "csv"))


def _verify(task: Task) -> dict[str, Any]:
    from labhil.api.verification import verify

    assert task.model is not None
    losses: list[str] = []
    first = task.recordings[0]
    result = verify(first, task.model, device=task.device, progress=report_progress, warn=losses.extend)
    path = free_name(first.parent, stem_of(task), "verification.json")
    write_json_file(result.to_dict(), path)
    text = "\n".join([*losses, result.text(width=100)])
    return {"done": text, "consistent": not result.contradicted, "path": str(path)}


def _compare(task: Task) -> dict[str, Any]:
    from labhil.api.comparison import compare

    first = task.recordings[0]
    comparison = compare(*task.recordings, recording=task.tests or None, progress=report_progress, warn=_warn)
    stem = first.name.removesuffix(".json").removesuffix(".fit").removesuffix(".diagnosis")
    path = free_name(first.parent, stem, "comparison.json")
    write_json_file(comparison.to_dict(), path)
    return {"done": str(path), "verdict": comparison.statement}


def main() -> int:
    """Run the process; returns its exit status."""
    request = read_request()
    # files get their names only when they are complete, so there is nothing to tidy up
    read_further_lines(_end_early, lambda: os._exit(CANCELLED))
    try:
        write_line(run_task(Task.from_json(request)))
    except LabhilError as error:
        write_line({"failed": str(error)})
        return error.exit_status
    except KeyboardInterrupt:
        write_line({"failed": "ended before there was a result"})
        return CANCELLED
    return 0


def _end_early(line: Mapping[str, Any]) -> None:
    """End with the best result so far, as Ctrl+C does at the command line."""
    if line.get("end"):
        os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
