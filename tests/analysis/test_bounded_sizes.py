"""A search whose most promising structures need a size beyond its bound goes on with others."""

from __future__ import annotations

import copy
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from labhil.diagnose.begin import fit_baseline, prepare_data
from labhil.diagnose.structures.enumerate import with_disturbance
from labhil.diagnose.structures.search import StructureSearch
from labhil.diagnose.structures.state import SearchState
from labhil.physics.model import Model

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import replay


def chirped(seed: int) -> np.ndarray:
    """Force in N of 10 s at 100 Hz: a sum of four tones."""
    t, random = 0.01 * np.arange(1000), np.random.default_rng(seed)
    tones = zip(random.uniform(20.0, 60.0, 4), (0.3, 0.7, 1.1, 1.9), random.uniform(0.0, 6.0, 4), strict=True)
    return np.sum([a * np.sin(2.0 * np.pi * f * t + phase) for a, f, phase in tones], axis=0)


def with_little_coulomb_friction(model: Model, at_most: float) -> Model:
    bounded = copy.copy(model)
    bounded.__dict__["parameters"] = tuple(
        replace(p, upper=at_most) if p.key == "coulomb_friction.level" else p for p in model.parameters
    )
    return bounded


def test_the_search_goes_on_without_a_term_at_its_bound() -> None:
    plants = [
        replay(
            "axis", chirped(seed), ["viscous_friction", "coulomb_friction"], {"coulomb_friction.level": 10.0},
            noise={"position_noise": 1e-5}, seed=seed,
        )
        for seed in (1, 2)
    ]  # fmt: skip
    model = with_little_coulomb_friction(plants[0].model, 1.0)
    data = prepare_data(model, plants[0].record, plants[1].record)
    baseline = fit_baseline(data, ["viscous_friction"])
    search = StructureSearch(data, baseline.terms, np.zeros(1), lambda text: None)
    state = SearchState(min_relevance=1.0)
    search._record(state, baseline)
    search._linearise(state, frozenset())
    search._refit_promising(state, with_disturbance)
    at_bound = {s: r for s, r in state.refitted.items() if r.at_bound}
    others = {s: r for s, r in state.refitted.items() if s and not r.at_bound}
    assert at_bound and all("coulomb_friction" in r.at_bound for r in at_bound.values())
    assert all(np.isneginf(r.log_evidence) for r in at_bound.values())
    assert others and all(np.isfinite(r.log_evidence) for r in others.values())
    assert max(state.predicted.values(), key=with_disturbance).structure in at_bound
