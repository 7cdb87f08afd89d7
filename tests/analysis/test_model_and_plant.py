"""The model's terms one by one against the plant, which shares no code with it, and against brute force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labhil.physics import driven, input_path
from labhil.physics.ball_beam import BallBeamModel
from labhil.physics.model import index_of, start_values
from labhil.physics.record import Record, Windows
from labhil.plants.ball_beam import BallBeamPlant

MASS = 0.261 * 1.4
DRY = ("viscous_friction", "coulomb_friction", "stribeck_friction")
FIRST, LONG = 500, 600

# the plant's parameters, and the model's where it names them otherwise
CASES: dict[str, tuple[tuple[str, ...], dict[str, float], dict[str, float], float]] = {
    "bare": ((), {}, {}, 1e-5),
    "viscous": (("viscous_friction",), {}, {}, 1e-5),
    "coulomb": (("coulomb_friction",), {}, {}, 1e-4),
    "stribeck": (DRY, {}, {}, 1e-4),
    "wide stribeck": (DRY, {"stribeck_friction.velocity": 0.1}, {}, 1e-5),
    "static": ((*DRY, "static_friction"), {}, {}, 1e-4),
    "quadratic": (("quadratic_viscous_friction",), {}, {}, 1e-5),
    "cubic": (("cubic_viscous_friction",), {}, {}, 1e-5),
    "asymmetric": (("friction_asymmetry",), {"friction_asymmetry.level": 0.0}, {}, 1e-5),
    "slope": (("coulomb_friction", "position_dependent_friction"), {}, {}, 1e-5),
    "push": (("coulomb_friction", "constant_force"), {}, {}, 2e-4),
    "spring": (("viscous_friction", "spring_force"), {}, {}, 1e-5),
    "inertia": (("viscous_friction", "added_inertia"), {}, {}, 1e-5),
    "whole delay": (("viscous_friction", "time_delay"), {"time_delay.delay": 0.05}, {}, 1e-5),
    "odd delay": (("viscous_friction", "time_delay"), {"time_delay.delay": 0.0437}, {}, 1e-5),
    "dead zone": (("viscous_friction", "dead_zone"), {}, {}, 1e-5),
    "saturation": (
        ("viscous_friction", "saturation"),
        {"saturation.limit": 0.25},
        {"saturation.inverse_limit": 4.0},
        1e-5,
    ),
    "rate limit": (
        ("viscous_friction", "rate_limit"),
        {"rate_limit.rate": 1.5},
        {"rate_limit.inverse_rate": 1 / 1.5},
        1e-5,
    ),
    "backlash": (("viscous_friction", "backlash"), {}, {}, 1e-5),
    "lag": (("viscous_friction", "actuator_lag"), {}, {}, 1e-4),
    "bent sensor": (("viscous_friction", "sensor_nonlinearity"), {}, {}, 1e-5),
    "sensor gain": (("viscous_friction", "sensor_gain"), {}, {}, 1e-5),
}


@pytest.mark.parametrize("case", CASES)
def test_model_and_plant_agree_from_the_same_state_without_any_fit(model: BallBeamModel, acquire, case):
    """Six seconds from the plant's own state, on angles of a controller that answers noise.

    The plant cuts a sample period into moments, the model finds the bends of the way in where they are:
    so near a bend they differ by a little more.
    """
    terms, values, own, tolerance = CASES[case]
    record, state, theta = replayed(model, acquire, terms, values, own)
    windows = Windows.of([(FIRST, FIRST + LONG)])
    measured = record.outputs[windows.rows]
    error = np.abs(model.simulate(theta, record, windows, state) - measured)
    assert error.max() < tolerance, f"{error.max():.2g} m after {0.01 * error.argmax():.2f} s"
    if len(terms) > 0 and terms != ("viscous_friction",):
        without, place = start_values(model.parameters), index_of(model.parameters)
        viscous = place["viscous_friction.coefficient"]
        without[viscous] = theta[viscous] if len(terms) > 1 else 0.0
        error = np.abs(model.simulate(without, record, windows, state) - measured)
        assert error.max() > 10.0 * tolerance, "the terms matter"


def replayed(
    model: BallBeamModel, acquire, terms: tuple[str, ...], values: dict[str, float], own: dict[str, float]
) -> tuple[Record, np.ndarray, np.ndarray]:
    """The plant's motion without noise, its state at FIRST, and its numbers as the model's vector."""
    driven = acquire(terms, 1, parameters=values, duration=0.01 * (FIRST + LONG))
    # the same angles once more give the same motion, this time with the truth beside the counts
    plant = BallBeamPlant(values, terms)
    truth = plant.simulate(driven.inputs[:, 0])
    assert np.abs(truth.position).max() < 0.24, "away from the stops"
    seen = (1.0 + plant.sensor.gain) * (truth.position + plant.sensor.cubic * truth.position**3)
    record = replace(driven, outputs=seen[:, None])
    theta, places = start_values(model.parameters), index_of(model.parameters)
    for name, value in {**plant.parameters, **own}.items():
        if name in places and name.partition(".")[0] in terms:
            theta[places[name]] = value
    # the model's state is v + (J/R)/(M + J/R² + …)·β̇, which a corner of the crank does not change
    kick = 0.4 * 0.261 * 0.02 / (MASS + plant.parameters.get("added_inertia.mass", 0.0))
    rate = tilt_rate_before(record.t[FIRST], *model._effective_angle(theta, record))
    return record, np.array([[truth.position[FIRST], truth.velocity[FIRST] + kick * rate]]), theta


def tilt_rate_before(now: float, nodes: np.ndarray, angle: np.ndarray) -> float:
    """β̇ as the crank arrives at ``now``, from its nodes."""
    i = int(np.searchsorted(nodes, now, side="left"))
    turning = (angle[i] - angle[i - 1]) / (nodes[i] - nodes[i - 1])
    here = np.interp(now, nodes, angle)
    sine = 0.2 * np.sin(here)
    return float(0.2 * np.cos(here) * turning / np.sqrt(1.0 - sine**2))


def walked(u: list[float], times: np.ndarray, step) -> np.ndarray:
    """A way in that is followed in very small moments, and what it gave at ``times``."""
    fine = np.linspace(0.0, len(u) - 1.0, 4000 * (len(u) - 1) + 1)
    wanted = np.interp(fine, np.arange(len(u)), u)
    out, y = np.empty_like(fine), wanted[0]
    for i, value in enumerate(wanted):
        y = step(y, value, 1.0 / 4000.0)
        out[i] = y
    return np.interp(times, fine, out)


def play(gap: float):
    return lambda y, u, h: min(max(y, u - gap / 2), u + gap / 2)


def slew(rate: float):
    return lambda y, u, h: min(max(u, y - rate * h), y + rate * h)


WAYS = {
    "backlash": (input_path.backlash, play, 0.4),
    "rate_limit": (lambda t, u, rate: input_path.rate_limit(t, u, 1.0 / rate), slew, 0.7),
}
SIGNAL = st.lists(st.floats(-2.0, 2.0, allow_subnormal=False), min_size=3, max_size=6)


@pytest.mark.parametrize("name", WAYS)
@settings(max_examples=15, deadline=None)
@given(signal=SIGNAL)
def test_what_remembers_bends_where_small_moments_say(name, signal):
    effect, law, size = WAYS[name]
    t = np.arange(float(len(signal)))
    times, values = effect(t, np.array(signal), size)
    assert np.all(np.diff(times) >= 0.0)
    assert set(t) <= set(times)
    looked = np.linspace(0.0, len(signal) - 1.0, 97)
    assert np.allclose(np.interp(looked, times, values), walked(signal, looked, law(size)), atol=4e-3)


STATIC = {
    "dead_zone": (
        lambda t, u: input_path.dead_zone(t, u, 0.3, 0.5),
        lambda u: np.maximum(u - 0.5, 0.0) + np.minimum(u + 0.3, 0.0),
    ),
    "saturation": (lambda t, u: input_path.saturation(t, u, 1.25), lambda u: np.clip(u, -0.8, 0.8)),
}


@pytest.mark.parametrize("name", STATIC)
@settings(max_examples=60, deadline=None)
@given(signal=SIGNAL)
def test_what_has_no_memory_is_its_curve_at_every_moment(name, signal):
    effect, curve = STATIC[name]
    t, u = np.arange(float(len(signal))), np.array(signal)
    times, values = effect(t, u)
    looked = np.linspace(0.0, len(signal) - 1.0, 97)
    assert np.allclose(np.interp(looked, times, values), curve(np.interp(looked, t, u)), atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(signal=SIGNAL, lag=st.floats(0.05, 5.0), parts=st.integers(1, 6))
def test_a_lag_is_exact_however_finely_it_is_cut(signal, lag, parts):
    t, u = np.arange(float(len(signal))), np.array(signal)
    whole = input_path.first_order_lag(t, u, lag)
    cut = input_path.first_order_lag(*input_path.refine_for_decay(t, u, lag, parts), lag)
    assert np.allclose(cut[::parts], whole, atol=1e-12)
    assert whole[0] == u[0]
    assert np.all((whole >= u.min() - 1e-12) & (whole <= u.max() + 1e-12))


@pytest.mark.parametrize("time_constant", [1e-3, 1e-2, 0.1, 0.5, 2.0])
def test_a_lag_keeps_the_mean_squared_rate_of_its_decay_however_short_it_is(time_constant):
    # a ball feels the square of the beam's rate: one kink from rate 0 to 1 is rounded off by 1 − e^(−t/T)
    t, y = driven.lag_without_jumps(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.0, 1.0]), time_constant)
    behind = t >= 1.0
    squared_rate = float(np.sum(np.diff(y[behind]) ** 2 / np.diff(t[behind])))
    decay = np.exp(-1.0 / time_constant)
    exact = 1.0 - 2.0 * time_constant * (1.0 - decay) + 0.5 * time_constant * (1.0 - decay**2)
    assert squared_rate == pytest.approx(exact, abs=0.02 * (1.0 - exact))


@settings(max_examples=30, deadline=None)
@given(signal=SIGNAL)
def test_neutral_ways_in_change_nothing(signal):
    t, u = np.arange(float(len(signal))), np.array(signal)
    neutral = (
        input_path.backlash(t, u, 0.0),
        input_path.dead_zone(t, u, 0.0, 0.0),
        input_path.saturation(t, u, 0.0),
        input_path.rate_limit(t, u, 0.0),
        (t, input_path.first_order_lag(t, u, 0.0)),
    )
    for times, values in neutral:
        assert np.allclose(np.interp(t, times, values), u, atol=1e-12)
