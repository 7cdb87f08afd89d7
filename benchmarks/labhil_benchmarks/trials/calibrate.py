"""``labhil trial calibrate``: how probable a claim is, fitted to trials whose answers are open.

A logistic regression of whether a claim was right on what a diagnosis knows of itself: see
``labhil.diagnose.claim_probability``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from labhil.campaign.trials.answer import Answer
from labhil.campaign.trials.folder import Results, read_index
from labhil.campaign.trials.judge import MIN_DETECTABLE_GAIN, is_right_name
from labhil.campaign.trials.make import answers_beside
from labhil.campaign.trials.score import open_sealed_answer
from labhil.campaign.trials.stated_answer import read_stated_answer
from labhil.diagnose.claim_probability import WEIGHTS, features
from labhil.errors import UsageError
from labhil.signals import FloatArray

RIDGE = 0.1
"""Of all weights but the constant: a few dozen claims that are all right would have it infinite."""


@dataclass(frozen=True, slots=True)
class Claimed:
    """A claim by its features (2), and whether it, or one of the rivals beside it, was right."""

    features: tuple[float, float]
    right: bool


@dataclass(frozen=True, slots=True)
class Fitted:
    """Weights (2,) with their standard errors (2,), and how many claims they were fitted to."""

    weights: FloatArray
    errors: FloatArray
    claims: int
    right: int


def claimed_in(folder: Path) -> list[Claimed]:
    """All claims of the diagnoses in a folder of trials, whose answers lie beside it.

    UsageError where results are missing, and of an arm, where only the evidence counts.
    """
    index, results = read_index(folder), Results(folder)
    if index.rig == "ur5":
        raise UsageError(f"{folder}: expected another rig, found an arm: of it only the evidence counts")
    claims: list[Claimed] = []
    for entry in index.trials:
        claims += _claims(open_sealed_answer(entry, answers_beside(folder)), results.path_of(entry.name))
    return claims


def _claims(answer: Answer, path: Path) -> list[Claimed]:
    stated = read_stated_answer(path)
    if not stated.named:
        return []
    detectable = [effect for effect in answer.effects if effect.oracle_gain >= MIN_DETECTABLE_GAIN]
    own = features(len(stated.named))
    return [
        Claimed(own, any(is_right_name(effect, name) for effect in detectable for name in named.names))
        for named in stated.named
    ]


def calibrate(claims: Sequence[Claimed]) -> Fitted:
    """The weights of maximum likelihood; UsageError where nothing was claimed."""
    if not claims:
        raise UsageError("expected trials in which something was named, found none")
    table = np.array([claim.features for claim in claims])
    signs = np.array([1.0 if claim.right else -1.0 for claim in claims])
    ridge = RIDGE * np.r_[0.0, np.ones(len(WEIGHTS) - 1)]

    def unlikely(weights: FloatArray) -> float:
        return float(np.sum(np.logaddexp(0.0, -signs * (table @ weights))) + 0.5 * ridge @ weights**2)

    weights = minimize(unlikely, np.array(WEIGHTS)).x
    p = expit(table @ weights)
    information = (table * (p * (1.0 - p))[:, None]).T @ table + np.diag(ridge + 1e-9)
    errors = np.sqrt(np.diag(np.linalg.inv(information)))
    return Fitted(weights, errors, len(claims), sum(claim.right for claim in claims))
