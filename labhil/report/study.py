"""From recordings on disk to a result: load, split, fit or diagnose, and put it into words."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labhil.diagnose.answer import Diagnosis
from labhil.diagnose.diagnosis import diagnose
from labhil.errors import RecordingError, UnknownNameError, UsageError
from labhil.identify.fit import Fit, Options, fit
from labhil.identify.further_channels import with_help
from labhil.identify.windows import FEWEST_IN_WINDOW, FEWEST_SAMPLES, split
from labhil.physics.model import Model, Record, index_of, terms_named
from labhil.physics.rigs import model_for, record_of, rig_model
from labhil.recording.reader import Recording, read_recording
from labhil.report.results import Source, diagnosis_json, fit_json, terms_of, values_of
from labhil.rig import RigFile, load_rig

HOLDOUT = 0.3

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Material:
    """What a result is made from: the rig's model, the data to learn from and the data to be judged on.

    Where nothing is ``held_out`` these are the same.
    """

    rig: RigFile
    model: Model
    learn: Record
    judge: Record
    judge_is_test: bool
    recordings: tuple[tuple[Recording, Record, str], ...]
    held_out: bool = True

    def sources(self, learning: str) -> list[Source]:
        """The recordings as results name them; ``learning`` is the role of the first."""
        return [
            Source(
                path=str(recording.path),
                sha256=recording.sha256,
                rig=self.rig.kind.name,
                samples=len(record),
                duration=float(record.t[-1] - record.t[0]),
                role=role or learning,
                start=float(record.t[0]),
            )
            for recording, record, role in self.recordings
        ]

    def losses(self) -> list[str]:
        """What the recordings lack, a line each."""
        return [line for recording, _, _ in self.recordings for line in recording.losses()]


def load_material(
    path: Path,
    rig_path: Path | None = None,
    test_path: Path | None = None,
    holdout: float = HOLDOUT,
    *,
    span: tuple[float, float] | None = None,
    all_of_it: bool = False,
) -> Material:
    """Read a recording, or of it the ``span`` from … to (s), and what it is to be judged on.

    Without ``test_path`` the last ``holdout`` of the recording is held out, after a gap of one scored
    horizon; nothing is where ``holdout`` is 0 and ``all_of_it`` allows that. The rig file is the given one,
    or the one that the recording carries. Raises UsageError (RecordingError, RigFileError) with what is
    missing.
    """
    if not (0.05 <= holdout <= 0.9 or (all_of_it and holdout == 0.0)):
        nothing = ", or 0 to hold nothing out" if all_of_it else ""
        raise UsageError(f"--holdout: expected a share from 0.05 to 0.9{nothing}, found {holdout:g}")
    recording = read_recording(path)
    rig = rig_of(recording, rig_path)
    record = _within(record_of(recording, rig.kind), span, recording)
    model = model_for(rig, record)
    if test_path is None and holdout == 0.0:
        learn = model.prepare(record)
        return Material(rig, model, learn, learn, False, ((recording, record, ""),), held_out=False)
    if test_path is None:
        learn, judge = (model.prepare(part) for part in split(record, holdout, model.horizon))
        _long_enough(learn, recording)
        return Material(rig, model, learn, judge, False, ((recording, record, ""),))
    test_recording = read_recording(test_path)
    test = record_of(test_recording, rig.kind)
    if test.input_names != record.input_names:
        raise RecordingError(
            f"{test_path}: expected the input {record.input_names[0]} as in {path}, "
            f"found {test.input_names[0]}"
        )
    learn, judge = model.prepare(record), model.prepare(test)
    return Material(rig, model, learn, judge, True, ((recording, record, ""), (test_recording, test, "test")))


def rig_of(recording: Recording, rig_path: Path | None) -> RigFile:
    """The rig file at a path, or the one that the recording carries; RecordingError when it carries none."""
    if rig_path is not None:
        return load_rig(rig_path)
    if recording.rig is None:
        damage = f" ({recording.damage})" if recording.damage else ""
        raise RecordingError(f"{recording.path}: carries no rig file{damage}; give one with --rig RIG.toml")
    return recording.rig


def _within(record: Record, span: tuple[float, float] | None, recording: Recording) -> Record:
    """The samples of a record within ``span`` (s, both ends counted); UsageError where hardly any are."""
    if span is None:
        return record
    first, last = np.searchsorted(record.t, span[0]), np.searchsorted(record.t, span[1], side="right")
    if last - first < FEWEST_SAMPLES:
        raise UsageError(
            f"--span {span[0]:g} {span[1]:g}: expected at least {FEWEST_SAMPLES} samples of "
            f"{recording.path}, which reaches from {record.t[0]:g} to {record.t[-1]:g} s, "
            f"found {max(last - first, 0)}"
        )
    return record.part(int(first), int(last))


def _long_enough(learn: Record, recording: Recording) -> None:
    if len(learn) < 40:
        raise RecordingError(
            f"{recording.path}: too short to hold data out: {len(learn)} samples are left to learn from, "
            "at least 40 are needed; give a separate recording with --test"
        )


@dataclass(frozen=True, slots=True)
class FitResult:
    """A fit with its JSON."""

    fit: Fit
    material: Material
    json: Any


@dataclass(frozen=True, slots=True)
class DiagnosisResult:
    """A diagnosis with its JSON."""

    diagnosis: Diagnosis
    material: Material
    json: Any


def fit_study(
    material: Material,
    *,
    terms: Sequence[str] | None = None,
    start: Path | None = None,
    options: Options | None = None,
) -> FitResult:
    """Fit a model; ``start`` is a fit or diagnosis file to begin at."""
    shortest = FEWEST_IN_WINDOW * material.learn.period
    how = options or Options()
    if how.window is not None and not 0.99 * shortest <= how.window < float("inf"):
        raise UsageError(
            f"--window: expected at least {shortest:.3g} s ({FEWEST_IN_WINDOW} samples), found {how.window:g}"
        )
    model = material.model
    chosen = terms or (terms_of(start) if start is not None else rig_model(model.kind).general)
    terms_named(model, chosen)
    began = time.perf_counter()
    result = fit(
        model,
        material.learn,
        chosen,
        test=material.judge if material.held_out else None,
        start=values_of(start) if start is not None else None,
        options=how,
    )
    if result.criterion is model.metric:
        judged = with_help(result.identifiability, material.rig, result.fitted)
        result = replace(result, identifiability=judged)
    seconds = time.perf_counter() - began
    data = fit_json(result, material.sources("train"), model.kind, how.estimator, how.seed, seconds)
    return FitResult(result, material, data)


def diagnose_study(
    material: Material,
    *,
    baseline: Sequence[str] | None = None,
    reference: Path | None = None,
    progress: Progress = lambda text: None,
) -> DiagnosisResult:
    """Diagnose; ``reference`` is a fit file that stands for the user's simulation, like ``[nominal]``."""
    model = material.model
    values = _reference_values(material, reference)
    chosen = baseline or (terms_of(reference) if reference is not None else rig_model(model.kind).baseline)
    terms_named(model, chosen)
    diagnosis = diagnose(
        model,
        material.learn,
        material.judge,
        heldout_is_test=material.judge_is_test,
        baseline=chosen,
        reference=values,
        measured=material.recordings[0][1],
        progress=progress,
    )
    return DiagnosisResult(diagnosis, material, diagnosis_json(diagnosis, material.sources("search")))


def _reference_values(material: Material, reference: Path | None) -> Mapping[str, float] | None:
    if reference is not None:
        return values_of(reference)
    known = index_of(material.model.parameters)
    for name in material.rig.nominal:
        if name not in known:
            raise UnknownNameError(f"{material.rig.path}: [nominal] parameter", name, known)
    return material.rig.nominal or None
