"""The source of a patch: values, stated error and recordings of a saved diagnosis or fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labhil.analysis.dataset import Dataset, RecordingLike, load_dataset
from labhil.analysis.find_recording import find_recording
from labhil.documents import parse_json, read_document
from labhil.errors import ModelFileError, UsageError
from labhil.physics.terms import keyed
from labhil.recording.memory_maps import sha256_of_file
from labhil.recording.recording import Recording
from labhil.rig import RigFile
from labhil.unreadable import RESULT, reason_unreadable

ROUNDING = 1e-12
"""Relative error of a time that was written as begin and duration, so that the last sample stays."""

DIAGNOSIS, FIT = "labhil.diagnosis/1", "labhil.fit/1"


@dataclass(frozen=True, slots=True)
class PatchSource:
    """Values, stated error and recordings of a result.

    Attributes:
        path: The file of the result.
        values: Values by key.
        promised: The error on held-out data that the result states.
        horizon: Length of the simulated windows, s; None for inverse dynamics.
        search: Training recordings.
        test: Test recordings.
        channels: The stated error of each channel.
        span: Part of the training recording that was used, s; None where there are several.
        max_samples: Samples of the recording of which most were used.
    """

    path: Path
    values: Mapping[str, float]
    promised: float
    horizon: float | None
    search: tuple[RecordingLike, ...]
    test: tuple[RecordingLike, ...]
    channels: tuple[float, ...] = ()
    span: tuple[float, float] | None = None
    max_samples: int | None = None

    def load_dataset(self, rig: RigFile, holdout: float) -> Dataset:
        """Load the data of the result: the same parts of the same recordings."""
        return load_dataset(
            self.search, rig, self.test or None, holdout, span=self.span, max_samples=self.max_samples
        )


def read_patch_source(path: Path, recordings: Sequence[Recording] = ()) -> PatchSource:
    """Read the JSON of a diagnosis or a fit.

    Args:
        path: The file.
        recordings: Recordings that were read already; the file's others are read where it says.

    Returns:
        What is to be patched, and the recordings to check it on.

    Raises:
        ModelFileError: It is neither, or a file cannot hold its answer.
        UsageError: A recording is missing, or has changed.
    """
    try:
        data = parse_json(read_document(path))
    except (OSError, ValueError) as error:
        reason = reason_unreadable(path, error, RESULT)
        raise ModelFileError(f"{path}: cannot be read as JSON: {reason}") from error
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema not in (DIAGNOSIS, FIT):
        raise ModelFileError(f"{path}: schema: expected {DIAGNOSIS} or {FIT}, found {schema!r}")
    if data.get("curve"):
        raise ModelFileError(
            f"{path}: curve: expected effects that have names, found a force as a curve; a file cannot hold "
            "that: diagnose again with what you know of it among the terms"
        )
    try:
        return _read_fields(data, path, {recording.sha256: recording for recording in recordings})
    except (KeyError, TypeError, ValueError) as error:
        raise ModelFileError(
            f"{path}: expected values and an error on held-out data, found none ({error!r})"
        ) from error


def _read_fields(data: Mapping[str, Any], path: Path, read: Mapping[str, Recording]) -> PatchSource:
    if data["schema"] == DIAGNOSIS:
        rows, scored = data["final"]["parameters"], data["improvement"]
        promised, name = scored["rmse_after"], "rmse_after"
    else:
        rows, scored = data["parameters"], data["test"]
        promised, name = scored["rmse"], "rmse"
    tests = [row for row in data["recordings"] if row["role"] == "test"]
    training = [row for row in data["recordings"] if row["role"] != "test"]
    return PatchSource(
        path,
        {keyed(row["name"], row.get("joint")): float(row["value"]) for row in rows},
        float(promised),
        None if scored["horizon"] is None else float(scored["horizon"]),
        _recordings(path, training, read),
        _recordings(path, tests, read),
        tuple(float(row[name]) for row in scored["per_channel"]),
        _span_of(training),
        max(int(row["samples"]) for row in data["recordings"]),
    )


def _span_of(training: Sequence[Mapping[str, Any]]) -> tuple[float, float] | None:
    """The used part of the only training recording, s."""
    if len(training) != 1:
        return None
    start, duration = float(training[0]["start"]), float(training[0]["duration"])
    return start, start + duration * (1.0 + ROUNDING)


def _recordings(
    path: Path, rows: Sequence[Mapping[str, Any]], read: Mapping[str, Recording]
) -> tuple[RecordingLike, ...]:
    """Recordings that were read already, else checked paths, as stated or beside the result."""
    found: list[RecordingLike] = []
    for row in rows:
        if row["sha256"] in read:
            found.append(read[row["sha256"]])
            continue
        stated = Path(row["path"])
        file = find_recording(path, stated, row["sha256"])
        if file is None:
            raise UsageError(
                f"{path}: names the recording {stated}, which is not there; the repaired file is run on it: "
                "put it beside the result"
            )
        if sha256_of_file(file) != row["sha256"]:
            raise UsageError(f"{file}: expected the recording that {path} was made from, found another")
        found.append(file)
    return tuple(found)
