"""Turn the study into JSON, SI units (schema ``labhil.optimise/1``)."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from labhil.optimise.circuit import positions
from labhil.optimise.geometry import HOUSING, PARAMETERS
from labhil.optimise.sensitivity import OUTPUTS
from labhil.optimise.steel import FREE_CUTTING
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.optimise.field_check import FieldCheck
    from labhil.optimise.study import Optimisation

SCHEMA = "labhil.optimise/1"


def optimisation_json(study: Optimisation) -> dict[str, Any]:
    """Return the study as plain data, without designs off the front; numbers that are not finite are None."""
    return {
        "schema": SCHEMA,
        "what": "solenoid",
        "seed": study.seed,
        "parameters": [
            {"name": p.name, "symbol": p.symbol, "unit": p.unit, "levels": list(p.levels)} for p in PARAMETERS
        ],
        "model": {"housing": HOUSING._asdict(), "steel": FREE_CUTTING._asdict()},
        "positions": positions().tolist(),
        "database": [
            {"kind": kind, "design": design.tolist(), "force": curve.tolist()}
            for kind, design, curve in zip(
                study.runs.kinds, study.runs.designs, study.database.curves, strict=True
            )
        ],
        "normalisation": asdict(study.objectives),
        "interpolation": asdict(study.interpolation),
        "candidates": [
            {
                "name": c.name,
                "design": c.design.tolist(),
                "force": c.curve.tolist(),
                "largest_force": c.largest_force,
                "rms_slope": c.rms_slope,
                "mean_slope": c.mean_slope,
                "cf1": float(c.scores[0]),
                "cf2": float(c.scores[1]),
                "cf": c.cost,
            }
            for c in study.candidates
        ],
        "promised_by_interpolation": study.predicted_cost,
        "swarms": {"flown": study.swarms, "agreeing": study.n_agreeing},
        "front": [
            {"design": study.evaluated[n].tolist(), "cf1": study.scores[n, 0], "cf2": study.scores[n, 1]}
            for n in study.front
        ],
        "sensitivity": _sensitivity_json(study),
        "field": None if study.field is None else _field_json(study.field),
        "evaluations": len(study.evaluated),
        "seconds": study.seconds,
    }


def _sensitivity_json(study: Optimisation) -> dict[str, Any]:
    overall = study.overall
    return {
        "outputs": list(OUTPUTS),
        "local": {
            name: {"elasticity": _finite(local.elasticity), "per_range": _finite(local.per_range)}
            for name, local in study.local.items()
        },
        "sobol": {
            "first_order": _finite(overall.first_order),
            "total": _finite(overall.total),
            "total_ci95": [_finite(overall.total_low), _finite(overall.total_high)],
            "evaluations": overall.evaluations,
        },
    }


def _field_json(field: FieldCheck) -> dict[str, Any]:
    return {
        "points": [asdict(point) for point in field.points],
        "refined": field.refined,
        "unknowns": field.unknowns,
    }


def _finite(table: FloatArray) -> list[list[float | None]]:
    return [[float(x) if np.isfinite(x) else None for x in row] for row in table]
