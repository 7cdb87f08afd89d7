"""The models of a comparison, read from results, and the recordings that they were tested on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from labhil.analysis.dataset import HOLDOUT
from labhil.analysis.saved_model import SavedModel
from labhil.analysis.schema import (
    DiagnosisPart,
    FitPart,
    Parameter,
    Source,
    VerificationPart,
    any_result_of,
    json_of,
)
from labhil.errors import ModelFileError, UsageError
from labhil.unreadable import RESULT, reason_unreadable


@dataclass(frozen=True, slots=True)
class Candidate:
    """A model of a comparison, with a unique ``name``."""

    name: str
    saved: SavedModel
    part: FitPart | DiagnosisPart

    @property
    def made_by(self) -> str:
        """The kind of study that made it."""
        return "fit" if isinstance(self.part, FitPart) else "diagnosis"

    @property
    def terms(self) -> tuple[str, ...]:
        """Its terms."""
        return self.part.terms if isinstance(self.part, FitPart) else self.part.final.terms

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Its parameters."""
        return self.part.parameters if isinstance(self.part, FitPart) else self.part.final.parameters

    @property
    def rig(self) -> str:
        """The rig kind."""
        return next((source.rig for source in self.part.recordings if source.rig), "")

    @property
    def validation_spans(self) -> list[RecordingSpan]:
        """Its validation data: test recordings, else the parts held out of its training recordings."""
        tests = [RecordingSpan.entire(source) for source in self.part.recordings if source.role == "test"]
        if tests:
            return tests
        training = [source for source in self.part.recordings if source.role != "test"]
        spans = self.part.held_out
        if len(spans) == len(training):
            return [RecordingSpan(source, *span) for source, span in zip(training, spans, strict=True)]
        if isinstance(self.part, FitPart) and self.part.test is None:
            return [RecordingSpan.entire(source) for source in training]
        return [RecordingSpan.default_holdout(source) for source in training]

    def was_fitted_to(self, sha256: str, span: tuple[float, float] | None) -> bool:
        """Return whether it was fitted to a recording, or to a ``span`` of it (s)."""
        training = [s for s in self.part.recordings if s.role != "test" and s.sha256 == sha256]
        if not training or not sha256:
            return False
        validation_spans = [
            recording_span
            for recording_span in self.validation_spans
            if recording_span.source.sha256 == sha256
        ]
        held_out = bool(validation_spans) and not (isinstance(self.part, FitPart) and self.part.test is None)
        if not held_out or any(recording_span.source.role == "test" for recording_span in validation_spans):
            return True
        return span is None or not any(recording_span.contains(span) for recording_span in validation_spans)


@dataclass(frozen=True, slots=True)
class RecordingSpan:
    """A recording of a result, from ``begin`` to ``end`` s; ``assumed`` where no file states them."""

    source: Source
    begin: float
    end: float
    assumed: bool = False

    @classmethod
    def entire(cls, source: Source) -> RecordingSpan:
        """Return all of a recording that was used."""
        begin = source.start or 0.0
        return cls(source, begin, begin + (source.duration or 0.0))

    @classmethod
    def default_holdout(cls, source: Source) -> RecordingSpan:
        """Return the part of a recording that is held out by default."""
        begin, duration = source.start or 0.0, source.duration or 0.0
        return cls(source, begin + (1.0 - HOLDOUT) * duration, begin + duration, assumed=True)

    def contains(self, span: tuple[float, float], slack: float = 1e-6) -> bool:
        """Return whether it contains a span (s)."""
        return self.begin - slack <= span[0] and span[1] <= self.end + slack


def read_candidates(references: Sequence[Path | SavedModel], max_models: int = 8) -> list[Candidate]:
    """Read the models of results: a fit's, a diagnosis' final one, the one that a verification tested.

    Args:
        references: two results or more.
        max_models: largest number of models; a figure with more of them is not readable.

    Raises:
        ModelFileError: a file has no model, or one of another kind of rig.
        UsageError: there are too few or too many models.
    """
    models = [_result_of(reference) for reference in references]
    if len(models) < 2:
        raise UsageError(
            f"compare: expected two results or more (JSON of `labhil fit` or `labhil diagnose`), found "
            f"{len(models)}"
        )
    if len(models) > max_models:
        raise UsageError(f"compare: expected {max_models} results at most, found {len(models)}")
    names = _unique_names([saved.name for saved, _ in models])
    candidates = [Candidate(name, *model) for name, model in zip(names, models, strict=True)]
    first = candidates[0]
    for candidate in candidates[1:]:
        if candidate.rig != first.rig:
            raise ModelFileError(
                f"{candidate.saved}: expected a model of {first.rig}, as {first.saved}, found one of "
                f"{candidate.rig}"
            )
    return candidates


def _result_of(reference: Path | SavedModel) -> tuple[SavedModel, FitPart | DiagnosisPart]:
    if isinstance(reference, SavedModel):
        data, name = reference.data, reference.name
    else:
        data, name = json_of(_read_bytes(reference), str(reference)), str(reference)
    part = any_result_of(data, name)
    if not isinstance(part, VerificationPart):
        return SavedModel(name, data), part
    model = _verified_model(part, name)
    data = json_of(_read_bytes(model), str(model))
    result = any_result_of(data, str(model))
    if isinstance(result, VerificationPart):
        raise ModelFileError(f"{name}: model: expected a fit or a diagnosis, found the verification {model}")
    return SavedModel(str(model), data), result


def _verified_model(part: VerificationPart, name: str) -> Path:
    """Path of the model that a verification names, as stated or beside its file."""
    for path in (Path(part.model), Path(name).parent / Path(part.model).name):
        if path.is_file():
            return path
    raise ModelFileError(f"{name}: model: expected the file {part.model} that it verified, found none")


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        reason = reason_unreadable(path, error, RESULT)
        raise ModelFileError(f"{path}: expected the JSON of a result, cannot be read: {reason}") from error


def _unique_names(origins: Sequence[str]) -> list[str]:
    """Unique names of files: without their folders where these are unique, else with them."""
    short = [Path(origin).name or origin for origin in origins]
    names = list(short) if len(set(short)) == len(set(origins)) else list(origins)
    for place, name in enumerate(names):
        before = names[:place].count(name)
        if before:
            names[place] = f"{name} ({before + 1})"
    return names
