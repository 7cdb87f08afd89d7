"""Calibrated probability of a claim: how likely is it that a named effect is really there?

Evidence compares only terms of the catalogue. A wrong term may substitute the right one, the more easily the
more terms are named and the more error remains. The probability that a claim (the term or one of its listed
rivals) is right is therefore a logistic regression on three features of the diagnosis; the probability of a
term itself is that times its share of the structures visited.

The weights were fitted by ``labhil trial calibrate`` to 78 claims, 91 % of which were right: the first 12
trials with effects each of axis, ball and beam and DC motor (``labhil trial make --effects some --seed 733``)
and 24 of the motor (``labhil trial benchmark --seed 30112``). The stated probabilities are
scored on other trials. Of an arm, where each joint has claims of its own and real recordings never reach the
noise floor, evidence alone counts.
"""

from __future__ import annotations

import numpy as np

from labhil.diagnose.evidence import Evidence
from labhil.signals import FloatArray

WEIGHTS = (3.8, -3.8, -1.4, 1.2)
"""Log odds of a single claim with a ΔBIC of −100 and only noise left, and their change with the logarithm of
the remaining excess, with every further claim, and with every factor of ten in ΔBIC."""


def features(delta_bic: float, excess: float, claims: int, *, max_excess: float = 3.0) -> FloatArray:
    """Features of a claim in which its log odds are linear.

    Args:
        delta_bic: ΔBIC of the claim.
        excess: remaining RMSE over the noise floor, of the worst output.
        claims: number of claims of the diagnosis.
        max_excess: excess from which a larger one makes no difference.

    Returns:
        Features in the order of ``WEIGHTS``, (4,).
    """
    strength = np.log10(max(-delta_bic, 10.0) / 100.0)
    return np.array([1.0, np.log(np.clip(excess, 1.0, max_excess)), claims - 1.0, strength])


def claim_probability(evidence: Evidence, excess: float, claims: int) -> float:
    """Probability that a claim of a diagnosis is right.

    Args:
        evidence: evidence for the claim.
        excess: remaining RMSE over the noise floor, of the worst output.
        claims: number of claims of the diagnosis.

    Returns:
        Probability from 0 to 1.
    """
    odds = np.array(WEIGHTS) @ features(evidence.delta_bic, excess, claims)
    return float(1.0 / (1.0 + np.exp(-odds)))
