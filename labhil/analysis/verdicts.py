"""What each verdict of a fit and of a diagnosis says, in a plain sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass

VERDICTS = {
    "no_mismatch": "No mismatch: the data do not contradict the baseline.",
    "parameter_change": "Parameters have changed; no physics is missing.",
    "missing_physics": "Physics is missing from the baseline.",
    "unexplained_mismatch": "There is a mismatch that no term of the catalogue explains.",
    "data_fault": "The data are at fault.",
    "not_decidable": "These data cannot tell.",
}

NOT_ASKED = "these data do not tell whether it suffices"
"""Instead of a p value, where the data are at fault or know nothing."""

FIT_VERDICTS = {
    "explained": "Explained to the noise",
    "unexplained": "Not explained",
    "worse_than_mean": "Worse than its own mean",
}


def fit_verdict(verdict: str, residual_over_noise: Mapping[str, float | None], r2: float | None) -> str:
    """The verdict of a fit as one line; ``r2`` is the smallest R² of what is not explained, a fraction.

    Channels whose ratio is not known have None: their simulation ran away.
    """
    known = {name: math.inf if ratio is None else ratio for name, ratio in residual_over_noise.items()}
    worst = max(known, key=lambda name: known[name], default="")
    of = f" of {worst}" if len(known) > 1 else ""
    ratio = known.get(worst, math.nan)
    times = f"{ratio:.2f}" if ratio < 10.0 else f"{ratio:.0f}"
    line = f"{FIT_VERDICTS[verdict]}: residual{of} {times} times the noise"
    if verdict == "worse_than_mean" and r2 is not None and math.isfinite(r2):
        line += f" (R² {100.0 * r2:.4g} %)"
    return line + "."


DISAGREEING = 1.1
"""Scale factor of errors from which it is worth a sentence."""


def disagreement(scale_factor: float | None) -> str:
    """What to know of errors where parts of the data disagree on the values; empty elsewhere."""
    if scale_factor is None or scale_factor < DISAGREEING:
        return ""
    return (
        f"Errors are {scale_factor:.2g} times those of the fit: by so much parts of the data disagree on the"
        " values."
    )
