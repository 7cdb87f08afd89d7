"""What each verdict of a diagnosis says, in a plain sentence."""

from __future__ import annotations

VERDICTS = {
    "no_mismatch": "No mismatch: the data do not contradict the baseline.",
    "parameter_change": "Parameters have changed; no physics is missing.",
    "missing_physics": "Physics is missing from the baseline.",
    "unexplained_mismatch": "There is a mismatch that no term of the catalogue explains.",
    "data_fault": "The data are at fault.",
    "not_decidable": "These data cannot tell.",
}
