"""Bias by model discrepancy: intervals of an incomplete model contain the true values."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.diagnose.discrepancy import absent_effects, discrepancy_shifts
from labhil.identify.fitted import fit_terms
from labhil.identify.statistics import ALPHA_QUANTILE
from labhil.identify.table import table_of
from labhil.identify.windows import noise_of

SEEDS = (1, 2, 3)
KEY = "viscous_friction.coefficient"
TRUE = 0.5

MISSING = {
    "coulomb_friction.level": 0.003,
    "quadratic_viscous_friction.coefficient": 0.3,
    "spring_force.stiffness": 0.05,
    "time_delay.delay": 0.02,
    "actuator_lag.time_constant": 0.03,
}
MISSING_DRY = {"position_noise": 1e-4, KEY: TRUE, "coulomb_friction.level": 0.003}


def estimate(model, acquire, missing: str | None, seed: int) -> tuple[float, float, float]:
    """The baseline's estimate, its standard error, and by how much what is left may have moved it."""
    terms = ["viscous_friction", *([missing.partition(".")[0]] if missing else [])]
    values = {"position_noise": 1e-4, KEY: TRUE} | ({missing: MISSING[missing]} if missing else {})
    record = acquire(terms, seed, parameters=values, duration=15.0)
    fitted = fit_terms(model, record, ("viscous_friction",), 2.0, noise_of(record))
    (row,) = [row for row in table_of(fitted).rows if row.key == KEY]
    return row.value, row.std_error, discrepancy_shifts(absent_effects(fitted)).get(KEY, 0.0)


@pytest.mark.extended
@pytest.mark.parametrize("missing", MISSING)
def test_an_interval_of_an_incomplete_model_contains_the_true_value(model, acquire, missing: str) -> None:
    for seed in SEEDS:
        value, error, moved = estimate(model, acquire, missing, seed)
        assert abs(value - TRUE) > ALPHA_QUANTILE * error  # the fit alone is sure of what is wrong
        assert abs(value - TRUE) < ALPHA_QUANTILE * np.hypot(error, moved)
        assert moved < 0.5 * TRUE


def test_known_estimates_do_not_shift(model, acquire) -> None:
    record = acquire(("viscous_friction", "coulomb_friction"), 1, parameters=MISSING_DRY, duration=15.0)
    fitted = fit_terms(model, record, ("viscous_friction",), 2.0, noise_of(record))
    assert set(discrepancy_shifts(absent_effects(fitted))) == set(fitted.estimates)
    assert KEY not in discrepancy_shifts(absent_effects(fitted), known={KEY})


def test_estimates_of_a_complete_model_do_not_shift(model, acquire) -> None:
    assert [estimate(model, acquire, None, seed)[2] for seed in SEEDS] == [0.0] * len(SEEDS)
