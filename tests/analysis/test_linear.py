"""Baselines against systems whose answers are known, and against statsmodels and scipy."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from statsmodels.tsa.ar_model import AutoReg
from statsmodels.tsa.arima.model import ARIMA

from labhil.errors import RecordingError, UnknownNameError
from labhil.identify.linear import (
    BASELINES,
    Orders,
    Sampled,
    figures_of,
    fit_linear,
    linear_study,
    study_json,
    study_text,
)
from labhil.identify.linear.baselines import dead_time
from labhil.identify.linear.filters import stabilise, stable_polynomial, unconstrained_parameters
from labhil.identify.linear.polynomial import PolynomialModel, fit_box_jenkins
from labhil.identify.linear.study import resample_evenly
from labhil.identify.linear.transfer_function import TransferFunctionModel
from labhil.physics.record import Record
from labhil.signals import FloatArray, Hold

PERIOD = 0.01
MOTOR = [31.9], [1.0, 34.41, 39.77]  # the reference text's eq. 5.1
MOTOR_POLES = np.sort(np.roots(MOTOR[1]))


def held_levels(n: int, seed: int, hold: int = 40) -> FloatArray:
    levels = np.linspace(-5, 5, 11)[np.random.default_rng(seed).integers(0, 11, n // hold + 1)]
    return np.repeat(levels, hold)[:n]


def motor(n: int = 2000, noise: float = 0.05, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Voltage and speed of a linear motor with an offset, sampled; the voltage is held."""
    u = held_levels(n, seed)
    b, a, _ = signal.cont2discrete(MOTOR, PERIOD, method="zoh")
    y = signal.lfilter(b[0], a, u) + 0.7
    return u, y + noise * np.random.default_rng(seed + 1).standard_normal(n)


CASES = {
    "transfer_function": (Orders(2, 1), 0.04),
    "state_space": (Orders(2, 2), 0.25),
    "oe": (Orders(2, 2), 0.1),
    "box_jenkins": (Orders(2, 2), 0.1),
    "hammerstein_wiener": (Orders(2, 2, degree=2), 0.1),
    "armax": (Orders(2, 2, noise=2), 0.15),
}


@pytest.mark.extended
@pytest.mark.parametrize("name", CASES)
def test_poles_of_a_known_system_are_found(name: str) -> None:
    u, y = motor()
    orders, tolerance = CASES[name]
    model = fit_linear(name, u, y, PERIOD, orders)
    poles = np.sort(model.poles.real)
    assert poles[1] == pytest.approx(MOTOR_POLES[1], rel=0.03)
    assert poles[0] == pytest.approx(MOTOR_POLES[0], rel=tolerance)
    fresh_u, fresh_y = motor(seed=5)
    figures = figures_of(fresh_y, model.simulate(fresh_u, fresh_y))
    assert figures.rmse == pytest.approx(0.05, rel=0.05)
    assert figures.r2 > 0.99
    assert model.describe()


@pytest.mark.extended
@pytest.mark.parametrize("name", BASELINES)
def test_without_noise_the_free_run_is_the_output(name: str) -> None:
    u, y = motor(1500, noise=0.0)
    orders = Orders(2, 1) if name == "transfer_function" else Orders(2, 2, noise=1, degree=1)
    model = fit_linear(name, u, y, PERIOD, orders)
    fresh_u, fresh_y = motor(1500, noise=0.0, seed=7)
    figures = figures_of(fresh_y, model.simulate(fresh_u, fresh_y))
    assert figures.rmse < 2e-4
    at_rest = model.simulate(fresh_u)
    assert np.abs(at_rest - fresh_y)[500:].max() < (0.01 if name == "narx" else 1e-3)


@pytest.mark.extended
def test_the_transfer_function_is_the_one_that_made_the_data() -> None:
    u, y = motor(2000, noise=0.0)
    model = fit_linear("transfer_function", u, y, PERIOD, Orders(2, 1))
    found = model.parameters
    for name, value in (("n0", 31.9), ("d1", 34.41), ("d0", 39.77), ("offset", 0.7)):
        assert found[name] == pytest.approx(value, rel=1e-4)


@pytest.mark.parametrize("hold", [Hold.ZERO, Hold.LINEAR])
@pytest.mark.parametrize(
    "system", [([4.0], [1.0, 2.0]), ([1.0, 3.0], [1.0, 0.8, 9.0]), ([2.0], [1.0, 6.0, 11.0, 6.0])]
)
def test_a_transfer_function_is_simulated_exactly(
    hold: Hold, system: tuple[list[float], list[float]]
) -> None:
    num, den = (np.array(part) for part in system)
    model = TransferFunctionModel(Orders(len(den) - 1, len(num)), 0.05, hold, num, den, 0.0, 0.0)
    u = np.random.default_rng(3).standard_normal(200)
    expected = signal.lsim(system, u, 0.05 * np.arange(200), interp=hold is Hold.LINEAR)[1]
    np.testing.assert_allclose(model.simulate(u, expected[:50]), expected, atol=1e-9)


def test_a_straight_input_is_told_from_a_held_one() -> None:
    t = PERIOD * np.arange(2500)
    u = np.interp(t, t[::25], np.random.default_rng(4).standard_normal(100))
    y = signal.lsim(MOTOR, u, t)[1]
    straight = fit_linear("transfer_function", u, y, PERIOD, Orders(2, 1), Hold.LINEAR)
    np.testing.assert_allclose(np.sort(straight.poles.real), MOTOR_POLES, rtol=1e-4)
    held = fit_linear("transfer_function", u, y, PERIOD, Orders(2, 1), Hold.ZERO)
    assert held.loss > 100 * straight.loss
    space = fit_linear("state_space", u, y, PERIOD, Orders(2), Hold.LINEAR)
    np.testing.assert_allclose(np.sort(space.poles.real), MOTOR_POLES, rtol=1e-3)
    assert space.parameters["d"] > 0


def test_resonances_and_integrators_are_found() -> None:
    u = held_levels(3000, 2, 20)
    shaky = [1.0, -2 * 0.98 * np.cos(0.3), 0.98**2]
    y = signal.lfilter([0.0, 0.1], shaky, u) + 0.2 * np.random.default_rng(1).standard_normal(3000)
    expected = np.log(0.98) / PERIOD + 0.3j / PERIOD
    for name in ("oe", "state_space", "transfer_function"):
        poles = fit_linear(name, u, y, PERIOD, Orders(2, 2)).poles
        assert abs(poles[-1] - expected) < 0.01 * abs(expected)
    integral = np.cumsum(u - u.mean()) * PERIOD
    model = fit_linear("oe", u, np.append(0.0, integral[:-1]), PERIOD, Orders(1, 1))
    assert abs(model.poles[0]) < 1e-3


def test_arx_is_statsmodels_autoregression_with_an_input() -> None:
    u, y = motor(800)
    ours = fit_linear("arx", u, y, PERIOD, Orders(2, 2)).parameters
    exog = np.column_stack((np.append(0.0, u[:-1]), np.append([0.0, 0.0], u[:-2])))
    theirs = AutoReg(y, lags=2, trend="c", exog=exog).fit().params
    constant, y1, y2, u1, u2 = theirs
    found = [ours["a1"], ours["a2"], ours["b1"], ours["b2"], ours["offset"]]
    np.testing.assert_allclose(found, [-y1, -y2, u1, u2, constant / (1 - y1 - y2)], rtol=1e-6)


def test_noise_polynomials_are_statsmodels_arma() -> None:
    u, y = motor(1000, noise=0.0)
    noise = signal.lfilter([1.0, 0.5], [1.0, -0.8], np.random.default_rng(8).standard_normal(1000))
    model = fit_box_jenkins(Sampled(u, y + 0.1 * noise, PERIOD), Orders(2, 2, noise=1))
    theirs = ARIMA(y + 0.1 * noise - model.simulate(u), order=(1, 0, 1), trend="n").fit()
    assert model.parameters["d1"] == pytest.approx(-theirs.params[0], abs=0.02)
    assert model.parameters["c1"] == pytest.approx(theirs.params[1], abs=0.02)
    assert model.loss == pytest.approx(theirs.mse, rel=0.01)
    left = (y + 0.1 * noise) - model.predict(u, y + 0.1 * noise)
    assert float(np.mean(left[50:] ** 2)) == pytest.approx(0.01, rel=0.1)


def test_noise_that_drifts_does_not_carry_the_offset_away() -> None:
    u, y = motor(1500, noise=0.0)
    y = y + 0.02 * np.cumsum(np.random.default_rng(4).standard_normal(1500))
    model = fit_linear("box_jenkins", u, y, PERIOD, Orders(2, 2))
    assert model.parameters["d1"] < -0.95
    assert np.abs(model.simulate(u, y) - y).max() < 2.0


def test_armax_finds_the_moving_average() -> None:
    u = held_levels(4000, 1, 10)
    e = 0.3 * np.random.default_rng(2).standard_normal(4000)
    a, b, c = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5], [1.0, -0.6]
    y = signal.lfilter(b, a, u) + signal.lfilter(c, a, e)
    found = fit_linear("armax", u, y, PERIOD, Orders(2, 2, noise=1)).parameters
    expected = {"a1": -1.5, "a2": 0.7, "b1": 1.0, "b2": 0.5, "c1": -0.6}
    assert {name: found[name] for name in expected} == pytest.approx(expected, abs=0.05)


def test_bent_lines_on_both_sides_are_followed() -> None:
    def bent(n: int, seed: int) -> tuple[FloatArray, FloatArray]:
        u = held_levels(n, seed, 15)
        x = signal.lfilter([0.0, 0.2], [1.0, -0.8], np.sign(u) * np.maximum(np.abs(u) - 2.0, 0.0))
        return u, np.tanh(0.7 * x) + 0.01 * np.random.default_rng(seed).standard_normal(n)

    u, y = bent(2000, 1)
    model = fit_linear("hammerstein_wiener", u, y, PERIOD, Orders(1, 1, degree=6))
    straight = fit_linear("oe", u, y, PERIOD, Orders(1, 1))
    fresh_u, fresh_y = bent(2000, 2)
    ours = figures_of(fresh_y, model.simulate(fresh_u, fresh_y)).rmse
    assert ours < 0.07
    assert ours < 0.4 * figures_of(fresh_y, straight.simulate(fresh_u, fresh_y)).rmse


def test_terms_of_a_nonlinear_recursion_are_found() -> None:
    u = np.random.default_rng(3).uniform(-1, 1, 1500)
    y = np.zeros(1500)
    for t in range(2, 1500):
        y[t] = 0.5 * y[t - 1] - 0.3 * y[t - 1] * u[t - 1] + u[t - 1] + 0.4 * u[t - 2] ** 2
    model = fit_linear("narx", u, y, PERIOD, Orders(1, 2, degree=2))
    assert figures_of(y, model.simulate(u, y)).rmse < 1e-6
    assert len(model.poles) == 0


def test_a_run_without_bounds_has_no_finite_error() -> None:
    u = np.random.default_rng(3).uniform(0.1, 1, 300)
    y = np.cumsum(u) ** 2
    model = fit_linear("narx", u, y, PERIOD, Orders(1, 1, degree=2))
    far = model.simulate(1e9 * u, y)
    assert figures_of(y, far).r2 == -np.inf


@given(st.lists(st.floats(-8, 8), min_size=1, max_size=6))
@settings(max_examples=60, deadline=None)
def test_denominators_are_stable_whatever_is_tried(theta: list[float]) -> None:
    # roots that fall together are known to the sixth root of a rounding error only
    f = stable_polynomial(np.array(theta))
    assert np.abs(np.roots(f)).max() < 1 + 5e-3
    mild = stable_polynomial(np.clip(theta, -2, 2))
    np.testing.assert_allclose(stable_polynomial(unconstrained_parameters(mild)), mild, atol=1e-6)
    mirrored = stabilise(np.append(1.0, np.array(theta)))
    assert np.abs(np.roots(mirrored)).max(initial=0.0) < 1 + 5e-3


def test_an_unstable_regression_still_runs_freely() -> None:
    u = held_levels(400, 3, 20)
    y = signal.lfilter([0.0, 0.1], [1.0, -1.003], u)
    model = fit_linear("arx", u, y, PERIOD, Orders(1, 1))
    assert isinstance(model, PolynomialModel)
    assert np.abs(np.roots(model.f)).max() < 1
    assert np.isfinite(model.simulate(np.tile(u, 50))).all()


def test_dead_time_is_found() -> None:
    u, y = motor()
    assert dead_time(Sampled(u, y, PERIOD)) == 0
    assert dead_time(Sampled(u[8:], y[:-8], PERIOD)) == 8


@pytest.mark.parametrize("name", ["arx", "oe", "state_space", "transfer_function"])
def test_orders_are_chosen_from_the_data(name: str) -> None:
    u, y = motor(1500)
    model = fit_linear(name, u, y, PERIOD)
    fresh_u, fresh_y = motor(1500, seed=9)
    assert figures_of(fresh_y, model.simulate(fresh_u, fresh_y)).rmse < 0.058
    if name != "arx":  # least squares needs many poles for white noise on the output
        assert model.orders.poles == 2


def record_of(u: FloatArray, y: FloatArray, t: FloatArray | None = None) -> Record:
    times = PERIOD * np.arange(len(u)) if t is None else t
    return Record(
        times,
        u[:, None],
        np.column_stack((y, -y)),
        ("voltage",),
        ("speed", "current"),
        ("rad/s", "A"),
        (Hold.ZERO,),
    )


def test_a_study_has_a_row_for_each_model_and_output() -> None:
    train, test = record_of(*motor(1500)), record_of(*motor(1500, seed=3))
    said: list[str] = []
    rows = linear_study(train, test, ("arx", "oe"), Orders(2, 2), said.append)
    assert [(row.model.name, row.channel) for row in rows] == [
        (name, channel) for channel in ("speed", "current") for name in ("arx", "oe")
    ]
    assert said[0] == "arx: speed"
    assert rows[1].test.r2 > 0.99
    assert rows[1].test.rmse == pytest.approx(0.05, rel=0.1)
    text = "\n".join(study_text(rows))
    assert "speed [rad/s]" in text
    assert "oe: y = [" in text
    plain = json.loads(json.dumps(study_json(rows), allow_nan=False))
    assert plain[1]["test"]["rmse"] == rows[1].test.rmse
    assert plain[1]["parameters"].keys() == {"b1", "b2", "f1", "f2", "offset"}


def test_an_uneven_record_is_put_onto_a_grid() -> None:
    t = np.sort(np.random.default_rng(1).uniform(0, 10, 4000))
    t = np.append(t[np.append(True, np.diff(t) > 1e-4)], 10.0)
    u = np.where(np.sin(t) > 0, 1.0, -1.0)
    data = resample_evenly(record_of(u, np.sin(3 * t), t), 0, PERIOD)
    grid = t[0] + PERIOD * np.arange(len(data))
    assert grid[-1] == pytest.approx(10.0, abs=PERIOD)
    np.testing.assert_allclose(data.y, np.sin(3 * grid), atol=1e-3)
    assert set(data.u) == {-1.0, 1.0}


def test_wrong_use_is_told() -> None:
    u, y = motor(200)
    with pytest.raises(UnknownNameError, match=r"baseline 'arxx' does not exist.*did you mean 'arx'"):
        fit_linear("arxx", u, y, PERIOD)
    with pytest.raises(RecordingError, match="60 samples or more"):
        fit_linear("arx", u[:10], y[:10], PERIOD)
    with pytest.raises(RecordingError, match="this one is constant"):
        fit_linear("arx", np.ones(200), y, PERIOD)
    with pytest.raises(RecordingError, match="finite samples"):
        fit_linear("arx", u, np.where(y > 0, np.nan, y), PERIOD)
    with pytest.raises(ValueError, match="2 poles has fewer zeros, found 2"):
        fit_linear("transfer_function", u, y, PERIOD, Orders(2, 3))
    with pytest.raises(ValueError, match="poles must be 1 at least"):
        Orders(0)
    two = Record(np.arange(100.0), np.ones((100, 2)), np.ones((100, 1)), ("a", "b"), ("y",), ("m",))
    with pytest.raises(RecordingError, match="takes one input, found 2: a, b"):
        linear_study(two, two)
