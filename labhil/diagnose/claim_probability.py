"""How probable it is that a named effect is really there.

Evidence compares what is in the catalogue. Another term may stand in for the right one, and does so the more
easily the more terms there are and the more is left unexplained. So the probability that a claim (the term or
one of its listed rivals) is right is a logistic function of three things that a diagnosis knows of itself; a
term's own is that times its share of the structures visited. Its weights were fitted, as
``labhil trial calibrate`` does, to 78 claims, of which 91 % were right: of the first 12 trials with effects
each of axis, ball and beam and DC motor (``labhil trial make --effects some --seed 733``) and 24 of the motor
(``labhil trial benchmark --seed 30112``). What is stated is scored on other trials. Of an arm, where each
joint makes claims of its own and real ones never reach the floor, evidence alone counts.
"""

from __future__ import annotations

import numpy as np

from labhil.diagnose.evidence import Evidence
from labhil.signals import FloatArray

WEIGHTS = (3.8, -3.8, -1.4, 1.2)
"""Log odds of a single claim with a ΔBIC of −100 that leaves nothing but noise, and their change with the
logarithm of what is left, with every further claim, and with every factor of ten in ΔBIC."""

MOST_EXCESS = 3.0


def features(delta_bic: float, excess: float, claims: int) -> FloatArray:
    """What the log odds of one of so many ``claims`` are linear in, (4,).

    ``excess`` is what is left: RMSE over the noise floor of the worst output.
    """
    strength = np.log10(max(-delta_bic, 10.0) / 100.0)
    return np.array([1.0, np.log(np.clip(excess, 1.0, MOST_EXCESS)), claims - 1.0, strength])


def claim_probability(evidence: Evidence, excess: float, claims: int) -> float:
    """Probability that one of so many ``claims`` is right; ``excess`` is what is left, over the floor."""
    odds = np.array(WEIGHTS) @ features(evidence.delta_bic, excess, claims)
    return float(1.0 / (1.0 + np.exp(-odds)))
