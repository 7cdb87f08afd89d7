"""Fits and diagnoses as JSON (`labhil.fit/1`, `labhil.diagnosis/1`), with null for NaN and infinities.

Package ``schema`` reads them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from labhil.diagnose.answer import Curve, Diagnosis
from labhil.diagnose.locate import Location
from labhil.identify.fit import Fit
from labhil.identify.score import Figures, Score
from labhil.identify.statistics import Estimate


@dataclass(frozen=True, slots=True)
class Source:
    """A recording of a result.

    Attributes:
        path: Its file.
        sha256: Its hash.
        rig: Its kind of rig.
        samples: Number of samples.
        duration: Duration of the part that was used, s.
        role: "search", "train" or "test".
        start: Begin of that part, s.
        recording: Its number among several of its role.
        rig_file: The rig file, or simulator, that was given by name; None for the one in the recording.
    """

    path: str
    sha256: str
    rig: str
    samples: int
    duration: float
    role: str
    start: float = 0.0
    recording: int | None = None
    rig_file: str | None = None


OF_SEVERAL = ("recording", "times_in", "per_recording")
"""Fields that only results of several recordings have."""


def fit_json(
    fit: Fit,
    sources: Sequence[Source],
    rig: str,
    estimator: str,
    seed: int,
    seconds: float,
    curves: Sequence[Mapping[str, Any]] = (),
) -> Any:
    """Return a fit as plain JSON data.

    Args:
        fit: The fit.
        sources: Its recordings.
        rig: The kind of rig.
        estimator: Name of the estimator.
        seed: Seed of the estimator.
        seconds: Time of the fit, s.
        curves: Saved force curves in the model.
    """
    curve_fields = {"curve": curves[0], "further_curves": curves[1:]} if curves else {}
    return _result_json(
        sources,
        curve_fields
        | {
            "schema": "labhil.fit/1",
            "recordings": [asdict(source) for source in sources],
            "rig": rig,
            "estimator": estimator,
            "seed": seed,
            "verdict": fit.adequacy.verdict.value,
            "residual_over_noise": dict(fit.adequacy.residual_over_noise),
            "terms": list(fit.terms),
            "parameters": _rows(fit.estimates),
            "covariance": fit.covariance.tolist(),
            "identifiability": asdict(fit.identifiability),
            "train": score_json(fit.train),
            "test": None if fit.test is None else score_json(fit.test),
            "residuals": {
                "ljung_box_p": fit.ljung_box_p,
                "input_crosscorrelation_p": fit.input_crosscorrelation_p,
            },
            "intervals": {"method": fit.intervals.value, "simultaneous": fit.simultaneous},
            "criterion": fit.criterion.value,
            "left": [asdict(channel) for channel in fit.channel_errors],
            "window": fit.window,
            "by_window": [asdict(rung) for rung in fit.by_window],
            "compared": list(fit.compared),
            "sampling": list(fit.sampling),
            "converged": fit.converged,
            "complete": fit.complete,
            "evaluations": fit.evaluations,
            "seconds": seconds,
        },
    )


def _result_json(sources: Sequence[Source], result: dict[str, Any]) -> Any:
    """Return a result as plain JSON data; numbers of recordings are left out where there is only one."""
    several = any(source.recording is not None for source in sources)
    return finite(result if several else _drop_fields_of_several(result))


def _drop_fields_of_several(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _drop_fields_of_several(inner) for key, inner in value.items() if key not in OF_SEVERAL}
    return [_drop_fields_of_several(inner) for inner in value] if isinstance(value, (list, tuple)) else value


def score_json(score: Score) -> dict[str, Any]:
    """Return headline and channels of a score as plain data; R² is a fraction."""
    fields = {"metric": score.metric.value, "horizon": score.horizon, **_figures(score)}
    if score.recordings:
        fields["per_recording"] = [{"recording": r.recording, **_figures(r)} for r in score.recordings]
    return fields


def _figures(figures: Figures) -> dict[str, Any]:
    return {
        "mse": figures.mse,
        "rmse": figures.rmse,
        "max_abs_error": figures.max_abs_error,
        "r2": figures.r2,
        "noise_floor": figures.noise_floor,
        "per_channel": [asdict(channel) for channel in figures.reported],
    }


def diagnosis_json(diagnosis: Diagnosis, sources: Sequence[Source]) -> Any:
    """Return a diagnosis as plain JSON data."""
    return _result_json(
        sources,
        {
            "schema": "labhil.diagnosis/1",
            "recordings": [asdict(source) for source in sources],
            "verdict": diagnosis.verdict,
            "faults": [asdict(fault) for fault in diagnosis.faults],
            "p_value": diagnosis.p_value,
            "p_value_method": diagnosis.p_value_method,
            "p_value_floor": diagnosis.p_value_floor,
            "baseline": {"terms": list(diagnosis.baseline_terms), "parameters": _rows(diagnosis.baseline)},
            "changed": [asdict(change) for change in diagnosis.changed],
            "collapsed": [{**asdict(size), "statement": size.statement} for size in diagnosis.collapsed],
            "location": None if diagnosis.location is None else _location_json(diagnosis.location),
            "missing": [{**asdict(item), "parameters": _rows(item.parameters)} for item in diagnosis.missing],
            "rivals": [asdict(rival) for rival in diagnosis.rivals],
            "undecided": [asdict(item) for item in diagnosis.undecided],
            "excluded": [asdict(item) for item in diagnosis.excluded],
            "improvement": _improvement_json(diagnosis),
            "remainder": None if diagnosis.remainder is None else asdict(diagnosis.remainder),
            "final": {"terms": list(diagnosis.final_terms), "parameters": _rows(diagnosis.final)},
            "scale_factor": diagnosis.scale_factor,
            "curve": None if diagnosis.curve is None else _curve_json(diagnosis.curve),
            "further_curves": [_curve_json(curve) for curve in diagnosis.further_curves],
            "complete": diagnosis.complete,
            "seconds": diagnosis.seconds,
        },
    )


def _location_json(location: Location) -> dict[str, Any]:
    fields = asdict(location)
    fields["times_in"] = fields.pop("recordings")
    return fields


def _curve_json(curve: Curve) -> dict[str, Any]:
    return {
        "depends_on": [curve.depends_on],
        "joint": curve.joint,
        "acts": curve.acts,
        "x": [curve.x],
        "value": curve.value,
        "ci99": [curve.low, curve.high],
        "unit": curve.unit,
        "formula": curve.formula,
        "share": curve.share,
    }


def _improvement_json(diagnosis: Diagnosis) -> dict[str, Any]:
    before, after = diagnosis.before, diagnosis.after
    fields: dict[str, Any] = {"data": diagnosis.data, "metric": after.metric.value}
    fields |= {"horizon": after.horizon, **_before_and_after(before, after)}
    if diagnosis.wider:
        fields["parts"] = True
    if diagnosis.shorter is not None:
        shorter = diagnosis.shorter
        fields["shorter_windows"] = {"horizon": shorter[1].horizon, **_before_and_after(*shorter)}
    if after.recordings:
        fields["per_recording"] = [
            {"recording": a.recording, **_before_and_after(b, a)}
            for b, a in zip(before.recordings, after.recordings, strict=True)
        ]
    return fields


def _before_and_after(before: Figures, after: Figures) -> dict[str, Any]:
    return {
        "rmse_before": before.rmse,
        "rmse_after": after.rmse,
        "noise_floor": after.noise_floor,
        "mse_before": before.mse,
        "mse_after": after.mse,
        "r2_before": before.r2,
        "r2_after": after.r2,
        "per_channel": [
            {
                "channel": b.channel,
                "joint": b.joint,
                "unit": b.unit,
                "rmse_before": b.rmse,
                "rmse_after": a.rmse,
                "noise_floor": a.noise_floor,
                "noise_floor_before": b.noise_floor,
                "r2_before": b.r2,
                "r2_after": a.r2,
                "mse_before": b.mse,
                "mse_after": a.mse,
                "max_abs_error_before": b.max_abs_error,
                "max_abs_error_after": a.max_abs_error,
                "relative_error_before": b.relative_error,
                "relative_error_after": a.relative_error,
                "metric": a.metric.value,
            }
            for b, a in zip(before.reported, after.reported, strict=False)
        ],
    }


def _rows(estimates: Sequence[Estimate]) -> list[dict[str, Any]]:
    """Rows of a table of parameters; a held parameter has no standard error."""
    return [{**asdict(row), "held": math.isnan(row.std_error)} for row in estimates]


def finite(value: Any) -> Any:
    """Return plain JSON data with null for NaN and infinities."""
    if isinstance(value, Mapping):
        return {str(key): finite(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(inner) for inner in value]
    if isinstance(value, np.ndarray):
        return finite(value.tolist())
    if isinstance(value, (np.floating, float)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return bool(value) if isinstance(value, np.bool_) else value
