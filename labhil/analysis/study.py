"""From what was recorded to a result: fit or diagnose, and put it into words."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from labhil.analysis.dataset import Dataset
from labhil.analysis.kept_curve import curve_note, curves_json, under_kept_curve
from labhil.analysis.motion_check import require_motion
from labhil.analysis.results import diagnosis_json, fit_json
from labhil.analysis.saved_model import Reference, accepted_of, terms_of, values_of
from labhil.analysis.schema import DiagnosisPart, FitPart, validate
from labhil.cores import linear_algebra_in_one_thread
from labhil.diagnose.answer import Diagnosis
from labhil.diagnose.diagnosis import diagnose
from labhil.errors import OptionError, UnknownNameError, UsageError
from labhil.identify.fit import Fit, Options, fit
from labhil.identify.further_channels import suggest_measurements
from labhil.identify.windows import FEWEST_SAMPLES_IN_WINDOW
from labhil.physics.model import Model, index_of, terms_named
from labhil.physics.rigs import rig_model
from labhil.physics.several import for_every_recording
from labhil.simulators.arm import ArmFileModel
from labhil.simulators.model import SimulatorModel

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class FitResult:
    """A fit with its JSON."""

    fit: Fit
    material: Dataset
    json: Any

    @property
    def part(self) -> FitPart:
        """What the JSON says, as it is printed and drawn."""
        return validate(FitPart, self.json, "the fit")


@dataclass(frozen=True, slots=True)
class DiagnosisResult:
    """A diagnosis with its JSON."""

    diagnosis: Diagnosis
    material: Dataset
    json: Any

    @property
    def part(self) -> DiagnosisPart:
        """What the JSON says, as it is printed and drawn."""
        return validate(DiagnosisPart, self.json, "the diagnosis")


@linear_algebra_in_one_thread()
def fit_study(
    material: Dataset,
    *,
    terms: Sequence[str] | None = None,
    start: Reference | None = None,
    options: Options | None = None,
) -> FitResult:
    """Fit a model; ``start`` is a fit or diagnosis file to begin at, whose curve, if any, is kept.

    RecordingError where there is nothing to fit: values that are not finite, or a rig that does not move.
    """
    material.refuse_holes()
    require_motion(material.recordings[0][0].path, material.train, material.model.metric)
    shortest = FEWEST_SAMPLES_IN_WINDOW * material.train.period
    settings = options or Options()
    if settings.window is not None and not 0.99 * shortest <= settings.window < float("inf"):
        raise OptionError(
            "window",
            f": expected at least {shortest:.3g} s ({FEWEST_SAMPLES_IN_WINDOW} samples), "
            f"found {settings.window:g}",
        )
    model = under_kept_curve(material.model, start)
    chosen = terms
    if chosen is None:
        chosen = (
            terms_of(start) if start is not None else _observable_terms(model, rig_model(model.kind).general)
        )
    chosen = _with_per_recording_terms(model, chosen, stated=bool(terms))
    if not chosen and all(parameter.term is not None for parameter in model.parameters):
        raise OptionError("terms", f": expected one at least, since all else of this {model.kind} is known")
    began = time.perf_counter()
    initial = for_every_recording(model, values_of(start)) if start is not None else None
    test = material.test if material.held_out else None
    with material.naming():
        result = fit(model, material.train, chosen, test=test, start=initial, options=settings)
    if result.criterion is model.metric:
        judged = suggest_measurements(result.identifiability, material.rig, result.fitted)
        result = replace(result, identifiability=judged)
    seconds = time.perf_counter() - began
    sources = material.sources("train")
    data = fit_json(
        result, sources, model.kind, settings.estimator, settings.seed, seconds, curves_json(model)
    )
    data["faults"] = [asdict(fault) for fault in material.faults()]
    data["doubts"] = material.doubts(misfit=not result.adequacy.explained)
    data["notes"] = [*material.notes(), *curve_note(start)]
    data["untimed"] = material.untimed()
    data["held_out"] = _held_out_spans(material)
    return FitResult(result, material, data)


def _with_per_recording_terms(model: Model, terms: Sequence[str], *, stated: bool) -> tuple[str, ...]:
    """These terms, and those of which each recording has its own values.

    Raises UsageError when the terms were ``stated`` without them, UnknownNameError for a term that does not
    exist.
    """
    present = {term.key for term in terms_named(model, terms)}
    per_recording = dict.fromkeys(
        p.term for p in model.parameters if p.recording is not None and p.term is not None
    )
    further = [term for term in per_recording if term not in present]
    if further and stated:
        raise OptionError(
            "per-recording", f" {further[0]}: the fitted terms are {', '.join(terms)}; add it to --terms"
        )
    return (*terms, *further)


@linear_algebra_in_one_thread()
def diagnose_study(
    material: Dataset,
    *,
    baseline: Sequence[str] | None = None,
    reference: Reference | None = None,
    progress: Progress = lambda text: None,
) -> DiagnosisResult:
    """Diagnose; ``reference`` is a fit file that stands for the user's simulation, like ``[nominal]``.

    A curve in the file is part of that simulation.
    """
    model = under_kept_curve(material.model, reference)
    values = _reference_values(material, reference)
    chosen = baseline
    if chosen is None:
        chosen = (
            terms_of(reference)
            if reference is not None
            else _observable_terms(model, rig_model(model.kind).baseline)
        )
    terms_named(model, chosen)
    with material.naming():
        diagnosis = diagnose(
            model,
            material.train,
            material.test,
            heldout_is_test=material.test_is_separate,
            baseline=chosen,
            reference=values,
            accepted=None if reference is None else accepted_of(reference),
            measured=material.measured,
            progress=progress,
        )
    data = diagnosis_json(diagnosis, material.sources("search"))
    data["doubts"] = material.doubts(misfit=diagnosis.verdict != "no_mismatch")
    data["notes"] = [*material.notes(), *curve_note(reference)]
    data["untimed"] = material.untimed()
    data["held_out"] = _held_out_spans(material)
    return DiagnosisResult(diagnosis, material, data)


def _observable_terms(model: Model, names: Sequence[str]) -> tuple[str, ...]:
    """Of the default terms those that this recording can show."""
    present = {term.name for term in model.terms.values()}
    return tuple(name for name in names if name in present or name not in model.unobservable_terms)


def _held_out_spans(material: Dataset) -> list[list[float]]:
    """Which stretch of each recording was held out of it, s; none where whole recordings were."""
    if material.test_is_separate or not material.held_out:
        return []
    return [[float(record.t[0]), float(record.t[-1])] for record in material.test.recordings()]


def _reference_values(material: Dataset, reference: Reference | None) -> Mapping[str, float] | None:
    if reference is not None:
        return for_every_recording(material.model, values_of(reference))
    known = index_of(material.model.parameters)
    file_nominal = (
        material.model.nominal if isinstance(material.model, (ArmFileModel, SimulatorModel)) else {}
    )
    file_nominal = {name: value for name, value in file_nominal.items() if name in known}
    nominal = for_every_recording(material.model, material.rig.nominal or file_nominal)
    for name, value in nominal.items():
        if name not in known:
            raise UnknownNameError(f"{material.rig.path}: [nominal] parameter", name, known)
        parameter = material.model.parameters[known[name]]
        if not parameter.lower <= value <= parameter.upper:
            raise UsageError(
                f"{material.rig.path}: [nominal] {name}: expected {parameter.lower:g} to {parameter.upper:g} "
                f"{parameter.unit}, found {value:g}"
            )
    return nominal or None
