"""A named term explains a major part of the mismatch in the outputs that it acts on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labhil.diagnose.evidence import Evidence
from labhil.diagnose.judge import Data
from labhil.diagnose.minor import MIN_EXPLAINED_SHARE, drop_minor_terms
from labhil.diagnose.search_result import SearchResult, Step
from labhil.diagnose.structures.enumerate import relevance
from labhil.diagnose.structures.marginal import WeightedProducts, build_gram_matrices
from labhil.identify.fitted import fit_terms, start_theta
from labhil.identify.windows import noise_of

BASELINE = ("viscous_friction",)
WINDOW = 2.0


def test_residuals_of_outputs_that_a_term_does_not_change_do_not_lower_its_relevance() -> None:
    without, remains = np.array([5.0, 90.0]), np.array([2.0, 90.0])
    acts = np.array([True, False])
    assert relevance(without, remains, acts) == pytest.approx(3.0 / (2.0 - 1.1**2))
    assert relevance(without, remains, np.array([True, True])) < 0.05
    # where no slope says which, all of them
    assert relevance(without, remains, np.array([False, False])) == relevance(
        without, remains, np.array([True, True])
    )


def test_residuals_of_each_output_are_those_of_least_squares() -> None:
    random = np.random.default_rng(3)
    n, outputs = 200, 3
    target, base, response = (random.standard_normal((n * outputs, 1)) for _ in range(3))
    response.reshape(n, outputs)[:, 2] = 0.0
    matrix = np.hstack([target, base, response])
    by_output = matrix.reshape(n, outputs, 3).transpose(1, 0, 2)
    acts = np.any(by_output != 0.0, axis=1)
    seen = build_gram_matrices(
        [WeightedProducts(by_output.transpose(0, 2, 1) @ by_output, 0.0)], 1, acts, n, n, n, np.zeros(1)
    )
    fitted = matrix[:, 1:] @ np.linalg.lstsq(matrix[:, 1:], target[:, 0], rcond=None)[0]
    remaining = ((target[:, 0] - fitted).reshape(n, outputs) ** 2).sum(axis=0) * outputs / (n - 1 - 1)
    assert seen.residual_mean_squares([1]) == pytest.approx(remaining, rel=1e-6)
    assert seen.affects[:, 1].tolist() == [True, True, False]


def search_result_with(model, record, sizes) -> tuple[Data, SearchResult]:
    """The result of a search that names these terms."""
    data = Data(model, record, record, noise_of(record), noise_of(record), WINDOW, start_theta(model))

    def fit(terms):
        return fit_terms(model, record, terms, WINDOW, data.sigma, start=data.begin)

    steps = tuple(Step((term,), Evidence(-99.0, 1e-9, 9.0), 1e-9, True) for term in sizes)
    return data, SearchResult(fit(BASELINE), fit((*BASELINE, *sizes)), steps, (), 1e-9, 2, disturbed=True)


def beside_dry_friction(acquire, noise):
    """Dry friction makes most of the mismatch; a small constant force is in the recording, too."""
    values = {
        "position_noise": noise,
        "adc_bits": 16.0,
        "coulomb_friction.level": 0.03,
        "constant_force.force": 0.0005,
    }
    return acquire(
        ("viscous_friction", "coulomb_friction", "constant_force"), 3, parameters=values, duration=30.0
    )


def test_a_term_below_the_noise_and_minor_beside_a_large_one_is_not_named(model, acquire) -> None:
    data, result = search_result_with(
        model, beside_dry_friction(acquire, 5e-4), ("coulomb_friction", "constant_force")
    )
    kept = drop_minor_terms(data, result)
    assert [step.terms for step in kept.missing] == [("coulomb_friction",)]
    ((minor),) = kept.minor
    assert minor.term == "constant_force"
    # about as a fit without it leaves: dry friction is not linear
    alone = kept.final.mean_squares - result.final.mean_squares
    share = float(alone[0] / (result.baseline.mean_squares - result.final.mean_squares)[0])
    assert 0.5 * share < minor.share < 2.0 * share
    assert minor.share < MIN_EXPLAINED_SHARE
    assert alone[0] < 1.0


def test_a_term_above_the_noise_is_named_however_large_the_others(model, acquire) -> None:
    data, result = search_result_with(
        model, beside_dry_friction(acquire, 2e-5), ("coulomb_friction", "constant_force")
    )
    assert drop_minor_terms(data, result).missing == result.missing


def test_without_a_disturbance_beside_the_named_terms_all_of_them_stay(model, acquire) -> None:
    data, result = search_result_with(
        model, beside_dry_friction(acquire, 5e-4), ("coulomb_friction", "constant_force")
    )
    adequate = replace(result, disturbed=False)
    assert drop_minor_terms(data, adequate) is adequate


def test_a_single_term_and_the_terms_of_an_incomplete_search_stay(model, acquire) -> None:
    values = {"coulomb_friction.level": 0.05}
    record = acquire(("viscous_friction", "coulomb_friction"), 4, parameters=values, duration=20.0)
    data, result = search_result_with(model, record, ("coulomb_friction",))
    assert drop_minor_terms(data, result).missing == result.missing
    cut = replace(result, complete=False)
    assert drop_minor_terms(data, cut) is cut
