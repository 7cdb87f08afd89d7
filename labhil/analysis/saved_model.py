"""The model in the JSON of a fit or a diagnosis: values, terms and covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labhil.diagnose.accepted import Accepted
from labhil.documents import is_finite_number, parse_json, read_document
from labhil.errors import ModelFileError
from labhil.physics.terms import keyed
from labhil.signals import FloatArray
from labhil.unreadable import RESULT, reason_unreadable


@dataclass(frozen=True, slots=True)
class SavedModel:
    """The JSON data of a fit or diagnosis; ``name`` is its name in messages."""

    name: str
    data: Mapping[str, Any]

    def __str__(self) -> str:
        return self.name


Reference = Path | SavedModel
"""A fit or diagnosis: its file, or its data."""


def values_of(path: Reference) -> dict[str, float]:
    """Return the parameter values of a fit or diagnosis, by key.

    Raises:
        ModelFileError: The file is neither.
    """
    values = {}
    for row in _read_model_fields(path)["parameters"]:
        name, value = (row.get("name"), row.get("value")) if isinstance(row, dict) else (None, None)
        is_known = value is None or is_finite_number(value)
        if not isinstance(name, str) or not is_known:
            raise ModelFileError(
                f"{path}: parameters: expected rows with a `name` and a finite `value`, found {row!r}"
            )
        if value is not None:
            values[_key(row)] = float(value)
    return values


def _key(row: Mapping[str, Any]) -> str:
    return keyed(row["name"], row.get("joint"), row.get("recording"))


def terms_of(path: Reference) -> tuple[str, ...]:
    """Return the names of the terms of a fit or diagnosis.

    Raises:
        ModelFileError: The file is neither.
    """
    terms = _read_model_fields(path)["terms"]
    if not all(isinstance(name, str) for name in terms):
        raise ModelFileError(f"{path}: terms: expected a list of names, found {terms!r}")
    return tuple(terms)


def accepted_of(path: Reference) -> Accepted:
    """Return a fit or diagnosis as an accepted model, with the covariance of its values.

    Where a file has standard errors only, their correlations are unknown: k times the diagonal matrix of
    their squares is an upper bound of the covariance of k values.

    Raises:
        ModelFileError: A field is missing or wrong.
    """
    values, terms, model = values_of(path), terms_of(path), _read_model_fields(path)
    keys = tuple(_key(row) for row in model["parameters"])
    covariance = _covariance(path, model.get("covariance"), len(keys))
    if covariance is None:
        covariance = _covariance_from_errors(model["parameters"])
    return Accepted(
        name=str(path),
        rig=model.get("rig"),
        terms=terms,
        values=values,
        keys=keys,
        covariance=covariance,
        residual_ratio=_ratios(path, _object(path, "train", model.get("train"))),
        shortest=_shortest_residual(path, model.get("by_window")),
        window=_number(path, "window", model.get("window")),
    )


def _covariance(path: Reference, rows: Any, k: int) -> FloatArray | None:
    """Read the covariance (k, k), null as an infinite variance; None where there is none."""
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


def _covariance_from_errors(rows: Sequence[Mapping[str, Any]]) -> FloatArray | None:
    errors = [row.get("std_error") for row in rows]
    if not errors or not any(isinstance(error, (int, float)) for error in errors):
        return None
    std_errors = [float(e) if is_finite_number(e) else np.inf for e in errors]
    return np.diag(len(std_errors) * np.square(std_errors))


def _object(path: Reference, name: str, value: Any) -> Mapping[str, Any]:
    if value is not None and not isinstance(value, dict):
        raise ModelFileError(f"{path}: {name}: expected an object, found {value!r}")
    return value or {}


def _ratios(path: Reference, train: Mapping[str, Any]) -> dict[str, float]:
    """RMSE over noise floor of each channel of a file's ``train``."""
    ratios = {}
    channels = train.get("per_channel") or []
    if not isinstance(channels, list):
        raise ModelFileError(f"{path}: train.per_channel: expected a list, found {channels!r:.80}")
    for entry in channels:
        row = _object(path, "train.per_channel", entry)
        rmse = _number(path, "train.per_channel.rmse", row.get("rmse"))
        floor = _number(path, "train.per_channel.noise_floor", row.get("noise_floor"))
        if rmse is not None and floor:
            ratios[keyed(str(row.get("channel")), row.get("joint"))] = rmse / floor
    return ratios


def _shortest_residual(path: Reference, windows: Any) -> float | None:
    """Residuals over noise on the shortest of a file's fitted windows."""
    if not isinstance(windows, list) or not windows or not isinstance(windows[0], dict):
        return None
    return _number(path, "by_window.residual", windows[0].get("residual"))


def _number(path: Reference, name: str, value: Any) -> float | None:
    if value is not None and not is_finite_number(value):
        raise ModelFileError(f"{path}: {name}: expected a finite number, found {value!r:.80}")
    return None if value is None else float(value)


def _read_model_fields(path: Reference) -> Mapping[str, Any]:
    """Read the part of a result with ``terms`` and ``parameters``."""
    try:
        data = path.data if isinstance(path, SavedModel) else parse_json(read_document(path))
    except (OSError, ValueError) as error:
        reason = reason_unreadable(Path(str(path)), error, RESULT)
        raise ModelFileError(f"{path}: cannot be read as a model (JSON of `labhil fit`): {reason}") from error
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
