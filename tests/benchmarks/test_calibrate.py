"""Stated probabilities follow the trials that they are fitted to."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import expit

from labhil.diagnose.claim_probability import WEIGHTS as CALIBRATED
from labhil.diagnose.claim_probability import claim_probability, features
from labhil.errors import UsageError
from labhil_benchmarks.trials.calibrate import Claimed, calibrate, claimed_in

WEIGHTS = np.array([2.0, -0.8])


def claims(count: int, seed: int) -> list[Claimed]:
    random = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        own = features(int(random.integers(1, 4)))
        found.append(Claimed(own, bool(random.random() < expit(WEIGHTS @ np.array(own)))))
    return found


def test_weights_are_found_again_within_their_errors():
    fitted = calibrate(claims(4000, 1))
    assert fitted.claims == 4000
    assert np.all(np.abs(fitted.weights - WEIGHTS) < 3.5 * fitted.errors)
    assert np.all(fitted.errors < 0.35)


def test_a_few_claims_that_are_all_right_have_finite_weights():
    every = [Claimed(claim.features, True) for claim in claims(12, 2)]
    fitted = calibrate(every)
    assert (fitted.claims, fitted.right) == (12, 12)
    assert np.all(np.isfinite(fitted.weights[1:]))


def test_what_is_fitted_is_what_is_stated():
    assert claim_probability(1) == pytest.approx(expit(CALIBRATED[0]))
    assert claim_probability(3) == pytest.approx(expit(CALIBRATED[0] + 2.0 * CALIBRATED[1]))


def test_nothing_claimed_and_an_arm_are_refused(tmp_path):
    with pytest.raises(UsageError, match="found none"):
        calibrate([])
    (tmp_path / "trials.json").write_text(
        '{"schema": "labhil.trials/1", "rig": "ur5", "fixed_seed": true, "trials": []}'
    )
    with pytest.raises(UsageError, match="found an arm"):
        claimed_in(tmp_path)
