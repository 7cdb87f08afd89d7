"""The conclusion of a search: a model that predicts worse than the baseline is no answer."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import replay

from labhil.diagnose.adequacy import residual_rms
from labhil.diagnose.begin import fit_baseline, prepare_data
from labhil.diagnose.conclude import conclude
from labhil.diagnose.evidence import Evidence
from labhil.diagnose.search_result import SearchResult, Step
from labhil.identify.fitted import fit_terms
from labhil.identify.windows import split
from labhil.physics.model import index_of


@pytest.mark.parametrize("spoilt", [False, True])
def test_claims_that_predict_worse_on_every_length_are_withdrawn(spoilt: bool) -> None:
    t = np.arange(3000) * 0.01
    force = 60.0 * np.sin(1.9 * t) + 40.0 * np.sin(5.3 * t)
    friction = {"coulomb_friction.level": 8.0}
    made = replay("axis", force, ("viscous_friction", "coulomb_friction"), friction, seed=3)
    searched, held_out = split(made.record, 0.3, made.model.horizon)
    data = prepare_data(made.model, searched, held_out)
    base = fit_baseline(data, ["viscous_friction"])
    final = fit_terms(
        data.model, data.search, ["viscous_friction", "coulomb_friction"], data.window, data.sigma,
        start=base.theta, starts=[{}],
    )  # fmt: skip
    if spoilt:  # a fit that went astray after it was compared
        theta = final.theta.copy()
        theta[index_of(data.model.parameters)["coulomb_friction.level"]] = 60.0
        final = replace(final, theta=theta)
    step = Step(("coulomb_friction",), Evidence(-99.0, 1e-9, 20.0), 1e-9, 0.99)
    result = SearchResult(base, final, (step,), (), 1e-9, 20)
    conclusion = conclude(data, result, residual_rms(data, final), lambda text: None)
    named = [claim.terms[0] for claim in conclusion.result.missing]
    assert named == ([] if spoilt else ["coulomb_friction"])
    assert conclusion.result.final is (base if spoilt else final)
    assert conclusion.excess_remains == spoilt
    assert conclusion.after.rmse <= conclusion.before.rmse
