"""The share of the error that an answer explains, and the regime of the rest."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.diagnose.remainder import find_remainder
from labhil.identify.score import score
from labhil.physics.ball_beam import BallBeamModel
from labhil.physics.model import index_of, start_values
from labhil.physics.record import Record, Windows
from labhil.rig import parse_rig

TRUE = {"viscous_friction.coefficient": 0.25, "coulomb_friction.level": 0.02}


@pytest.fixture
def rig(tmp_path):
    return parse_rig('[rig]\nkind = "ball_beam"\n', tmp_path / "rig.toml")


def theta_of(model, values):
    theta = start_values(model.parameters)
    places = index_of(model.parameters)
    for key, value in values.items():
        theta[places[key]] = value
    return theta


def recorded(rig, disturbed):
    """Twelve seconds of a ball with dry friction, its reading off by a bump where ``disturbed`` says so."""
    t = 0.01 * np.arange(1200)
    angle = sum(0.02 * w * np.cos(w * t) for w in (1.3, 2.1, 3.4, 5.5))
    record = Record(t, angle[:, None], np.zeros((1200, 1)), ("beam_angle",), ("ball_position",), ("m",))
    model = BallBeamModel(rig, record)
    whole = Windows.of([(0, 1200)])
    theta = theta_of(model, TRUE)
    start = np.zeros((1, len(model.state_names)))
    along = model.coordinates(theta, record, whole, start)
    noise = 1e-4 * np.random.default_rng(3).standard_normal(1200)
    position = model.simulate(theta, record, whole, start)[:, 0] + noise + disturbed(along)
    return Record(t, record.inputs, position[:, None], ("beam_angle",), ("ball_position",), ("m",))


def remainder(rig, record, names=("coulomb_friction",)):
    model = BallBeamModel(rig, record)
    sigma = np.array([1e-4])
    before = score(model, theta_of(model, {**TRUE, "coulomb_friction.level": 0.0}), record, sigma, 2.0)
    after = score(model, theta_of(model, TRUE), record, sigma, 2.0)
    return find_remainder(names, model, theta_of(model, TRUE), record, before, after)


def test_only_noise_remains_beside_a_complete_answer(rig):
    found = remainder(rig, recorded(rig, lambda along: 0.0))
    assert found.explained > 0.99
    assert found.noise_floors < 1.1
    assert found.is_noise
    assert found.regimes == ()
    assert found.statement.startswith("coulomb_friction explains 100 % of the error in ball_position")
    assert found.statement.endswith("what remains is noise.")


def test_the_remaining_error_is_stated_with_its_size_and_regime(rig):
    def bump(along):
        return np.where(np.abs(along["ball_velocity"]) < 0.02, 2e-3, 0.0)

    found = remainder(rig, recorded(rig, bump))
    assert 0.5 < found.explained < 0.9999
    assert found.noise_floors > 1.5
    assert not found.is_noise
    assert {regime.coordinate for regime in found.regimes} == {"ball_velocity"}
    assert any(regime.low < 0.0 < regime.high for regime in found.regimes)
    assert "noise floors remain" in found.statement
    assert "near reversals" in found.statement


def test_not_all_is_explained_where_an_error_remains(rig):
    record = recorded(rig, lambda along: 2e-4 * np.sin(40.0 * along["ball_position"]))
    found = remainder(rig, record)
    assert found.explained > 0.995
    assert not found.is_noise
    assert "explains over 99 % of the error" in found.statement


def test_there_is_no_remainder_without_named_effects(rig):
    assert remainder(rig, recorded(rig, lambda along: 0.0), names=()) is None
