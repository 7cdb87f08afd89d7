"""What is named explains a part of the mismatch that counts, in the outputs that it acts on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labhil.diagnose.evidence import Evidence
from labhil.diagnose.judge import Data
from labhil.diagnose.minor import LEAST_SHARE, without_minor
from labhil.diagnose.search_result import SearchResult, Step
from labhil.diagnose.structures.enumerate import relevance
from labhil.diagnose.structures.marginal import WeightedProducts, build_gram_matrices
from labhil.identify.fitted import fit_terms, start_theta
from labhil.identify.windows import noise_of

BASELINE = ("viscous_friction",)
WINDOW = 2.0


def test_what_remains_in_outputs_that_a_term_does_not_change_is_not_held_against_it() -> None:
    without, remains = np.array([5.0, 90.0]), np.array([2.0, 90.0])
    acts = np.array([True, False])
    assert relevance(without, remains, acts) == pytest.approx(3.0 / (2.0 - 1.1**2))
    assert relevance(without, remains, np.array([True, True])) < 0.05
    # where no slope says which, all of them
    assert relevance(without, remains, np.array([False, False])) == relevance(
        without, remains, np.array([True, True])
    )


def test_what_responses_leave_of_each_output_is_what_least_squares_leave() -> None:
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
    left = ((target[:, 0] - fitted).reshape(n, outputs) ** 2).sum(axis=0) * outputs / (n - 1 - 1)
    assert seen.residual_mean_squares([1]) == pytest.approx(left, rel=1e-6)
    assert seen.affects[:, 1].tolist() == [True, True, False]


def found_with(model, record, sizes) -> tuple[Data, SearchResult]:
    """What a search would have found that named these terms."""
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


def test_a_term_in_the_noise_that_explains_next_to_nothing_beside_a_large_one_is_not_named(
    model, acquire
) -> None:
    data, found = found_with(
        model, beside_dry_friction(acquire, 5e-4), ("coulomb_friction", "constant_force")
    )
    kept = without_minor(data, found)
    assert [step.terms for step in kept.missing] == [("coulomb_friction",)]
    ((minor),) = kept.minor
    assert minor.term == "constant_force"
    # about as a fit without it leaves: dry friction is not linear
    alone = kept.final.mean_squares - found.final.mean_squares
    share = float(alone[0] / (found.baseline.mean_squares - found.final.mean_squares)[0])
    assert 0.5 * share < minor.share < 2.0 * share
    assert minor.share < LEAST_SHARE
    assert alone[0] < 1.0


def test_what_stands_out_of_the_noise_is_named_however_large_the_rest(model, acquire) -> None:
    data, found = found_with(
        model, beside_dry_friction(acquire, 2e-5), ("coulomb_friction", "constant_force")
    )
    assert without_minor(data, found).missing == found.missing


def test_where_nothing_lasts_beside_what_was_found_its_laws_are_not_imperfect(model, acquire) -> None:
    data, found = found_with(
        model, beside_dry_friction(acquire, 5e-4), ("coulomb_friction", "constant_force")
    )
    adequate = replace(found, disturbed=False)
    assert without_minor(data, adequate) is adequate


def test_of_one_term_or_where_a_search_was_cut_short_all_stays(model, acquire) -> None:
    values = {"coulomb_friction.level": 0.05}
    record = acquire(("viscous_friction", "coulomb_friction"), 4, parameters=values, duration=20.0)
    data, found = found_with(model, record, ("coulomb_friction",))
    assert without_minor(data, found).missing == found.missing
    cut = replace(found, complete=False)
    assert without_minor(data, cut) is cut
