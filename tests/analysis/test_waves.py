"""Forces that repeat along the way: at which orders a fit begins that does not know them yet."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from labhil.identify.fit import Options, fit
from labhil.identify.fitted import Fitted, fit_terms
from labhil.identify.waves import starts_for_added_terms
from labhil.identify.windows import noise_of
from labhil.physics.rigs import rig_model

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import Replay, replay, staircase


def recorded(kind: str, order: float, seed: int) -> Replay:
    """A plant with waves of an order, driven by a staircase."""
    if kind == "dc_motor":
        period, u = 0.01, staircase(20.0, 0.01, 0.4, 4.0, seed)
        size, noise = 0.03, {"speed_noise": 0.02, "current_noise": 1e-3}
    else:
        period, u = 0.005, staircase(20.0, 0.005, 0.3, 80.0, seed)
        size, noise = 1.8, {"position_noise": 5e-6}
    values = {"cogging_torque.amplitude": size, "cogging_torque.order": order, "cogging_torque.phase": 0.7}
    terms = (*rig_model(kind).baseline, "cogging_torque")
    return replay(kind, u, terms, values, noise=noise, period=period, seed=seed)


def without_waves(kind: str, found: Replay) -> Fitted:
    """The baseline's fit."""
    model, record = found.model, found.record
    return fit_terms(model, record, rig_model(kind).baseline, model.horizon, noise_of(record))


@pytest.mark.extended
@pytest.mark.parametrize("kind, orders", [("dc_motor", (5.3, 16.4)), ("axis", (150.0, 431.0))])
def test_an_order_that_nobody_knows_is_among_the_starts(kind, orders):
    for seed, order in enumerate(orders):
        found = recorded(kind, order, seed)
        starts = starts_for_added_terms(without_waves(kind, found), ["cogging_torque"])
        proposed = [values["cogging_torque.order"] for values in starts]
        assert min(abs(k - order) for k in proposed) < 0.03 * order, proposed


@pytest.mark.extended
@pytest.mark.parametrize(
    "kind, order", [("dc_motor", 7.3), pytest.param("axis", 331.0, marks=pytest.mark.extended)]
)
def test_a_fit_finds_the_order_by_itself(kind, order):
    found = recorded(kind, order, 5)
    terms = (*rig_model(kind).baseline, "cogging_torque")
    answer = fit(found.model, found.record, terms, options=Options(estimator="nlse", seed=1))
    (told,) = [row for row in answer.estimates if row.name == "cogging_torque.order"]
    assert told.value == pytest.approx(order, rel=0.01)
    assert answer.fitted.noise < 1.2
