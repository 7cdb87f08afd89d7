"""Parts of the data agree on the parameters of a complete model; where they do not, errors are scaled."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.diagnose.contrasts import (
    Contrast,
    contrast_with_held_out,
    contrasts_of_halves,
    refit_on_held_out,
    scale_factor,
)
from labhil.diagnose.judge import Data
from labhil.identify.fitted import Fitted, fit_terms, start_theta
from labhil.identify.table import table_of
from labhil.identify.windows import noise_of

SEEDS = range(1, 7)
KEY = "viscous_friction.coefficient"
TRUE = 0.5


def searched(model, acquire, terms, values, seed) -> tuple[Data, Fitted]:
    """A baseline fitted to one recording of a rig, with another recording held out."""
    record, other = (
        acquire(terms, recording_seed, parameters={"position_noise": 1e-4, KEY: TRUE} | values, duration=15.0)
        for recording_seed in (seed, seed + 100)
    )
    data = Data(model, record, other, noise_of(record), noise_of(other), 2.0, start_theta(model))
    return data, fit_terms(model, record, ("viscous_friction",), 2.0, data.sigma, start=data.begin)


def factor_and_error(data: Data, fitted: Fitted) -> tuple[float, float]:
    """The scale factor, and by how many standard errors the estimate is off."""
    table = table_of(fitted)
    held_out_fit = refit_on_held_out(data, fitted)
    assert held_out_fit is not None
    factor = scale_factor(
        [*contrasts_of_halves(fitted, table), contrast_with_held_out(fitted, held_out_fit, table)]
    )
    (row,) = [row for row in table.rows if row.key == KEY]
    return factor, abs(row.value - TRUE) / row.std_error


@pytest.mark.extended
def test_parts_of_a_complete_models_data_agree(model, acquire) -> None:
    pairs = [factor_and_error(*searched(model, acquire, ("viscous_friction",), {}, s)) for s in SEEDS]
    assert [factor for factor, _ in pairs] == [1.0] * len(SEEDS)


@pytest.mark.extended
def test_where_dry_friction_is_missing_slow_and_fast_windows_disagree(model, acquire) -> None:
    missing = {"coulomb_friction.level": 0.003}
    terms = ("viscous_friction", "coulomb_friction")
    pairs = [factor_and_error(*searched(model, acquire, terms, missing, seed)) for seed in SEEDS]
    assert all(factor > 2.0 for factor, _ in pairs)


@pytest.mark.extended
def test_the_size_of_a_contrast_is_that_of_the_normalised_difference() -> None:
    random = np.random.default_rng(5)
    root = random.standard_normal((3, 3))
    covariance = root @ root.T
    drawn = random.multivariate_normal(np.zeros(3), covariance, 20_000)
    sizes = [Contrast(difference, covariance).chi_square for difference in drawn]
    assert {dof for _, dof in sizes} == {3}
    assert np.mean([size for size, _ in sizes]) == pytest.approx(3.0, abs=0.06)
    unknown = Contrast(np.array([1.0, 9.0, 2.0]), np.diag([1.0, np.inf, 4.0]))
    assert unknown.chi_square == (pytest.approx(2.0), 2)


def test_the_factor_is_that_of_the_parts_that_contradict_each_other_most() -> None:
    agreeing, apart = Contrast(np.array([1.0]), np.eye(1)), Contrast(np.array([5.0]), np.eye(1))
    assert scale_factor([]) == scale_factor([agreeing]) == 1.0
    assert scale_factor([agreeing, apart]) == pytest.approx(5.0)
    # of enough comparisons one is that far apart by chance
    assert scale_factor([Contrast(np.array([3.0]), np.eye(1))] + [agreeing] * 9) == 1.0
