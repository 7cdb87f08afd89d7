"""Variance between likely structures in the errors of the final parameter table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labhil.diagnose.final_table import _with_bias
from labhil.diagnose.search_result import Alternative, SearchResult
from labhil.identify.fitted import fit_terms
from labhil.identify.table import table_of
from labhil.identify.windows import noise_of

KEY = "viscous_friction.coefficient"


@pytest.fixture(scope="module")
def found(model, acquire) -> SearchResult:
    """A search that ended at the baseline."""
    values = {"viscous_friction.coefficient": 0.5, "position_noise": 1e-4}
    record = acquire(("viscous_friction",), 6, parameters=values, duration=20.0)
    fitted = fit_terms(model, record, ("viscous_friction",), 2.0, noise_of(record))
    return SearchResult(fitted, fitted, (), (), 1.0, 1)


def test_the_variance_between_structures_is_added_to_that_within(found: SearchResult) -> None:
    (row,) = [row for row in table_of(found.final).rows if row.key == KEY]
    apart = 3.0 * row.std_error
    others = (Alternative(0.8, {KEY: row.value}), Alternative(0.2, {KEY: row.value + apart}))
    wider = _with_bias(row, replace(found, alternatives=others), 2.0, 0.0)
    assert wider.value == row.value
    assert wider.std_error == pytest.approx(np.hypot(2.0 * row.std_error, np.sqrt(0.2) * apart))
    assert wider.ci99[0] < row.ci99[0] < row.ci99[1] < wider.ci99[1]


def test_structures_without_a_parameter_do_not_count(found: SearchResult) -> None:
    own = found.final.estimates[KEY]
    others = (Alternative(0.5, {}), Alternative(0.5, {KEY: 1.1 * own}))
    assert replace(found, alternatives=others).between_structures(KEY) == pytest.approx(0.1 * own)
    assert replace(found, alternatives=others).between_structures("nothing.of_the_kind") == 0.0
    assert found.between_structures(KEY) == 0.0
