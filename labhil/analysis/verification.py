"""Verification of a model by a recording: from files to the answer and its JSON.

The tests are in ``labhil.diagnose.verify``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from labhil.analysis.dataset import RecordingLike
from labhil.analysis.measured import measured_of, refuse_holes
from labhil.analysis.results import Source, finite, score_json
from labhil.analysis.rig_choice import rig_of
from labhil.analysis.rig_option import given_name
from labhil.analysis.saved_curves import with_saved_curves
from labhil.analysis.saved_model import Reference, accepted_of
from labhil.analysis.schema import VerificationPart, validate
from labhil.analysis.stretch import MAX_SAMPLES, check_max_samples, stretch_note
from labhil.diagnose.intake import replace_outliers
from labhil.diagnose.timing import detect_all_faults
from labhil.diagnose.verify import ALPHA, Verification, verify
from labhil.errors import ModelFileError, OptionError, RecordingError
from labhil.identify.plausibility import doubts_of
from labhil.identify.windows import FEWEST_SAMPLES
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.recording.reader import read_recording
from labhil.rig import RigFile


@dataclass(frozen=True, slots=True)
class VerificationResult:
    """A verification with its JSON; ``losses`` are lines on data that the recording lacks."""

    verification: Verification
    losses: tuple[str, ...]
    json: Any

    @property
    def part(self) -> VerificationPart:
        """The JSON as typed data."""
        return validate(VerificationPart, self.json, "the verification")


def verify_study(
    path_or_recording: RecordingLike,
    model_file: Reference,
    rig_file: Path | RigFile | None = None,
    *,
    alpha: float = ALPHA,
    span: tuple[float, float] | None = None,
    max_samples: int | None = MAX_SAMPLES,
    device: str | None = None,
    run: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> VerificationResult:
    """Test whether a recording contradicts the model of a result.

    Args:
        path_or_recording: The recording.
        model_file: The result.
        rig_file: The rig file; by default the one in the recording.
        alpha: Probability of a false alarm.
        span: Part of the recording that is used, from … to, s.
        max_samples: Number of samples that are used, those where the inputs change most; None for all.
        device: One of several devices in the recording.
        run: One of several runs in the file.
        progress: Called with a line of text at each stage.

    Raises:
        UsageError: Options or files do not fit together (also as RecordingError, RigFileError or
            ModelFileError).
    """
    if not 0.0 < alpha < 0.5:
        raise OptionError("alpha", f": expected a probability above 0 and below 0.5, found {alpha:g}")
    start_time = time.perf_counter()
    accepted = accepted_of(model_file)
    recording = (
        read_recording(path_or_recording, run) if isinstance(path_or_recording, Path) else path_or_recording
    ).of_device(device)
    path, rig = recording.path, rig_of(recording, rig_file)
    if accepted.rig not in (None, rig.kind.name):
        raise ModelFileError(
            f"{model_file}: rig: expected a model of {rig.kind.name}, as the recording {path}, "
            f"found one of {accepted.rig}"
        )
    check_max_samples(max_samples)
    records, record = measured_of([recording], rig, span, most=max_samples)
    refuse_holes(path, records[0])
    if len(record) < 2 * FEWEST_SAMPLES:
        raise RecordingError(
            f"{path}: too short to verify: {len(record)} samples, at least {2 * FEWEST_SAMPLES} are needed"
        )
    model = with_saved_curves(model_for(rig, record), model_file)
    verification = verify(
        model, model.prepare(replace_outliers(record)), accepted, alpha=alpha, progress=progress
    )
    source = Source(
        str(path),
        recording.sha256,
        model.kind,
        len(record),
        _duration(record),
        "test",
        float(record.t[0]),
        rig_file=given_name(rig_file),
    )
    seconds = time.perf_counter() - start_time
    data = verification_json(verification, source, model_file, seconds)
    if (used := stretch_note(recording, record)) is not None:
        data["notes"] = [used, *data["notes"]]
    # faults of the recording may be the reason for a contradiction
    data["faults"] = finite([asdict(fault) for fault in detect_all_faults(model, record)])
    doubts = doubts_of(record, rig, misfit=not verification.consistent, time_column=recording.time_column)
    data["doubts"] = [doubt.statement for doubt in doubts]
    return VerificationResult(verification, tuple(recording.warnings()), data)


def _duration(record: Record) -> float:
    return float(record.t[-1] - record.t[0])


def verification_json(
    verification: Verification, source: Source, model_file: Reference, seconds: float
) -> Any:
    """Return the answer as plain JSON data (`labhil.verification/1`), with null for NaN and infinities."""
    return finite(
        {
            "schema": "labhil.verification/1",
            "recordings": [asdict(source)],
            "model": str(model_file),
            "rig": source.rig,
            "terms": list(verification.refit.terms),
            "verdict": "consistent" if verification.consistent else "contradicted",
            "alpha": verification.alpha,
            "p_value": verification.p_value,
            "reasons": list(verification.reasons),
            "notes": list(verification.notes),
            "adequacy": verification.adequacy.verdict.value,
            "residual_over_noise": dict(verification.adequacy.residual_over_noise),
            "score": score_json(verification.score),
            "channels": [asdict(channel) for channel in verification.channels],
            "values_p": verification.values_p,
            "parameters": [asdict(change) for change in verification.changes],
            "worst_windows": [asdict(window) for window in verification.worst],
            "window": verification.window,
            "seconds": seconds,
        }
    )
