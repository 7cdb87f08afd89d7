"""Fits and diagnoses as JSON (`labhil.fit/1`, `labhil.diagnosis/1`): no NaN, no infinity, null instead."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labhil.diagnose.accepted import Accepted
from labhil.diagnose.answer import Curve, Diagnosis
from labhil.diagnose.locate import Location
from labhil.documents import is_finite_number, parse_json, read_document
from labhil.errors import ModelFileError
from labhil.identify.fit import Fit
from labhil.identify.score import Figures, Score
from labhil.identify.statistics import Estimate
from labhil.physics.terms import keyed
from labhil.signals import FloatArray
from labhil.whole import whole


@dataclass(frozen=True, slots=True)
class Source:
    """A recording that a result comes from; ``role`` is "search", "train" or "test".

    ``start`` and ``duration`` (s) say which stretch of it was used; ``recording`` is its number among several
    of its role.
    """

    path: str
    sha256: str
    rig: str
    samples: int
    duration: float
    role: str
    start: float = 0.0
    recording: int | None = None


@dataclass(frozen=True, slots=True)
class SavedModel:
    """The JSON data of a fit or diagnosis that stands for a model; ``name`` is what messages call it."""

    name: str
    data: Mapping[str, Any]

    def __str__(self) -> str:
        return self.name


Reference = Path | SavedModel
"""A fit or diagnosis that stands for a model: its file, or its data."""


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
    """The whole of a fit as plain JSON data; ``curves`` are forces that the model was under."""
    kept = {"curve": curves[0], "further_curves": curves[1:]} if curves else {}
    return _told(
        sources,
        kept
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
            "left": [asdict(channel) for channel in fit.left],
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


def _told(sources: Sequence[Source], result: dict[str, Any]) -> Any:
    """A result as plain JSON data; of one recording it says nothing of which."""
    several = any(source.recording is not None for source in sources)
    return finite(result if several else _of_one(result))


def _of_one(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _of_one(inner) for key, inner in value.items() if key not in OF_SEVERAL}
    return [_of_one(inner) for inner in value] if isinstance(value, (list, tuple)) else value


def score_json(score: Score) -> dict[str, Any]:
    """Headline and channels of a score; R² is a fraction."""
    stated = {"metric": score.metric.value, "horizon": score.horizon, **_figures(score)}
    if score.recordings:
        stated["per_recording"] = [{"recording": r.recording, **_figures(r)} for r in score.recordings]
    return stated


def _figures(figures: Figures) -> dict[str, Any]:
    return {
        "mse": figures.mse,
        "rmse": figures.rmse,
        "max_abs_error": figures.max_abs_error,
        "r2": figures.r2,
        "noise_floor": figures.noise_floor,
        "per_channel": [asdict(channel) for channel in figures.rows_told],
    }


def diagnosis_json(diagnosis: Diagnosis, sources: Sequence[Source]) -> Any:
    """The whole of a diagnosis as plain JSON data."""
    return _told(
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
            "location": None if diagnosis.location is None else _location(diagnosis.location),
            "missing": [{**asdict(item), "parameters": _rows(item.parameters)} for item in diagnosis.missing],
            "rivals": [asdict(rival) for rival in diagnosis.rivals],
            "undecided": [asdict(item) for item in diagnosis.undecided],
            "excluded": [asdict(item) for item in diagnosis.excluded],
            "improvement": _improvement(diagnosis),
            "remainder": None if diagnosis.remainder is None else asdict(diagnosis.remainder),
            "final": {"terms": list(diagnosis.final_terms), "parameters": _rows(diagnosis.final)},
            "scale_factor": diagnosis.scale_factor,
            "curve": None if diagnosis.curve is None else _curve(diagnosis.curve),
            "further_curves": [_curve(curve) for curve in diagnosis.further_curves],
            "complete": diagnosis.complete,
            "seconds": diagnosis.seconds,
        },
    )


def _location(location: Location) -> dict[str, Any]:
    stated = asdict(location)
    stated["times_in"] = stated.pop("recordings")
    return stated


def _curve(curve: Curve) -> dict[str, Any]:
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


def _improvement(diagnosis: Diagnosis) -> dict[str, Any]:
    before, after = diagnosis.before, diagnosis.after
    stated: dict[str, Any] = {"data": diagnosis.data, "metric": after.metric.value}
    stated |= {"horizon": after.horizon, **_before_and_after(before, after)}
    if diagnosis.wider:
        stated["parts"] = True
    if diagnosis.shorter is not None:
        shorter = diagnosis.shorter
        stated["shorter_windows"] = {"horizon": shorter[1].horizon, **_before_and_after(*shorter)}
    if after.recordings:
        stated["per_recording"] = [
            {"recording": a.recording, **_before_and_after(b, a)}
            for b, a in zip(before.recordings, after.recordings, strict=True)
        ]
    return stated


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
            for b, a in zip(before.rows_told, after.rows_told, strict=False)
        ],
    }


def _rows(estimates: Sequence[Estimate]) -> list[dict[str, Any]]:
    """Rows of a table; what was held has no error of its own."""
    return [{**asdict(row), "held": math.isnan(row.std_error)} for row in estimates]


def finite(value: Any) -> Any:
    """Plain JSON data with null in the place of NaN and infinities."""
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


def write_json(data: Any, path: Path) -> None:
    """Write JSON data, UTF-8, readable; UsageError or DiskFailedError where that fails."""
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    with whole(path, "the result") as draft:
        draft.write_text(text + "\n", encoding="utf-8")


def values_of(path: Reference) -> dict[str, float]:
    """Parameter values of a fit or diagnosis file, to start from or to compare with.

    Raises ModelFileError when the file is neither.
    """
    values = {}
    for row in _model_in(path)["parameters"]:
        name, value = (row.get("name"), row.get("value")) if isinstance(row, dict) else (None, None)
        known = value is None or is_finite_number(value)
        if not isinstance(name, str) or not known:
            raise ModelFileError(
                f"{path}: parameters: expected rows with a `name` and a finite `value`, found {row!r}"
            )
        if value is not None:
            values[_key(row)] = float(value)
    return values


def _key(row: Mapping[str, Any]) -> str:
    return keyed(row["name"], row.get("joint"), row.get("recording"))


def terms_of(path: Reference) -> tuple[str, ...]:
    """Names of the terms of a fit or diagnosis file; ModelFileError when it is neither."""
    terms = _model_in(path)["terms"]
    if not all(isinstance(name, str) for name in terms):
        raise ModelFileError(f"{path}: terms: expected a list of names, found {terms!r}")
    return tuple(terms)


def accepted_of(path: Reference) -> Accepted:
    """A fit or diagnosis file as an accepted model, with the covariance of its values where it has one.

    Where a file has standard errors only, nothing is known of their correlations: k times their squares
    are an upper bound of any covariance of k values. Raises ModelFileError with the field that is wrong.
    """
    values, terms, model = values_of(path), terms_of(path), _model_in(path)
    keys = tuple(_key(row) for row in model["parameters"])
    covariance = _covariance(path, model.get("covariance"), len(keys))
    if covariance is None:
        covariance = _from_errors(model["parameters"])
    return Accepted(
        name=str(path),
        rig=model.get("rig"),
        terms=terms,
        values=values,
        keys=keys,
        covariance=covariance,
        residual_ratio=_ratios(path, _object(path, "train", model.get("train"))),
        shortest=_shortest(path, model.get("by_window")),
        window=_number(path, "window", model.get("window")),
    )


def _covariance(path: Reference, rows: Any, k: int) -> FloatArray | None:
    """The matrix (k, k), null as an unknown (infinite) variance; None where there is none."""
    if rows is None:
        return None
    try:
        matrix = np.array(rows, dtype=np.float64).reshape(k, k)
    except (TypeError, ValueError, OverflowError) as error:
        raise ModelFileError(
            f"{path}: covariance: expected {k} rows of {k} numbers, one for each of `parameters`"
        ) from error
    unknown = ~np.isfinite(np.diag(matrix))
    matrix[unknown, :] = matrix[:, unknown] = 0.0
    if not np.all(np.isfinite(matrix)) or np.any(np.diag(matrix) < 0.0):
        raise ModelFileError(f"{path}: covariance: expected finite numbers and no negative variance")
    matrix[unknown, unknown] = np.inf
    return matrix


def _from_errors(rows: Sequence[Mapping[str, Any]]) -> FloatArray | None:
    errors = [row.get("std_error") for row in rows]
    if not errors or not any(isinstance(error, (int, float)) for error in errors):
        return None
    known = [float(e) if is_finite_number(e) else np.inf for e in errors]
    return np.diag(len(known) * np.square(known))


def _object(path: Reference, name: str, value: Any) -> Mapping[str, Any]:
    if value is not None and not isinstance(value, dict):
        raise ModelFileError(f"{path}: {name}: expected an object, found {value!r}")
    return value or {}


def _ratios(path: Reference, train: Mapping[str, Any]) -> dict[str, float]:
    """RMSE over noise floor of each channel of a file's ``train``."""
    found = {}
    channels = train.get("per_channel") or []
    if not isinstance(channels, list):
        raise ModelFileError(f"{path}: train.per_channel: expected a list, found {channels!r:.80}")
    for each in channels:
        row = _object(path, "train.per_channel", each)
        rmse = _number(path, "train.per_channel.rmse", row.get("rmse"))
        floor = _number(path, "train.per_channel.noise_floor", row.get("noise_floor"))
        if rmse is not None and floor:
            found[keyed(str(row.get("channel")), row.get("joint"))] = rmse / floor
    return found


def _shortest(path: Reference, rungs: Any) -> float | None:
    """Residuals over noise on the shortest of a file's fitted windows."""
    if not isinstance(rungs, list) or not rungs or not isinstance(rungs[0], dict):
        return None
    return _number(path, "by_window.residual", rungs[0].get("residual"))


def _number(path: Reference, name: str, value: Any) -> float | None:
    if value is not None and not is_finite_number(value):
        raise ModelFileError(f"{path}: {name}: expected a finite number, found {value!r:.80}")
    return None if value is None else float(value)


def _model_in(path: Reference) -> Mapping[str, Any]:
    """The part of a result that holds ``terms`` and ``parameters``."""
    try:
        data = path.data if isinstance(path, SavedModel) else parse_json(read_document(path))
    except (OSError, ValueError) as error:
        raise ModelFileError(f"{path}: cannot be read as a model (JSON of `labhil fit`): {error}") from error
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema not in ("labhil.fit/1", "labhil.diagnosis/1"):
        raise ModelFileError(
            f"{path}: expected schema labhil.fit/1 or labhil.diagnosis/1, found {schema or 'no schema'}"
        )
    model = data if schema == "labhil.fit/1" else data.get("final")
    if not isinstance(model, dict) or not all(
        isinstance(model.get(k), list) for k in ("terms", "parameters")
    ):
        raise ModelFileError(f"{path}: expected the lists `terms` and `parameters`, found a result without")
    return model
