"""Fit and diagnosis of a data set, with their JSON."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from labhil.analysis.dataset import Dataset
from labhil.analysis.motion_check import require_motion
from labhil.analysis.results import diagnosis_json, fit_json
from labhil.analysis.saved_curves import curve_note, curves_json, with_saved_curves
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
from labhil.physics.several import for_every_recording, model_of_one
from labhil.simulators.arm import ArmFileModel
from labhil.simulators.model import SimulatorModel

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class FitResult:
    """A fit with its JSON."""

    fit: Fit
    dataset: Dataset
    json: Any

    @property
    def part(self) -> FitPart:
        """The JSON as typed data."""
        return validate(FitPart, self.json, "the fit")


@dataclass(frozen=True, slots=True)
class DiagnosisResult:
    """A diagnosis with its JSON."""

    diagnosis: Diagnosis
    dataset: Dataset
    json: Any

    @property
    def part(self) -> DiagnosisPart:
        """The JSON as typed data."""
        return validate(DiagnosisPart, self.json, "the diagnosis")


@linear_algebra_in_one_thread()
def fit_study(
    dataset: Dataset,
    *,
    terms: Sequence[str] | None = None,
    start: Reference | None = None,
    options: Options | None = None,
) -> FitResult:
    """Fit the model of a data set.

    Args:
        dataset: The data.
        terms: Names of the terms; by default those of ``start`` or of the rig kind.
        start: A fit or diagnosis file to start from; its curves stay in the model.
        options: Options of the fit.

    Raises:
        RecordingError: Values are not finite, or the rig does not move.
        UsageError: Options or terms do not fit the data (also as OptionError or UnknownNameError).
    """
    dataset.refuse_holes()
    require_motion(dataset.recordings[0][0].path, dataset.train, dataset.model.metric)
    shortest = FEWEST_SAMPLES_IN_WINDOW * dataset.train.period
    fit_options = options or Options()
    if fit_options.window is not None and not 0.99 * shortest <= fit_options.window < float("inf"):
        raise OptionError(
            "window",
            f": expected at least {shortest:.3g} s ({FEWEST_SAMPLES_IN_WINDOW} samples), "
            f"found {fit_options.window:g}",
        )
    model = with_saved_curves(dataset.model, start)
    term_names = terms
    if term_names is None:
        term_names = (
            terms_of(start) if start is not None else _observable_terms(model, rig_model(model.kind).general)
        )
    term_names = _add_per_recording_terms(model, term_names, stated=bool(terms))
    if not term_names and all(parameter.term is not None for parameter in model.parameters):
        raise OptionError("terms", f": expected one at least, since all else of this {model.kind} is known")
    start_time = time.perf_counter()
    initial = for_every_recording(model, values_of(start)) if start is not None else None
    test = dataset.test if dataset.held_out else None
    with dataset.naming():
        result = fit(model, dataset.train, term_names, test=test, start=initial, options=fit_options)
    if result.criterion is model.metric:
        identifiability = suggest_measurements(result.identifiability, dataset.rig, result.fitted)
        result = replace(result, identifiability=identifiability)
    seconds = time.perf_counter() - start_time
    sources = dataset.sources("train")
    data = fit_json(
        result, sources, model.kind, fit_options.estimator, fit_options.seed, seconds, curves_json(model)
    )
    data["faults"] = [asdict(fault) for fault in dataset.faults()]
    data["doubts"] = dataset.doubts(misfit=not result.adequacy.explained)
    data["notes"] = [*dataset.notes(), *curve_note(start)]
    data["untimed"] = dataset.untimed()
    data["held_out"] = _held_out_spans(dataset)
    return FitResult(result, dataset, data)


def _add_per_recording_terms(model: Model, terms: Sequence[str], *, stated: bool) -> tuple[str, ...]:
    """Add the terms with values per recording to the names of terms.

    Raises OptionError where terms were ``stated`` without them, UnknownNameError for an unknown term.
    """
    model_terms = {term.key for term in terms_named(model, terms)}
    per_recording = dict.fromkeys(
        p.term for p in model.parameters if p.recording is not None and p.term is not None
    )
    further = [term for term in per_recording if term not in model_terms]
    if further and stated:
        raise OptionError(
            "per-recording", f" {further[0]}: the fitted terms are {', '.join(terms)}; add it to --terms"
        )
    return (*terms, *further)


@linear_algebra_in_one_thread()
def diagnose_study(
    dataset: Dataset,
    *,
    baseline: Sequence[str] | None = None,
    reference: Reference | None = None,
    progress: Progress = lambda text: None,
) -> DiagnosisResult:
    """Diagnose a data set.

    Args:
        dataset: The data.
        baseline: Names of the baseline's terms; by default those of ``reference`` or of the rig kind.
        reference: A fit or diagnosis file that describes the user's simulation, curves included, instead of
            ``[nominal]`` in the rig file.
        progress: Called with a line of text at each stage.
    """
    model = with_saved_curves(dataset.model, reference)
    values = reference_values(dataset, reference)
    term_names = baseline
    if term_names is None:
        term_names = (
            terms_of(reference)
            if reference is not None
            else _observable_terms(model, rig_model(model.kind).baseline)
        )
    terms_named(model, term_names)
    with dataset.naming():
        diagnosis = diagnose(
            model,
            dataset.train,
            dataset.test,
            heldout_is_test=dataset.test_is_separate,
            baseline=term_names,
            reference=values,
            accepted=None if reference is None else accepted_of(reference),
            measured=dataset.measured,
            progress=progress,
        )
    data = diagnosis_json(diagnosis, dataset.sources("search"))
    data["doubts"] = dataset.doubts(misfit=diagnosis.verdict != "no_mismatch")
    data["notes"] = [*dataset.notes(), *curve_note(reference)]
    data["untimed"] = dataset.untimed()
    data["held_out"] = _held_out_spans(dataset)
    return DiagnosisResult(diagnosis, dataset, data)


def _observable_terms(model: Model, names: Sequence[str]) -> tuple[str, ...]:
    """Default terms that this recording can show."""
    model_terms = {term.name for term in model.terms.values()}
    return tuple(name for name in names if name in model_terms or name not in model.unobservable_terms)


def _held_out_spans(dataset: Dataset) -> list[list[float]]:
    """Begin and end of the part held out of each recording, s; empty where tests are separate recordings."""
    if dataset.test_is_separate or not dataset.held_out:
        return []
    return [[float(record.t[0]), float(record.t[-1])] for record in dataset.test.recordings()]


def reference_values(dataset: Dataset, reference: Reference | None) -> Mapping[str, float] | None:
    """Values of the user's simulation: of a result, of ``[nominal]``, or of a simulator's file."""
    if reference is not None:
        return for_every_recording(dataset.model, values_of(reference))
    parameter_index = index_of(dataset.model.parameters)
    model = model_of_one(dataset.model)
    file_nominal = model.nominal if isinstance(model, (ArmFileModel, SimulatorModel)) else {}
    file_nominal = {name: value for name, value in file_nominal.items() if name in parameter_index}
    nominal = for_every_recording(dataset.model, dataset.rig.nominal or file_nominal)
    for name, value in nominal.items():
        if name not in parameter_index:
            raise UnknownNameError(f"{dataset.rig.path}: [nominal] parameter", name, parameter_index)
        parameter = dataset.model.parameters[parameter_index[name]]
        if not parameter.lower <= value <= parameter.upper:
            raise UsageError(
                f"{dataset.rig.path}: [nominal] {name}: expected {parameter.lower:g} to {parameter.upper:g} "
                f"{parameter.unit}, found {value:g}"
            )
    return nominal or None
