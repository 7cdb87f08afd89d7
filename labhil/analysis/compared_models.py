"""What is compared: results as models, and the recordings that all of them are tested on."""

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

MOST_MODELS = 8
"""A page with more of them over each other shows nothing."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A model that is compared, with a ``name`` of its own."""

    name: str
    saved: SavedModel
    part: FitPart | DiagnosisPart

    @property
    def made_by(self) -> str:
        """What made it."""
        return "fit" if isinstance(self.part, FitPart) else "diagnosis"

    @property
    def terms(self) -> tuple[str, ...]:
        """Its terms."""
        return self.part.terms if isinstance(self.part, FitPart) else self.part.final.terms

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Its values."""
        return self.part.parameters if isinstance(self.part, FitPart) else self.part.final.parameters

    @property
    def rig(self) -> str:
        """The rig kind."""
        return next((source.rig for source in self.part.recordings if source.rig), "")

    @property
    def stretches(self) -> list[Stretch]:
        """What it was judged on: its test recordings, else the parts held out of its training recordings."""
        tests = [Stretch.whole(source) for source in self.part.recordings if source.role == "test"]
        if tests:
            return tests
        learnt = [source for source in self.part.recordings if source.role != "test"]
        spans = self.part.held_out
        if len(spans) == len(learnt):
            return [Stretch(source, *span) for source, span in zip(learnt, spans, strict=True)]
        if isinstance(self.part, FitPart) and self.part.test is None:
            return [Stretch.whole(source) for source in learnt]
        return [Stretch.last(source) for source in learnt]

    def was_fitted_to(self, sha256: str, span: tuple[float, float] | None) -> bool:
        """Whether it has learnt from a recording, or from a ``span`` of it (s)."""
        learnt = [s for s in self.part.recordings if s.role != "test" and s.sha256 == sha256]
        if not learnt or not sha256:
            return False
        stretches = [stretch for stretch in self.stretches if stretch.source.sha256 == sha256]
        held_out = bool(stretches) and not (isinstance(self.part, FitPart) and self.part.test is None)
        if not held_out or any(stretch.source.role == "test" for stretch in stretches):
            return True
        return span is None or not any(stretch.holds(span) for stretch in stretches)


@dataclass(frozen=True, slots=True)
class Stretch:
    """A recording that a result names, from ``begin`` to ``end`` s; ``supposed`` where no file states it."""

    source: Source
    begin: float
    end: float
    supposed: bool = False

    @classmethod
    def whole(cls, source: Source) -> Stretch:
        """All of it that was used."""
        begin = source.start or 0.0
        return cls(source, begin, begin + (source.duration or 0.0))

    @classmethod
    def last(cls, source: Source) -> Stretch:
        """The share that is held out by default."""
        begin, duration = source.start or 0.0, source.duration or 0.0
        return cls(source, begin + (1.0 - HOLDOUT) * duration, begin + duration, supposed=True)

    def holds(self, span: tuple[float, float], slack: float = 1e-6) -> bool:
        """Whether all of a span (s) lies in it."""
        return self.begin - slack <= span[0] and span[1] <= self.end + slack


def candidates_of(given: Sequence[Path | SavedModel]) -> list[Candidate]:
    """The models of results: a fit's, a diagnosis' final one, the one that a verification tested.

    Raises ModelFileError for a file without a model, UsageError unless these are two to eight of one rig.
    """
    models = [_result_of(each) for each in given]
    if len(models) < 2:
        raise UsageError(
            f"compare: expected two results or more (JSON of `labhil fit` or `labhil diagnose`), found "
            f"{len(models)}"
        )
    if len(models) > MOST_MODELS:
        raise UsageError(f"compare: expected {MOST_MODELS} results at most, found {len(models)}")
    names = _names([saved.name for saved, _ in models])
    candidates = [Candidate(name, *each) for name, each in zip(names, models, strict=True)]
    first = candidates[0]
    for candidate in candidates[1:]:
        if candidate.rig != first.rig:
            raise ModelFileError(
                f"{candidate.saved}: expected a model of {first.rig}, as {first.saved}, found one of "
                f"{candidate.rig}"
            )
    return candidates


def _result_of(given: Path | SavedModel) -> tuple[SavedModel, FitPart | DiagnosisPart]:
    if isinstance(given, SavedModel):
        data, name = given.data, given.name
    else:
        data, name = json_of(_content(given), str(given)), str(given)
    part = any_result_of(data, name)
    if not isinstance(part, VerificationPart):
        return SavedModel(name, data), part
    model = _model_of(part, name)
    data = json_of(_content(model), str(model))
    result = any_result_of(data, str(model))
    if isinstance(result, VerificationPart):
        raise ModelFileError(f"{name}: model: expected a fit or a diagnosis, found the verification {model}")
    return SavedModel(str(model), data), result


def _model_of(part: VerificationPart, name: str) -> Path:
    """The model that a verification names, from here or from beside its file."""
    for path in (Path(part.model), Path(name).parent / Path(part.model).name):
        if path.is_file():
            return path
    raise ModelFileError(f"{name}: model: expected the file {part.model} that it verified, found none")


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ModelFileError(
            f"{path}: expected the JSON of a result, cannot be read: {error.strerror}"
        ) from error


def _names(origins: Sequence[str]) -> list[str]:
    """The names of files without their folders where these differ, else with them; all different."""
    short = [Path(origin).name or origin for origin in origins]
    names = list(short) if len(set(short)) == len(set(origins)) else list(origins)
    for place, name in enumerate(names):
        before = names[:place].count(name)
        if before:
            names[place] = f"{name} ({before + 1})"
    return names
