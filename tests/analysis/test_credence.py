"""Calibrated probabilities of claims, and effective numbers of samples."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.diagnose.claim_probability import claim_probability
from labhil.diagnose.evidence import independent_samples
from labhil.identify.table import _with_min_width
from labhil.physics.terms import Parameter


def test_further_claims_make_a_claim_doubtful():
    assert 0.9 < claim_probability(1) < 0.99
    assert claim_probability(1) > claim_probability(2) > claim_probability(3) > 0.5


def test_a_profile_that_ends_at_an_edge_reaches_as_far_as_curvature_says():
    free = Parameter("mass", "kg", 1.0, 0.2, 9.0)
    assert _with_min_width((0.9, 1.1), (0.85, 1.15), free) == (0.85, 1.15)
    assert _with_min_width((0.7, 1.6), (0.8, 1.2), free) == (0.7, 1.6)
    assert _with_min_width((0.9, 1.1), (-1.0, 3.0), free) == (0.2, 3.0)


def test_correlated_residuals_count_as_fewer_samples():
    white = np.random.default_rng(1).standard_normal((4000, 1))
    assert independent_samples(white) == pytest.approx(4000, rel=0.1)
    assert independent_samples(np.repeat(white[::4], 4, axis=0)) < 0.3 * 4000
