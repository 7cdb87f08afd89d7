"""Two terms that can replace each other: neither has odds beside the other, and one of them is claimed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labhil.diagnose.begin import fit_baseline, prepare_data
from labhil.diagnose.structures.search import StructureSearch
from labhil.diagnose.structures.state import SearchState, log_odds, supported_terms
from labhil.physics.rigs import model_for
from labhil.rig import default_rig
from labhil_benchmarks.statistics.cases import held_ball

DRY = frozenset({"coulomb_friction", "stribeck_friction"})
TRUTH = {
    "viscous_friction.coefficient": 0.3,
    "stribeck_friction.level": 0.004,
    "stribeck_friction.velocity": 0.03,
}
NOISE, WINDOW, ENOUGH = 1e-3, 4.0, 5.0


def test_of_two_terms_that_replace_each_other_the_stronger_is_supported() -> None:
    """A weak Stribeck friction: it and Coulomb friction explain it, and each makes up for the other."""
    random = np.random.default_rng(2)
    terms = ("viscous_friction", "stribeck_friction")
    records = [held_ball(terms, TRUTH, NOISE * random.standard_normal(2000), phase) for phase in (1.0, 2.5)]
    model = model_for(default_rig("ball_beam"), records[0])
    data = replace(prepare_data(model, records[0], records[1]), window=WINDOW)
    baseline = fit_baseline(data, ["viscous_friction"])
    search = StructureSearch(data, baseline.terms, np.zeros(1), lambda text: None)
    state = SearchState(min_relevance=1.0)
    search._record(state, baseline)
    search._linearise(state, frozenset())
    search._refit_each(state, baseline, [frozenset({"coulomb_friction"}), DRY])
    assert state.best == DRY
    assert all(log_odds(model, state, DRY, term) < ENOUGH for term in DRY)
    supported = supported_terms(model, state, ENOUGH)
    assert set(supported) == {"stribeck_friction"}
    assert supported["stribeck_friction"] > ENOUGH
    assert supported_terms(model, state, 100.0) == {}
