"""Sentences of a diagnosis state the sizes that the data determine, and say of others that they do not."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import replay

from labhil.diagnose.begin import fit_baseline, prepare_data
from labhil.diagnose.evidence import Evidence
from labhil.diagnose.search_result import SearchResult, Step
from labhil.diagnose.statements import missing_term
from labhil.identify.fitted import fit_terms
from labhil.identify.table import table_of
from labhil.identify.windows import split
from labhil.physics.model import index_of

TERMS = ("viscous_friction", "dead_zone")


@pytest.mark.extended
@pytest.mark.parametrize("one_way", [False, True])
def test_a_side_of_a_dead_zone_that_no_command_reaches_has_no_size(one_way: bool) -> None:
    t = np.arange(3000) * 0.01
    force = 60.0 * np.sin(1.9 * t) + 40.0 * np.sin(5.3 * t)
    made = replay("axis", np.abs(force) if one_way else force, TERMS, {}, seed=3)
    searched, held_out = split(made.record, 0.3, made.model.horizon)
    data = prepare_data(made.model, searched, held_out)
    base = fit_baseline(data, ["viscous_friction"])
    final = fit_terms(
        data.model, data.search, TERMS, data.window, data.sigma, start=base.theta, starts=[{}]
    )  # fmt: skip
    step = Step(("dead_zone",), Evidence(-99.0, 1e-9, 20.0), 1e-9, 0.99)
    result = SearchResult(base, final, (step,), (), 1e-9, 20)
    said = missing_term(data.model, step, result, list(table_of(final).rows), 1).statement
    assert ("left is not determined by these data, right = " in said) == one_way
    assert ("left = " in said) != one_way


@pytest.mark.extended
@pytest.mark.parametrize(
    ("level", "words"), [(4.0, "falls from its break-away"), (-4.0, "rises to its full")]
)
def test_a_negative_stribeck_level_is_said_to_be_a_rise(level: float, words: str) -> None:
    terms = ("viscous_friction", "coulomb_friction", "stribeck_friction")
    t = np.arange(3000) * 0.01
    force = 60.0 * np.sin(1.9 * t) + 40.0 * np.sin(5.3 * t)
    sizes = {"coulomb_friction.level": 9.0, "stribeck_friction.level": level}
    made = replay("axis", force, terms, sizes, seed=3)
    searched, held_out = split(made.record, 0.3, made.model.horizon)
    data = prepare_data(made.model, searched, held_out)
    base = fit_baseline(data, ["viscous_friction"])
    start = base.theta.copy()
    start[index_of(data.model.parameters)["stribeck_friction.level"]] = level
    final = fit_terms(data.model, data.search, terms, data.window, data.sigma, start=start, starts=[{}])
    step = Step(("stribeck_friction",), Evidence(-99.0, 1e-9, 20.0), 1e-9, 0.99)
    result = SearchResult(base, final, (step,), (), 1e-9, 20)
    assert words in missing_term(data.model, step, result, list(table_of(final).rows), 1).statement
