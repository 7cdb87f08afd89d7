"""The curves of a diagnosis, as its JSON has them, back in a model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from labhil.analysis.results import Reference, SavedModel
from labhil.documents import parse_json, read_document
from labhil.errors import ModelFileError
from labhil.identify.extended import Coordinate
from labhil.identify.saved_curve import ModelUnderCurves, SavedCurve
from labhil.physics.extra_force import AcceptsExtraForce, CurveArgument, MovedPart, placed
from labhil.physics.model import Model, unit_of
from labhil.signals import FloatArray

EVEN = 1e-6
"""Share of the range by which the places of a curve may miss even spacing."""


def under_kept_curve(model: Model, path: Reference | None) -> Model:
    """The model under the curves that a fit or diagnosis file has, or as it is where that has none.

    Raises ModelFileError where one of the file's curves is none that this model takes.
    """
    stated = [] if path is None else _stated(path)
    if path is None or not stated:
        return model
    if not isinstance(model, AcceptsExtraForce):
        raise ModelFileError(f"{path}: curve: a model of {model.kind} takes no force beside its terms")
    return ModelUnderCurves(model, [_curve(path, each, model) for each in stated])


def curve_note(path: Reference | None) -> list[str]:
    """What to tell a person of the curves that a model file brings along; nothing where it has none."""
    return [
        f"The model is under the force{_on_joint(stated)} that {path} has as a curve over "
        f"{', '.join(stated['depends_on'])}."
        for stated in ([] if path is None else _stated(path))
    ]


def _on_joint(stated: Mapping[str, Any]) -> str:
    joint = stated.get("joint")
    return "" if joint is None else f" on joint {joint}"


def curves_json(model: Model) -> list[dict[str, Any]]:
    """The curves of a model under some, as a diagnosis states them; none of any other."""
    return [_stating(curve) for curve in model.curves] if isinstance(model, ModelUnderCurves) else []


def _stating(curve: SavedCurve) -> dict[str, Any]:
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


def _stated(path: Reference) -> list[Mapping[str, Any]]:
    """The fields ``curve`` and ``further_curves`` of a file that was found to be a model's elsewhere."""
    try:
        whole = path.data if isinstance(path, SavedModel) else parse_json(read_document(path))
        stated = [whole.get("curve"), *(whole.get("further_curves") or ())]
    except (OSError, ValueError, AttributeError, TypeError):
        return []
    if any(each is not None and not isinstance(each, dict) for each in stated):
        raise ModelFileError(f"{path}: curve: expected an object or null, found {stated!r}"[:300])
    return [each for each in stated if each is not None]


def _curve(path: Reference, stated: Mapping[str, Any], model: AcceptsExtraForce) -> SavedCurve:
    try:
        name, acts = str(stated["depends_on"][0]), CurveArgument[str(stated["acts"]).upper()]
        x, value = _numbers(stated["x"][0]), _numbers(stated["value"])
        low, high = (_numbers(side) for side in stated.get("ci99") or (stated["value"], stated["value"]))
    except (KeyError, IndexError, TypeError, ValueError) as error:
        known = ", ".join(argument.name.lower() for argument in CurveArgument)
        raise ModelFileError(
            f"{path}: curve: expected depends_on, acts ({known}), x and value as `labhil diagnose` writes "
            f"them, found {error!r}"
        ) from error
    if not len(x) == len(value) == len(low) == len(high) or len(x) < 2:
        raise ModelFileError(f"{path}: curve: expected as many of x, value and ci99, two or more")
    steps = np.diff(x)
    if not steps[0] > 0.0 or np.ptp(steps) > EVEN * (x[-1] - x[0]):
        raise ModelFileError(f"{path}: curve: x: expected rising, evenly spaced places")
    unit = unit_of(model.coordinate_units, name)
    if unit is None:
        known = ", ".join(model.coordinate_units)
        raise ModelFileError(f"{path}: curve: depends_on: expected one of {known}, found {name!r}")
    coordinate = Coordinate(name, unit, acts, _part(path, stated, placed(model, [name])))
    return SavedCurve(coordinate, x, value, low, high, str(stated.get("unit", "")), stated.get("formula"))


def _part(path: Reference, stated: Mapping[str, Any], model: AcceptsExtraForce) -> MovedPart:
    """What the curve acts on, by the ``joint`` of an arm; of anything else there is one part."""
    joint = stated.get("joint")
    for part in model.moved:
        if part.joint == joint:
            return part
    known = ", ".join("null" if part.joint is None else str(part.joint) for part in model.moved)
    raise ModelFileError(f"{path}: curve: joint: expected one of {known}, found {joint!r}")


def _numbers(values: Any) -> FloatArray:
    found = np.array(values, dtype=np.float64)
    if found.ndim != 1 or not np.all(np.isfinite(found)):
        raise ValueError(f"expected a list of finite numbers, found {values!r}"[:120])
    return found
