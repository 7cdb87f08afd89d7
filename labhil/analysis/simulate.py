"""Simulation of a recording by the model of a result."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from labhil.analysis.dataset import RecordingLike, naming, read_all
from labhil.analysis.measured import measured_of, refuse_holes
from labhil.analysis.results import finite, score_json
from labhil.analysis.rig_choice import rig_of
from labhil.analysis.saved_curves import with_saved_curves
from labhil.analysis.saved_model import Reference, SavedModel, terms_of, values_of
from labhil.analysis.schema import Score as ScorePart
from labhil.analysis.schema import validate
from labhil.diagnose.intake import replace_outliers
from labhil.errors import ModelFileError, OptionError, UnknownNameError
from labhil.identify.fitted import start_theta, with_only
from labhil.identify.score import Score, score
from labhil.identify.windows import noise_of, with_noise_scales
from labhil.physics.model import Model, index_of
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.rig import RigFile
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class SimulatedRecording:
    """A prepared record, the score of the model on it, and the JSON of that score as typed data."""

    name: str
    record: Record
    score: Score
    part: ScorePart


def simulate_recording(
    path_or_recording: RecordingLike,
    saved: SavedModel,
    kind: str | None,
    horizon: float | None,
    without: Collection[str] = (),
) -> SimulatedRecording:
    """Simulate the windows of a recording with the model of a result.

    Args:
        path_or_recording: The recording.
        saved: The result.
        kind: The rig kind of the result, where it is known.
        horizon: Length of the windows, s; None for that of the model.
        without: Terms that are switched off.

    Raises:
        ModelFileError: The result is of another rig kind.
        RecordingError: The recording cannot be simulated.
        UnknownNameError: The model does not have one of the terms.
    """
    if horizon is not None and not 0.0 < horizon < float("inf"):
        raise OptionError("horizon", f": expected more than 0 s, found {horizon:g}")
    terms = terms_of(saved)
    for name in without:
        if name not in terms:
            raise UnknownNameError("term", name, terms)
    recording = read_all([path_or_recording], None)[0]
    rig = rig_of(recording, None)
    if kind is not None and kind != rig.kind.name:
        raise ModelFileError(
            f"{recording.path}: expected a recording of {kind}, as {saved}, found one of {rig.kind.name}"
        )
    records, measured = measured_of([recording], rig)
    refuse_holes(recording.path, records[0])
    with naming([recording]):
        model, record, theta = model_on(measured, rig, saved, without)
        model_score = score(model, theta, record, noise_of(record), horizon)
    part = validate(ScorePart, finite(score_json(model_score)), "the score")
    return SimulatedRecording(str(recording.path), record, model_score, part)


def model_on(
    measured: Record, rig: RigFile, saved: Reference, without: Collection[str] = ()
) -> tuple[Model, Record, FloatArray]:
    """Return the model of a result for these data, the prepared data, and its parameters (P,).

    Args:
        measured: The data.
        rig: The rig file.
        saved: The result.
        without: Terms that are switched off.

    Raises:
        ModelFileError: The model of such a rig lacks a parameter of the result.
        RecordingError: The model cannot use the data.
    """
    model = with_saved_curves(model_for(rig, measured), saved)
    values = values_of(saved)
    parameter_index = index_of(model.parameters)
    unknown = [name for name in values if name not in parameter_index]
    if unknown:
        raise ModelFileError(f"{saved}: {unknown[0]}: a model of {rig.kind.name} has no such parameter")
    record = with_noise_scales(model, model.prepare(replace_outliers(measured)))
    theta = with_only(model, start_theta(model, values), set(terms_of(saved)) - set(without))
    return model, record, theta
