"""Forces that repeat along the way: at which orders a fit begins that does not know them yet."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.identify.fit import Options, fit
from labhil.identify.fitted import Fitted, fit_terms
from labhil.identify.waves import OrderScan, starts_for_added_terms
from labhil.identify.windows import noise_of
from labhil.physics.model import index_of
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


def scan_of(fitted: Fitted) -> OrderScan:
    """A scan over the orders of a fit, and the same with each order simulated."""
    term = fitted.problem.model.terms["cogging_torque"]
    assert term.order is not None
    return OrderScan.of(fitted, term, term.order)


@pytest.mark.extended
@pytest.mark.parametrize("kind, orders", [("dc_motor", (1.5, 16.4)), ("axis", (70.0, 431.0))])
def test_a_response_is_the_one_that_is_simulated(kind, orders):
    """With dry friction among the terms, and rests: to first order in the wave, whose size is 0.1 scales."""
    fitted = without_waves(kind, recorded(kind, 7.0 if kind == "dc_motor" else 331.0, 3))
    fast = scan_of(fitted)
    assert fast.transitions is not None
    slow = replace(fast, transitions=None)
    for order in orders:
        simulated = slow.responses(order)
        error = np.linalg.norm(fast.responses(order) - simulated) / np.linalg.norm(simulated)
        assert error < 0.1


def with_values(fitted: Fitted, **values: float) -> Fitted:
    """The fit with other values of some parameters, at its own residuals for these."""
    problem, theta = fitted.problem, fitted.theta.copy()
    places = index_of(problem.model.parameters)
    for key, value in values.items():
        theta[places[key]] = value
    residuals = problem.residuals_at(theta, fitted.solution.point.states)
    return replace(fitted, theta=theta, solution=replace(fitted.solution, residuals=residuals))


@pytest.mark.extended
def test_a_response_behind_a_lag_of_the_sensor_is_the_one_that_is_simulated():
    fitted = with_values(
        without_waves("axis", recorded("axis", 331.0, 3)), **{"sensor_lag.time_constant": 0.2}
    )
    fast = scan_of(fitted)
    assert fast.transitions is not None
    simulated = replace(fast, transitions=None).responses(70.0)
    error = np.linalg.norm(fast.responses(70.0) - simulated) / np.linalg.norm(simulated)
    prompt = np.linalg.norm(replace(fast, lag=0.0).responses(70.0) - simulated) / np.linalg.norm(simulated)
    assert error < 0.1 < prompt


@pytest.mark.extended
def test_a_model_that_remembers_more_than_its_states_is_simulated():
    """The bend of bristles begins anew with each window, and so with each step."""
    fitted = without_waves("axis", recorded("axis", 331.0, 3))
    bristles = {"presliding_friction.length": 1e-3, "coulomb_friction.level": 15.0}
    assert scan_of(fitted).transitions is not None
    assert scan_of(with_values(fitted, **bristles)).transitions is None


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
