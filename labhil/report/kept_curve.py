"""The curve of a diagnosis, as its JSON has it, back in a model."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from labhil.errors import ModelFileError
from labhil.identify.extended import Coordinate
from labhil.identify.kept_curve import KeptCurve, ModelUnderCurve
from labhil.physics.extra_force import Over, Yielding
from labhil.physics.model import Model
from labhil.signals import FloatArray

EVEN = 1e-6
"""Share of the range by which the places of a curve may miss even spacing."""


def under_kept_curve(model: Model, path: Path | None) -> Model:
    """The model under the curve that a fit or diagnosis file has, or as it is where that has none.

    Raises ModelFileError where the file's curve is none that this model takes.
    """
    stated = None if path is None else _stated(path)
    if path is None or stated is None:
        return model
    if not isinstance(model, Yielding):
        raise ModelFileError(f"{path}: curve: a model of {model.kind} takes no force beside its terms")
    return ModelUnderCurve(model, _curve(path, stated, model))


def curve_note(path: Path | None) -> list[str]:
    """What to tell a person of the curve that a model file brings along; nothing where it has none."""
    stated = None if path is None else _stated(path)
    if stated is None:
        return []
    return [
        f"The model is under the force that {path} has as a curve over {', '.join(stated['depends_on'])}."
    ]


def curve_json(model: Model) -> dict[str, Any] | None:
    """The curve of a model under one, as a diagnosis states it; None of any other."""
    if not isinstance(model, ModelUnderCurve):
        return None
    curve = model.curve
    return {
        "depends_on": [curve.coordinate.name],
        "acts": curve.coordinate.acts.name.lower(),
        "x": [curve.x],
        "value": curve.value,
        "ci99": [curve.low, curve.high],
        "unit": curve.unit,
        "formula": curve.formula,
    }


def _stated(path: Path) -> Mapping[str, Any] | None:
    """The field ``curve`` of a file that was found to be a model's elsewhere."""
    try:
        stated = json.loads(path.read_text(encoding="utf-8")).get("curve")
    except (OSError, ValueError, AttributeError):
        return None
    if stated is not None and not isinstance(stated, dict):
        raise ModelFileError(f"{path}: curve: expected an object or null, found {stated!r}")
    return stated


def _curve(path: Path, stated: Mapping[str, Any], model: Yielding) -> KeptCurve:
    try:
        name, acts = str(stated["depends_on"][0]), Over[str(stated["acts"]).upper()]
        x, value = _numbers(stated["x"][0]), _numbers(stated["value"])
        low, high = (_numbers(side) for side in stated.get("ci99") or (stated["value"], stated["value"]))
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ModelFileError(
            f"{path}: curve: expected depends_on, acts ({', '.join(o.name.lower() for o in Over)}), x and "
            f"value as `labhil diagnose` writes them, found {error!r}"
        ) from error
    if not len(x) == len(value) == len(low) == len(high) or len(x) < 2:
        raise ModelFileError(f"{path}: curve: expected as many of x, value and ci99, two or more")
    steps = np.diff(x)
    if not steps[0] > 0.0 or np.ptp(steps) > EVEN * (x[-1] - x[0]):
        raise ModelFileError(f"{path}: curve: x: expected rising, evenly spaced places")
    if name not in model.coordinate_units:
        known = ", ".join(model.coordinate_units)
        raise ModelFileError(f"{path}: curve: depends_on: expected one of {known}, found {name!r}")
    turn = model.turn if acts in (Over.POSITION, Over.POSITION_AGAINST) else 0.0
    coordinate = Coordinate(name, model.coordinate_units[name], acts, turn)
    return KeptCurve(coordinate, x, value, low, high, str(stated.get("unit", "")), stated.get("formula"))


def _numbers(values: Any) -> FloatArray:
    found = np.array(values, dtype=np.float64)
    if found.ndim != 1 or not np.all(np.isfinite(found)):
        raise ValueError(f"expected a list of finite numbers, found {values!r}"[:120])
    return found
