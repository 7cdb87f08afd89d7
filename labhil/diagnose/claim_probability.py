"""Calibrated probability of a claim: how likely is it that a named effect is really there?

Evidence compares only terms of the catalogue. A wrong term may substitute the right one, the more easily the
more terms are named. The probability that a claim (the term or one of its listed rivals) is right is
therefore a logistic regression on the number of claims; the probability of a term itself is that times its
share of the structures visited, by their evidence.

The weights were fitted to the 116 claims, 110 of them right, of 82 trials with effects, of the DC motor
(``labhil trial make --effects some --seed 281874`` and ``281890``, ``--effects 1 --disturbed force --seed
281875``), the axis (``281880``) and the solenoid (``281882``): 3.27 ± 0.68 and −0.41 ± 0.55. Two more
features were tried on trials before and add nothing: the logarithm of the error that remains over its floor
(−0.1 ± 1.6: beside a random force much remains, and claims are as often right) and that of the evidence
(−0.1 ± 0.7 for each factor of ten in ΔBIC). Each joint of an arm has claims of its own, so that each of them
counts alone.
"""

from __future__ import annotations

from scipy.special import expit

WEIGHTS = (3.3, -0.4)
"""Log odds of a single claim, and their change with every further claim."""


def features(claims: int) -> tuple[float, float]:
    """Features of a claim in which its log odds are linear, in the order of ``WEIGHTS``.

    Args:
        claims: number of claims of the diagnosis.
    """
    return 1.0, claims - 1.0


def claim_probability(claims: int) -> float:
    """Probability that a claim of a diagnosis is right.

    Args:
        claims: number of claims of the diagnosis.

    Returns:
        Probability from 0 to 1.
    """
    return float(expit(sum(weight * value for weight, value in zip(WEIGHTS, features(claims), strict=True))))
