"""The progress of a run, its result, and the names of its files."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from labhil.errors import LabhilError
from labhil.experiment.control import RunState
from labhil.experiment.experiment import Experiment
from labhil.service.recorded import RecordingSummary, StreamSummary


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of a run: ``elapsed`` of ``duration``, s of the slowest device's clock without pauses."""

    state: RunState
    elapsed: float
    duration: float
    message: str


@dataclass(frozen=True, slots=True)
class RunResult:
    """The result of a run.

    Attributes:
        path: The recording; None where nothing was recorded.
        exit_status: Exit status of the command, 0 where the run did not fail.
        duration: Measured duration, s of the devices' clocks.
        streams: What was recorded of each stream, with measured rates, Hz of the devices' clocks.
        reason: Why the run ended, in words.
        error: Why it failed; None where it did not.
        warnings: Faults of the clocks that stamped the recording, and of its completeness.
    """

    path: Path | None
    exit_status: int
    duration: float
    streams: tuple[StreamSummary, ...]
    reason: str
    error: LabhilError | None = None
    warnings: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the result as JSON data of the schema ``labhil.run/1``."""
        streams = [
            {
                "device": stream.device,
                "stream": stream.stream,
                "samples": stream.samples,
                "gaps": stream.gaps,
                "rate": stream.rate,
            }
            for stream in self.streams
        ]
        return {
            "schema": "labhil.run/1",
            "path": None if self.path is None else str(self.path),
            "exit_status": self.exit_status,
            "duration": self.duration,
            "streams": streams,
            "reason": self.reason,
            "warnings": list(self.warnings),
        }


def recording_path(experiment: Experiment, out_dir: Path) -> Path:
    """Return the path of a new recording; where that name is taken, a number is added."""
    return free_path(out_dir, experiment.record.path, experiment.experiment.name)


def free_path(folder: Path, pattern: str, name: str) -> Path:
    """Return a path that is not taken.

    Args:
        folder: Where it is.
        pattern: Name of the file; ``{name}`` and ``{start}`` (local time) are filled in.
        name: What is filled in for ``{name}``.
    """
    plain, start = re.sub(r"[^\w.+-]+", "_", name), time.strftime("%Y%m%dT%H%M%S")
    preferred = folder / pattern.format(name=plain, start=start)
    path, number = preferred, 1
    while path.exists() or path.with_name(path.name + ".part").exists():
        number += 1
        path = preferred.with_name(f"{preferred.stem}-{number}{preferred.suffix}")
    return path


def answer_path(recording: Path, device: str, are_several: bool) -> Path:
    """Return where a twin writes its terms and parameters: beside the recording."""
    return recording.with_suffix(f".{device}.twin.json" if are_several else ".twin.json")


def remove_without_recording(answer: Path, recording: Path) -> None:
    """Remove what a twin wrote of itself where its run has left no recording: it would belong to nothing."""
    if not any(path.exists() for path in (recording, recording.with_name(recording.name + ".part"))):
        # what cannot be removed must not hide how the run ended
        with suppress(OSError):
            answer.unlink(missing_ok=True)


def result_of(
    summary: RecordingSummary,
    speeds: Mapping[str, float],
    status: int,
    reason: str,
    error: LabhilError | None,
) -> RunResult:
    """Return the result of a run, and remove a recording without samples.

    Args:
        summary: What the recorder wrote.
        speeds: Seconds of the device's clock per second of the host, by device.
        status: Exit status.
        reason: Why the run ended.
        error: Why it failed, if it did.
    """
    if not any(stream.samples for stream in summary.streams):
        # an empty file would look like a recording
        summary.path.unlink()
        return RunResult(None, status, 0.0, (), reason, error)
    streams = tuple(
        replace(stream, rate=stream.rate / speeds.get(stream.device, 1.0)) for stream in summary.streams
    )
    duration = _duration(streams)
    return RunResult(summary.path, status, duration, streams, reason, error, summary.warnings)


def _duration(streams: tuple[StreamSummary, ...]) -> float:
    spans = [(s.samples + s.gaps - 1) / s.rate for s in streams if s.rate > 0]
    return max(spans, default=0.0)
