"""Campaigns: all runs of an experiment file with ``repeat`` or ``[sweep]``, and the file of their states.

The campaign file is written before and after each run, so that a campaign that was interrupted continues
where it was. A run is done when its recording is complete and its exit status is 0.
"""

from __future__ import annotations

import fcntl
import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from labhil.atomic_file import atomic_file, make_folder
from labhil.documents import parse_json, read_document
from labhil.errors import EmergencyStopError, LabhilError, RecordingError, RunStoppedError, UsageError
from labhil.experiment.experiment import Experiment
from labhil.experiment.plan import make_plan
from labhil.experiment.points import Point, fingerprint, points_of
from labhil.experiment.result import Progress, RunResult, free_path
from labhil.experiment.run import run_experiment
from labhil.recording.contents import status_from_metadata
from labhil.recording.metadata import read_metadata
from labhil.unreadable import CAMPAIGN, reason_unreadable
from labhil.validation_errors import format_validation_error

Status = Literal["planned", "running", "done", "failed"]


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore")


class RunEntry(_Part):
    """One run in a campaign file; ``path`` and the recordings of ``earlier`` attempts are relative to it."""

    number: int
    repetition: int
    settings: dict[str, Any]
    status: Status = "planned"
    path: str | None = None
    reason: str = ""
    earlier: list[str] = []


class CampaignFile(_Part):
    """The contents of a campaign file; ``sha256`` is the fingerprint of what defines its runs."""

    format: Annotated[Literal["labhil.campaign/1"], Field(alias="schema")] = "labhil.campaign/1"
    experiment: str
    sha256: str
    runs: list[RunEntry]

    def to_json(self) -> dict[str, Any]:
        """Return the contents as JSON data."""
        return self.model_dump(mode="json", by_alias=True)


@dataclass(frozen=True, slots=True)
class CampaignResult:
    """The result of a campaign.

    Attributes:
        path: The campaign file.
        file: Its contents.
        skipped: How many runs were done before.
        error: Why it ended early or a run failed; None where neither happened.
        warnings: Warnings about its recordings.
    """

    path: Path
    file: CampaignFile
    skipped: int
    error: LabhilError | None = None
    warnings: tuple[str, ...] = field(default=())

    @property
    def done(self) -> int:
        """Number of runs that are done."""
        return sum(run.status == "done" for run in self.file.runs)

    @property
    def recordings(self) -> tuple[Path, ...]:
        """The recordings of the runs that are done, in order."""
        return tuple(
            self.path.parent / run.path for run in self.file.runs if run.status == "done" and run.path
        )

    @property
    def exit_status(self) -> int:
        """0 where all runs are done, else that of the first that failed."""
        return 0 if self.error is None else self.error.exit_status

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the campaign file with its path and exit status."""
        return {**self.file.to_json(), "path": str(self.path), "exit_status": self.exit_status}


def campaign_path(experiment: Experiment, out_dir: Path) -> Path:
    """Return the path of the campaign file of an experiment."""
    safe_name = re.sub(r"[^\w.+-]+", "_", experiment.experiment.name)
    return out_dir / f"{safe_name}.campaign.json"


def run_campaign(
    experiment: Experiment,
    out_dir: Path,
    progress: Callable[[Progress], None] = lambda _progress: None,
    announce: Callable[[str], None] = lambda _text: None,
    *,
    anew: bool = False,
) -> CampaignResult:
    """Make every run of ``experiment`` that is not done yet.

    Args:
        experiment: The experiment, with ``repeat`` or ``[sweep]``.
        out_dir: Where the campaign file and the recordings go.
        progress: Is called with the progress of each run.
        announce: Is called with a line when a run begins, and about the runs that were done before.
        anew: Begin a new campaign where there is one already; its recordings stay.

    Raises:
        ExperimentFileError: A run cannot be made; nothing has moved.
        UsageError: The campaign file is of another experiment, or another process works on it.
    """
    points = points_of(experiment)
    for point in points:
        make_plan(point.experiment)
    make_folder(out_dir, "the recordings")
    path = campaign_path(experiment, out_dir)
    with _lock(path):
        file = _load_or_begin(experiment, points, path, anew=anew)
        return _Campaign(path, file, points, experiment, progress, announce).run()


@contextmanager
def _lock(path: Path) -> Iterator[None]:
    """Keep other processes from this campaign; the lock ends with the process that holds it."""
    with path.with_name(f".{path.name}.lock").open("w", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise UsageError(f"{path}: another process is running this campaign") from error
        yield


def _load_or_begin(
    experiment: Experiment, points: tuple[Point, ...], path: Path, *, anew: bool
) -> CampaignFile:
    digest = fingerprint(experiment, points)
    if path.exists() and not anew:
        file = load_campaign(path)
        if file.sha256 != digest or len(file.runs) != len(points):
            raise UsageError(
                f"{path}: expected the campaign of {experiment.path} as it is now, found that of another "
                "version (steps, devices, sweep or rig file differ); `--anew` begins a new one and keeps the "
                "recordings, `--out` puts it elsewhere"
            )
        return file
    runs = [
        RunEntry(number=point.number, repetition=point.repetition, settings=dict(point.settings))
        for point in points
    ]
    return CampaignFile(experiment=experiment.experiment.name, sha256=digest, runs=runs)


def load_campaign(path: Path) -> CampaignFile:
    """Read a campaign file; UsageError names what is wrong with it."""
    try:
        data = parse_json(read_document(path))
    except (OSError, ValueError) as error:
        reason = reason_unreadable(path, error, CAMPAIGN)
        raise UsageError(f"{path}: cannot be read as a campaign file (JSON): {reason}") from error
    try:
        return CampaignFile.model_validate(data)
    except ValidationError as error:
        raise UsageError(format_validation_error(error, path, CampaignFile)) from error


class _Campaign:
    def __init__(
        self,
        path: Path,
        file: CampaignFile,
        points: tuple[Point, ...],
        experiment: Experiment,
        progress: Callable[[Progress], None],
        announce: Callable[[str], None],
    ) -> None:
        self._path, self._file, self._points = path, file, points
        self._experiment, self._progress, self._announce = experiment, progress, announce
        sweep = experiment.sweep
        self._continues = sweep is not None and sweep.on_failure == "continue"

    def run(self) -> CampaignResult:
        for entry in self._file.runs:
            self._review_earlier(entry)
        self._save()
        skipped = sum(entry.status == "done" for entry in self._file.runs)
        if skipped:
            self._announce(f"{skipped} of {len(self._points)} runs are done already: {self._path}")
        failure: LabhilError | None = None
        warnings: list[str] = []
        for point, entry in zip(self._points, self._file.runs, strict=True):
            if entry.status == "done":
                continue
            self._announce(point.describe())
            result = self._run(point, entry)
            warnings += result.warnings
            if result.error is None:
                continue
            failure = failure or result.error
            if not self._continues or isinstance(result.error, (RunStoppedError, EmergencyStopError)):
                break
        return CampaignResult(self._path, self._file, skipped, failure, tuple(warnings))

    def _review_earlier(self, entry: RunEntry) -> None:
        """Decide from its recording whether a run of an earlier process is done."""
        if entry.status not in ("running", "done"):
            return
        path = self._path.parent / (entry.path or "")
        if entry.path is not None and _is_done(path):
            entry.status, entry.reason = "done", entry.reason or "all steps are done"
            return
        reason = "its recording is gone" if entry.status == "done" else "interrupted"
        self._set_aside(entry)
        entry.status, entry.reason = "planned", reason

    def _set_aside(self, entry: RunEntry) -> None:
        if entry.path is not None:
            names = (entry.path, f"{entry.path}.part")
            entry.earlier += [name for name in names if (self._path.parent / name).exists()]
            entry.path = None

    def _run(self, point: Point, entry: RunEntry) -> RunResult:
        self._set_aside(entry)
        pattern = self._experiment.record.path.removesuffix(".mcap") + f"-{point.number:03d}.mcap"
        path = free_path(self._path.parent, pattern, self._experiment.experiment.name)
        entry.status, entry.reason = "running", ""
        entry.path = str(path.relative_to(self._path.parent))
        self._save()
        campaign = {
            "name": self._file.experiment,
            "file": self._path.name,
            "run": str(point.number),
            "of": str(point.of),
            "repetition": str(point.repetition),
            **point.public_settings(),
        }
        result = run_experiment(
            point.experiment, self._path.parent, self._progress, path=path, metadata={"campaign": campaign}
        )
        entry.status = "done" if result.error is None else "failed"
        entry.reason = result.reason
        self._save()
        return result

    def _save(self) -> None:
        text = json.dumps(self._file.to_json(), ensure_ascii=False, indent=1)
        with atomic_file(self._path, "the campaign file") as draft:
            draft.write_text(text + "\n", encoding="utf-8")


def _is_done(path: Path) -> bool:
    """Return whether a recording is complete with the ending "done"."""
    try:
        return status_from_metadata(read_metadata(path)) == "done"
    except RecordingError:
        return False
