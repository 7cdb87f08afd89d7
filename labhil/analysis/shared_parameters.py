"""Parameters that several models share, side by side, and whether their values agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

from scipy import stats

from labhil.analysis.compared_models import Candidate
from labhil.analysis.schema import Parameter

ALPHA = 0.01
"""Of every question that a comparison answers: which model is better, whether values agree."""

SAME = 1e-9
"""Share by which values that were held may differ."""


def shared_parameters(candidates: Sequence[Candidate]) -> list[dict[str, Any]]:
    """A row for each parameter of two models or more, as the JSON of a comparison has it.

    The errors of two fits are added as if they were independent. Two fits of one recording share its noise,
    so that their values differ by less than that: a disagreement is one all the more.
    """
    by_key: dict[str, list[tuple[str, Parameter]]] = {}
    for candidate in candidates:
        for row in candidate.parameters:
            by_key.setdefault(row.key, []).append((candidate.name, row))
    return [_row(rows) for rows in by_key.values() if len(rows) > 1]


def _row(rows: Sequence[tuple[str, Parameter]]) -> dict[str, Any]:
    first = rows[0][1]
    z, p_value, agree = agreement([row for _, row in rows])
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


def agreement(rows: Sequence[Parameter]) -> tuple[float | None, float | None, bool | None]:
    """The largest z of two values, its p value for all pairs, and whether they agree; None where unknown."""
    pairs = list(combinations(rows, 2))
    sizes = [z for z in (_z(first, second) for first, second in pairs) if z is not None]
    if len(sizes) < len(pairs) or not sizes:
        return None, None, None
    largest = max(sizes)
    p_value = min(1.0, len(pairs) * float(2.0 * stats.norm.sf(largest)))
    return (largest if math.isfinite(largest) else None), p_value, p_value >= ALPHA


def _z(first: Parameter, second: Parameter) -> float | None:
    """How many standard errors two values are apart; None where the data do not know one of them."""
    if first.value is None or second.value is None:
        return None
    if not all(row.held or (row.identifiable and row.std_error is not None) for row in (first, second)):
        return None
    errors = [0.0 if row.held else row.std_error or 0.0 for row in (first, second)]
    difference, spread = abs(first.value - second.value), math.hypot(*errors)
    if spread > 0.0:
        return difference / spread
    return 0.0 if difference <= SAME * max(abs(first.value), abs(second.value)) else float("inf")
