"""The conclusion of a search: which claims stand."""

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
from labhil.diagnose.conclude import Conclusion, conclude, withdraw_claims
from labhil.diagnose.evidence import Evidence
from labhil.diagnose.judge import Data
from labhil.diagnose.search_result import SearchResult, Step
from labhil.identify.fitted import Fitted, fit_terms
from labhil.identify.windows import split
from labhil.physics.model import index_of


def with_dry_friction(*further: str, **values: float) -> tuple[Data, Fitted, Fitted]:
    """An axis with dry friction and more, without and with dry friction in the model."""
    t = np.arange(3000) * 0.01
    force = 60.0 * np.sin(1.9 * t) + 40.0 * np.sin(5.3 * t)
    terms = ("viscous_friction", "coulomb_friction")
    sizes = {"coulomb_friction.level": 8.0, **{key.replace("__", "."): v for key, v in values.items()}}
    made = replay("axis", force, (*terms, *further), sizes, seed=3)
    searched, held_out = split(made.record, 0.3, made.model.horizon)
    data = prepare_data(made.model, searched, held_out)
    base = fit_baseline(data, ["viscous_friction"])
    final = fit_terms(
        data.model, data.search, terms, data.window, data.sigma, start=base.theta, starts=[{}]
    )  # fmt: skip
    return data, base, final


def concluded(data: Data, base: Fitted, final: Fitted, delta_bic: float) -> Conclusion:
    step = Step(("coulomb_friction",), Evidence(delta_bic, 1e-9, 20.0), 1e-9, 0.99)
    result = SearchResult(base, final, (step,), (), 1e-9, 20)
    return conclude(data, result, residual_rms(data, final), lambda text: None)


@pytest.mark.parametrize("spoilt", [False, True])
def test_claims_that_predict_worse_on_every_length_are_withdrawn(spoilt: bool) -> None:
    data, base, final = with_dry_friction()
    if spoilt:  # a fit that went astray after it was compared
        theta = final.theta.copy()
        theta[index_of(data.model.parameters)["coulomb_friction.level"]] = 60.0
        final = replace(final, theta=theta)
    conclusion = concluded(data, base, final, -99.0)
    named = [claim.terms[0] for claim in conclusion.result.missing]
    assert named == ([] if spoilt else ["coulomb_friction"])
    assert conclusion.result.final is (base if spoilt else final)
    assert conclusion.excess_remains == spoilt
    assert conclusion.after.rmse <= conclusion.before.rmse


@pytest.mark.parametrize("grown", [False, True])
def test_a_claim_that_leaves_as_large_an_error_is_doubtful(grown: bool) -> None:
    """Beside a spring that no term stands for, a claim stays where held-out errors of the metric fall."""
    data = with_dry_friction("spring_force", spring_force__stiffness=50.0)
    conclusion = concluded(*data, -20.0)
    assert conclusion.after.excess > 3.0
    assert conclusion.claims == ("coulomb_friction",)
    if grown:  # on windows of the metric alone: those of the search show a smaller error with it
        conclusion = replace(conclusion, before=conclusion.after, after=conclusion.before)
        assert not conclusion.predicts_worse
    conclusion = withdraw_claims(conclusion, lambda text: None)
    assert conclusion.claims == ("coulomb_friction",) * (not grown)
    assert conclusion.result.doubtful == ("coulomb_friction",) * grown
    assert conclusion.excess_remains
