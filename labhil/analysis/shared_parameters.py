"""Parameters that several models share, and tests whether their values agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

from scipy import stats

from labhil.analysis.compared_models import Candidate
from labhil.analysis.schema import Parameter

ALPHA = 0.01
"""Level of every test of a comparison: which model is better, whether values agree."""


def shared_parameters(candidates: Sequence[Candidate]) -> list[dict[str, Any]]:
    """Return a row of plain data for each parameter that two models or more have.

    The errors of two fits are added as if independent. Two fits of one recording share its noise, so that
    their values differ by less than that: the test is conservative.
    """
    by_key: dict[str, list[tuple[str, Parameter]]] = {}
    for candidate in candidates:
        for row in candidate.parameters:
            by_key.setdefault(row.key, []).append((candidate.name, row))
    return [_row(rows) for rows in by_key.values() if len(rows) > 1]


def _row(rows: Sequence[tuple[str, Parameter]]) -> dict[str, Any]:
    first = rows[0][1]
    z, p_value, agree = compare_values([row for _, row in rows])
    return {
        "name": first.name,
        "joint": first.joint,
        "unit": first.unit,
        "values": [
            {
                "model": name,
                "value": row.value,
                "std_error": row.std_error,
                "ci99": row.ci99,
                "held": row.held,
                "identifiable": row.identifiable,
            }
            for name, row in rows
        ],
        "z": z,
        "p_value": p_value,
        "agree": agree,
    }


def compare_values(rows: Sequence[Parameter]) -> tuple[float | None, float | None, bool | None]:
    """Return the largest z of two values, its p value for all pairs, and whether they agree.

    All are None where the data do not determine one of the values.
    """
    pairs = list(combinations(rows, 2))
    z_scores = [z for z in (_z_score(first, second) for first, second in pairs) if z is not None]
    if len(z_scores) < len(pairs) or not z_scores:
        return None, None, None
    largest = max(z_scores)
    p_value = min(1.0, len(pairs) * float(2.0 * stats.norm.sf(largest)))
    return (largest if math.isfinite(largest) else None), p_value, p_value >= ALPHA


def _z_score(first: Parameter, second: Parameter, rtol: float = 1e-9) -> float | None:
    """Distance of two values in standard errors; None where the data do not determine one of them.

    Two held values, without errors, are equal within ``rtol``.
    """
    if first.value is None or second.value is None:
        return None
    if not all(row.held or (row.identifiable and row.std_error is not None) for row in (first, second)):
        return None
    errors = [0.0 if row.held else row.std_error or 0.0 for row in (first, second)]
    difference, std_error = abs(first.value - second.value), math.hypot(*errors)
    if std_error > 0.0:
        return difference / std_error
    return 0.0 if difference <= rtol * max(abs(first.value), abs(second.value)) else float("inf")
