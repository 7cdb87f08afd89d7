"""Sentences for the verdicts of fits and diagnoses, shared by text, pages and screen."""

from __future__ import annotations

import math
from collections.abc import Mapping

VERDICTS = {
    "no_mismatch": "No mismatch: the data do not contradict the baseline.",
    "parameter_change": "Parameters have changed; no physics is missing.",
    "missing_physics": "Physics is missing from the baseline.",
    "unexplained_mismatch": "There is a mismatch that no term of the catalogue explains.",
    "data_fault": "The data are at fault.",
    "not_decidable": "These data cannot tell.",
}

NOT_TESTED = "these data do not tell whether it suffices"
"""In place of a p value, where the data are at fault or not informative."""

FIT_VERDICTS = {
    "explained": "Explained to the noise",
    "unexplained": "Not explained",
    "worse_than_mean": "Worse than its own mean",
}


def fit_verdict(verdict: str, residual_over_noise: Mapping[str, float | None], r2: float | None) -> str:
    """Write the verdict of a fit as one line.

    Args:
        verdict: A key of ``FIT_VERDICTS``.
        residual_over_noise: RMSE over noise floor by channel; None where the simulation diverged.
        r2: Smallest R² of the channels that are not explained, a fraction; None or NaN where there is none.
    """
    ratios = {name: math.inf if ratio is None else ratio for name, ratio in residual_over_noise.items()}
    worst = max(ratios, key=lambda name: ratios[name], default="")
    of = f" of {worst}" if len(ratios) > 1 else ""
    ratio = ratios.get(worst, math.nan)
    times = f"{ratio:.2f}" if ratio < 10.0 else f"{ratio:.0f}"
    line = f"{FIT_VERDICTS[verdict]}: residual{of} {times} times the noise"
    if verdict == "worse_than_mean" and r2 is not None and math.isfinite(r2):
        line += f" (R² {100.0 * r2:.4g} %)"
    return line + "."


def disagreement(scale_factor: float | None, *, min_scale_factor: float = 1.1) -> str:
    """Write a sentence on standard errors where parts of the data disagree on the values.

    Args:
        scale_factor: By which the errors of the fit were multiplied; None where they were not.
        min_scale_factor: Factor below which there is no sentence.

    Returns:
        The sentence; empty where the data agree.
    """
    if scale_factor is None or scale_factor < min_scale_factor:
        return ""
    return (
        f"Errors are {scale_factor:.2g} times those of the fit: by so much parts of the data disagree on the"
        " values."
    )
