"""The page of a file: a recording, or the JSON of a result."""

from __future__ import annotations

import hashlib
from pathlib import Path

from labhil.analysis.schema import (
    COMPARISON,
    ComparisonPart,
    DiagnosisPart,
    VerificationPart,
    any_result_of,
    json_of,
    validate,
)
from labhil.bounds import read_file
from labhil.errors import ModelFileError, RecordingError, UsageError
from labhil.recording.chunks import is_mcap
from labhil.recording.reader import read_recording
from labhil.report.html.comparison import comparison_page
from labhil.report.html.diagnosis import diagnosis_page
from labhil.report.html.fit import fit_page
from labhil.report.html.page import Page
from labhil.report.html.picture import Album
from labhil.report.html.recording import recording_page
from labhil.report.html.verification import verification_page
from labhil.unreadable import RECORDING, RESULT, reason_unreadable


def report_page(path: Path, run: int | None = None) -> Page:
    """Make the page of a recording or of the JSON of a result.

    Args:
        path: The file.
        run: Which run, from 1, where a recording holds several.

    Raises:
        RecordingError: The recording cannot be read, or has no streams.
        ModelFileError: The file is neither a recording nor a result.
        UsageError: ``run`` is given for a result.
    """
    data = _bytes_of(path)
    foot = f"Made from {path}, SHA-256 {hashlib.sha256(data).hexdigest()}."
    if is_mcap(data) or path.suffix == ".mcap":
        recording = read_recording(path, run)
        if recording.foreign and not recording.streams:
            raise RecordingError(
                f"{path}: expected streams to show, found {recording.describe_missing_streams()}"
            )
        return recording_page(recording, f"Made from {path}.", Album())
    if run is not None:
        raise UsageError(f"--run {run}: expected a recording, found {path}")
    plain = json_of(data, str(path))
    if isinstance(plain, dict) and plain.get("schema") == COMPARISON:
        return comparison_page(validate(ComparisonPart, plain, str(path)), foot)
    result = any_result_of(plain, str(path))
    if isinstance(result, VerificationPart):
        return verification_page(result, foot)
    if isinstance(result, DiagnosisPart):
        return diagnosis_page(result, foot, Album())
    return fit_page(result, foot, Album())


def _bytes_of(path: Path) -> bytes:
    try:
        return read_file(path)
    except OSError as error:
        kind = RECORDING if path.suffix == RECORDING.suffix else RESULT
        reason = reason_unreadable(path, error, kind)
        raise ModelFileError(
            f"{path}: expected a recording (MCAP) or the JSON of a result, cannot be read: {reason}"
        ) from error
