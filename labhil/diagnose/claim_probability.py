"""Calibrated probability of a claim: how likely is it that a named effect is really there?

Evidence compares only terms of the catalogue. A wrong term may substitute the right one, the more easily the
more terms are named. The probability that a claim (the term or one of its listed rivals) is right is
therefore a logistic regression on two features of the diagnosis; the probability of a term itself is that
times its share of the structures visited.

CALIBRATED_ON
The error that remains is no feature: beside a random force large errors remain, and claims are as often right
there (its weight was −0.5 ± 1.1). Of an arm, where each joint has claims of its own, evidence alone counts.
"""

from __future__ import annotations

import numpy as np

from labhil.diagnose.evidence import Evidence
from labhil.signals import FloatArray

WEIGHTS = (2.3, -0.4, 0.5)
"""Log odds of a single claim with a ΔBIC of −100, and their change with every further claim and with every
factor of ten in ΔBIC."""


def features(delta_bic: float, claims: int) -> FloatArray:
    """Features of a claim in which its log odds are linear.

    Args:
        delta_bic: ΔBIC of the claim.
        claims: number of claims of the diagnosis.

    Returns:
        Features in the order of ``WEIGHTS``, (3,).
    """
    return np.array([1.0, claims - 1.0, np.log10(max(-delta_bic, 10.0) / 100.0)])


def claim_probability(evidence: Evidence, claims: int) -> float:
    """Probability that a claim of a diagnosis is right.

    Args:
        evidence: evidence for the claim.
        claims: number of claims of the diagnosis.

    Returns:
        Probability from 0 to 1.
    """
    odds = np.array(WEIGHTS) @ features(evidence.delta_bic, claims)
    return float(1.0 / (1.0 + np.exp(-odds)))
