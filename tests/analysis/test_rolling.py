"""The rolling kernel against analytic solutions, and against the plant, which shares no code with it."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.identify.problem import Problem
from labhil.identify.window_states import evaluate, fit_states, rescue_states
from labhil.physics import input_path, rolling
from labhil.physics.ball_beam import BallBeamModel
from labhil.physics.model import index_of, start_values, starts_of
from labhil.physics.record import Record, Windows
from labhil.plants.ball_beam import BallBeamPlant

T = 0.01 * np.arange(301)
GRAVITY = 9.81 * 5 / 7


def roll(k, angle, state=(0.0, 0.0), t=T):
    out = np.empty((len(t), 2))
    first, last = np.array([0]), np.array([len(t)])
    crank = np.full(len(t), angle) if np.isscalar(angle) else angle
    rolling.simulate(t, t, crank, 1.0, first, last, np.array([state]), k, out)
    return out


def kernel(**values):
    k = np.zeros(rolling.SIZE)
    k[rolling.STRIBECK_VELOCITY] = 0.01
    for name, value in values.items():
        k[getattr(rolling, name.upper())] = value
    return k


def test_a_frictionless_ball_falls_as_galilei_says():
    out = roll(kernel(gravity=GRAVITY), 0.02)
    assert np.allclose(out[:, 0], 0.5 * GRAVITY * np.sin(0.02) * T**2, atol=1e-12)


def test_viscous_friction_decays_exponentially():
    out = roll(kernel(gravity=GRAVITY, viscous=1.5), 0.0, (0.0, 0.3))
    assert np.allclose(out[:, 1], 0.3 * np.exp(-1.5 * T), atol=1e-7)
    assert np.allclose(out[:, 0], 0.2 * (1 - np.exp(-1.5 * T)), atol=1e-7)


def test_dry_friction_stops_the_ball_dead_and_it_stays():
    out = roll(kernel(gravity=GRAVITY, coulomb=0.4), 0.0, (0.0, 0.5))
    stop = 0.5 / 0.4
    moving = stop > T
    assert np.allclose(out[moving, 1], 0.5 - 0.4 * T[moving], atol=1e-9)
    assert np.all(out[~moving, 1] == 0.0)
    assert np.allclose(out[~moving, 0], 0.5 * stop / 2, atol=1e-9)
    assert np.ptp(out[~moving, 0]) == 0.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_break_away_is_an_event_at_the_right_moment(side):
    ramp = side * 0.05 * T
    out = roll(kernel(gravity=GRAVITY, coulomb=0.3, static=0.2), ramp)
    leaves = np.arcsin(0.5 / GRAVITY) / 0.05
    assert np.all(out[leaves >= T, 0] == 0.0)
    # released, it is driven by what exceeds Coulomb friction: ẍ = g·sin(0.05·t) − 0.3
    t = T[leaves < T]
    swing = (np.sin(0.05 * leaves) - np.sin(0.05 * t)) / 0.05 + np.cos(0.05 * leaves) * (t - leaves)
    expected = side * (GRAVITY / 0.05 * swing - 0.15 * (t - leaves) ** 2)
    assert np.allclose(out[leaves < T, 0], expected, atol=1e-7)


def test_every_term_is_neutral_at_zero_and_shows_at_its_start(model: BallBeamModel, acquire):
    record = acquire(["viscous_friction", "coulomb_friction"], 3, duration=12.0)
    windows, places = Windows.of([(0, 600), (600, 1200)]), index_of(model.parameters)
    theta = start_values(model.parameters)
    theta[places["viscous_friction.coefficient"]] = 0.3
    theta[places["coulomb_friction.level"]] = 0.09
    states = model.initial_states(record, windows)
    plain = model.simulate(theta, record, windows, states)
    for term in model.terms.values():
        if term.name in ("viscous_friction", "coulomb_friction"):
            continue
        neutral = theta.copy()
        for parameter in term.parameters:
            neutral[places[parameter.name]] = parameter.neutral
        assert np.array_equal(model.simulate(neutral, record, windows, states), plain), term.name
        begun = theta.copy()
        for name, value in starts_of(model, (term,), record)[-1].items():
            begun[places[name]] = value or 0.1 * model.parameters[places[name]].scale
        assert np.abs(model.simulate(begun, record, windows, states) - plain).max() > 1e-6, term.name


BASE = ("viscous_friction", "coulomb_friction", "stribeck_friction")


@pytest.mark.parametrize(
    ("extra", "tolerance"),
    [
        ((), 5e-5),
        (("static_friction",), 5e-5),
        (("constant_force",), 5e-5),
        (("spring_force",), 5e-5),
        (("time_delay",), 5e-5),
        (("dead_zone",), 5e-5),
        (("actuator_lag",), 4e-4),
        (("backlash",), 4e-4),
    ],
)
def test_model_and_plant_agree_though_they_share_no_code(model: BallBeamModel, acquire, extra, tolerance):
    """On the plant's own truth, from initial states that are fitted to it, over six seconds."""
    terms = (*BASE, *extra)
    parameters = {"time_delay.delay": 0.0437} if "time_delay" in terms else {}
    driven = acquire(terms, 1, parameters=parameters, duration=19.0)
    plant = BallBeamPlant(parameters, terms, 1)
    truth = plant.simulate(driven.inputs[:, 0]).position
    record = Record(driven.t, driven.inputs, truth[:, None], ("servo_angle",), ("ball_position",), ("m",))
    theta, places = start_values(model.parameters), index_of(model.parameters)
    for name, value in plant.parameters.items():
        if name in places and name.partition(".")[0] in terms:
            theta[places[name]] = value
    windows = Windows.of([(500, 1100), (1200, 1800)])
    none = np.empty(0, dtype=np.int64)
    problem = Problem(model, record, windows, none, theta, np.array([1e-4]))
    guess = model.initial_states(record, windows)
    fitted = evaluate(problem, np.empty(0), fit_states(problem, np.empty(0), guess, iterations=20))
    states = rescue_states(problem, np.empty(0), fitted).states
    error = model.simulate(theta, record, windows, states)[:, 0] - truth[windows.rows]
    assert np.sqrt(np.mean(error**2)) < tolerance


def test_way_in_by_hand():
    t = np.arange(5.0)
    u = np.array([0.0, 1.0, 0.0, -1.0, 0.0])
    times, values = input_path.dead_zone(t, u, 0.5, 0.25)
    assert np.allclose(np.interp([0.25, 1.0, 1.75, 2.5, 3.0], times, values), [0.0, 0.75, 0.0, 0.0, -0.5])
    times, values = input_path.backlash(t, u, 0.4)
    assert np.allclose(np.interp([0.2, 1.0, 1.4, 3.0, 3.4], times, values), [0.0, 0.8, 0.8, -0.8, -0.8])
    times, values = input_path.saturation(t, u, 2.0)
    assert np.allclose(np.interp([0.5, 1.0, 1.5, 2.75], times, values), [0.5, 0.5, 0.5, -0.5])
    times, values = input_path.rate_limit(t, u, 2.0)
    assert np.allclose(np.interp([0.0, 1.0, 4.0 / 3.0, 2.0], times, values), [0.0, 0.5, 2.0 / 3.0, 1.0 / 3.0])
    step = np.array([0.0, 1.0, 1.0, 1.0, 1.0])
    lagged = input_path.first_order_lag(t, step, 0.5)
    assert np.allclose(lagged[1:], 1.0 - 0.5 * (1 - np.exp(-2.0)) * np.exp(-2.0 * (t[1:] - 1.0)))
