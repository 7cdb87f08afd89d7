"""Force curves in the JSON of a diagnosis or a fit, read into a model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from labhil.analysis.saved_model import Reference, SavedModel
from labhil.documents import parse_json, read_document
from labhil.errors import ModelFileError
from labhil.identify.extended import Coordinate
from labhil.identify.saved_curve import ModelUnderCurves, SavedCurve
from labhil.physics.extra_force import AcceptsExtraForce, CurveArgument, MovedPart, with_place
from labhil.physics.model import Model, unit_of
from labhil.signals import FloatArray


def with_saved_curves(model: Model, path: Reference | None) -> Model:
    """Return a model with the force curves of a fit or diagnosis file, or the model itself if it has none.

    Raises:
        ModelFileError: This model cannot take one of the curves.
    """
    entries = [] if path is None else _curve_entries(path)
    if path is None or not entries:
        return model
    if not isinstance(model, AcceptsExtraForce):
        raise ModelFileError(f"{path}: curve: a model of {model.kind} takes no force beside its terms")
    return ModelUnderCurves(model, [_parse_curve(path, entry, model) for entry in entries])


def curve_note(path: Reference | None) -> list[str]:
    """Return a note on each curve of a model file."""
    return [
        f"The model is under the force{_joint_phrase(entry)} that {path} has as a curve over "
        f"{', '.join(entry['depends_on'])}."
        for entry in ([] if path is None else _curve_entries(path))
    ]


def _joint_phrase(entry: Mapping[str, Any]) -> str:
    joint = entry.get("joint")
    return "" if joint is None else f" on joint {joint}"


def curves_json(model: Model) -> list[dict[str, Any]]:
    """Return the saved curves of a model as plain data, as in a diagnosis."""
    return [_curve_json(curve) for curve in model.curves] if isinstance(model, ModelUnderCurves) else []


def _curve_json(curve: SavedCurve) -> dict[str, Any]:
    return {
        "depends_on": [curve.coordinate.name],
        "joint": curve.coordinate.part.joint,
        "acts": curve.coordinate.acts.name.lower(),
        "x": [curve.x],
        "value": curve.value,
        "ci99": [curve.low, curve.high],
        "unit": curve.unit,
        "formula": curve.formula,
    }


def _curve_entries(path: Reference) -> list[Mapping[str, Any]]:
    """Fields ``curve`` and ``further_curves`` of a model file; empty where it cannot be read as one."""
    try:
        document = path.data if isinstance(path, SavedModel) else parse_json(read_document(path))
        entries = [document.get("curve"), *(document.get("further_curves") or ())]
    except (OSError, ValueError, AttributeError, TypeError):
        return []
    if any(entry is not None and not isinstance(entry, dict) for entry in entries):
        raise ModelFileError(f"{path}: curve: expected an object or null, found {entries!r}"[:300])
    return [entry for entry in entries if entry is not None]


def _parse_curve(
    path: Reference, entry: Mapping[str, Any], model: AcceptsExtraForce, spacing_tolerance: float = 1e-6
) -> SavedCurve:
    """Read a curve; its x is evenly spaced within a share of its range."""
    try:
        name, acts = str(entry["depends_on"][0]), CurveArgument[str(entry["acts"]).upper()]
        x, value = _numbers(entry["x"][0]), _numbers(entry["value"])
        low, high = (_numbers(side) for side in entry.get("ci99") or (entry["value"], entry["value"]))
    except (KeyError, IndexError, TypeError, ValueError) as error:
        choices = ", ".join(argument.name.lower() for argument in CurveArgument)
        raise ModelFileError(
            f"{path}: curve: expected depends_on, acts ({choices}), x and value as `labhil diagnose` writes "
            f"them, found {error!r}"
        ) from error
    if not len(x) == len(value) == len(low) == len(high) or len(x) < 2:
        raise ModelFileError(f"{path}: curve: expected as many of x, value and ci99, two or more")
    steps = np.diff(x)
    if not steps[0] > 0.0 or np.ptp(steps) > spacing_tolerance * (x[-1] - x[0]):
        raise ModelFileError(f"{path}: curve: x: expected rising, evenly spaced places")
    unit = unit_of(model.coordinate_units, name)
    if unit is None:
        choices = ", ".join(model.coordinate_units)
        raise ModelFileError(f"{path}: curve: depends_on: expected one of {choices}, found {name!r}")
    coordinate = Coordinate(name, unit, acts, _moved_part(path, entry, with_place(model, [name])))
    return SavedCurve(coordinate, x, value, low, high, str(entry.get("unit", "")), entry.get("formula"))


def _moved_part(path: Reference, entry: Mapping[str, Any], model: AcceptsExtraForce) -> MovedPart:
    """Moved part that a curve acts on: the ``joint`` of an arm, else the only one."""
    joint = entry.get("joint")
    for part in model.moved:
        if part.joint == joint:
            return part
    choices = ", ".join("null" if part.joint is None else str(part.joint) for part in model.moved)
    raise ModelFileError(f"{path}: curve: joint: expected one of {choices}, found {joint!r}")


def _numbers(values: Any) -> FloatArray:
    numbers = np.array(values, dtype=np.float64)
    if numbers.ndim != 1 or not np.all(np.isfinite(numbers)):
        raise ValueError(f"expected a list of finite numbers, found {values!r}"[:120])
    return numbers
