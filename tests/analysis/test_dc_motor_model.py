"""The DC motor's model against the plant, which shares no code with it, and against its own symmetries."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from labhil.identify.problem import Point, Problem
from labhil.physics.dc_motor import DcMotorModel
from labhil.physics.model import index_of, start_values
from labhil.physics.record import Record, Windows
from labhil.rig import default_rig
from labhil.signals import Hold

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import disagreement, distance, places_of, replay, rig_of, staircase, without

DRY = ("viscous_friction", "coulomb_friction", "stribeck_friction")
VISCOUS = ("viscous_friction",)
WARM = {"heat_capacity": 2.0}
COLD = 1.0 - 0.0039 * 5.0  # the plant's numbers hold at 25 °C, the model's at 20 °C

# the plant's terms and parameters, the model's values where it names them otherwise, and the tolerance
CASES: dict[str, tuple[tuple[str, ...], dict[str, float], dict[str, float], float]] = {
    "bare": ((), {}, {}, 1e-5),
    "coulomb": (("coulomb_friction",), {}, {}, 1e-5),
    "reference text": ((*DRY, "quadratic_viscous_friction", "cubic_viscous_friction"), {}, {}, 1e-5),
    "rising stribeck": (
        DRY,
        {"stribeck_friction.level": 0.1, "stribeck_friction.velocity": 0.1},
        {},
        1e-5,
    ),
    "static": ((*DRY, "static_friction"), {}, {}, 1e-5),
    "asymmetric": ((*VISCOUS, "friction_asymmetry"), {}, {}, 1e-5),
    "along the turn": (
        (*VISCOUS, "coulomb_friction", "position_dependent_friction"),
        {"position_dependent_friction.slope": 0.002},
        {},
        1e-5,
    ),
    # the model takes a sample's temperature for the time up to the next
    "warming grease": (
        (*VISCOUS, "temperature_dependent_friction"),
        WARM,
        {"viscous_friction.coefficient": 0.05 * np.exp(0.02 * 5.0)},
        5e-4,
    ),
    "load": ((*VISCOUS, "constant_force"), {}, {}, 1e-5),
    "cogging": (
        (*VISCOUS, "cogging_torque"),
        {"cogging_torque.phase": 0.4},
        {"cogging_torque.sine": 0.05 * np.cos(0.4), "cogging_torque.cosine": 0.05 * np.sin(0.4)},
        1e-5,
    ),
    "spring": ((*VISCOUS, "spring_force"), {}, {}, 1e-5),
    # both let the brushes' voltage change sign over some mA, each in its own way
    "brushes": ((*VISCOUS, "brush_drop"), {}, {}, 3e-3),
    "sag": ((*VISCOUS, "supply_sag"), {}, {}, 1e-5),
    "warm winding": (
        (*VISCOUS, "thermal_resistance"),
        WARM,
        {"resistance": 1.5 * COLD, "thermal_resistance.coefficient": 0.0039 / COLD},
        1e-3,
    ),
    "delay": ((*VISCOUS, "time_delay"), {"time_delay.delay": 0.0137}, {}, 1e-5),
    "dead zone": ((*VISCOUS, "dead_zone"), {}, {}, 1e-5),
    "saturation": ((*VISCOUS, "saturation"), {}, {"saturation.inverse_limit": 0.25}, 1e-5),
    "backlash": ((*VISCOUS, "backlash"), {}, {}, 1e-5),
    "rate limit": ((*VISCOUS, "rate_limit"), {}, {"rate_limit.inverse_rate": 1 / 60}, 3e-5),
    "lag": ((*VISCOUS, "actuator_lag"), {}, {}, 1e-5),
    "sensor gain": ((*VISCOUS, "sensor_gain"), {}, {}, 1e-5),
    "sensor offset": ((*VISCOUS, "sensor_offset"), {}, {}, 1e-5),
    "bent sensor": ((*VISCOUS, "sensor_nonlinearity"), {}, {}, 1e-5),
    "small inductance": (DRY, {"inductance": 1e-3}, {}, 2e-5),
    "hardly any inductance": (DRY, {"inductance": 1e-4}, {}, 2e-5),
}


@pytest.mark.parametrize("case", CASES)
def test_model_and_plant_agree_though_they_share_no_code(case):
    """Seven and nine seconds from the plant's own states, without any fit."""
    terms, parameters, own, tolerance = CASES[case]
    found = replay("dc_motor", staircase(20.0, 0.01, 0.5, 5.0), terms, parameters, own=own)
    spans = [(300, 1000), (1100, 2000)]
    assert np.all(disagreement(found, spans) < tolerance)
    if set(terms) - set(VISCOUS):
        bare = without(found, [term for term in terms if term not in VISCOUS])
        assert disagreement(bare, spans).max() > 10.0 * tolerance, "the term matters"


def test_a_motor_may_have_to_find_its_angle():
    """Where nothing tells it, it is one more state; no force depends on it, so nothing else changes."""
    found = replay("dc_motor", staircase(8.0, 0.01, 0.5, 5.0), DRY)
    assert found.model.with_place() is found.model
    record = replace(found.record, auxiliary={})
    blind = DcMotorModel(rig_of("dc_motor"), record)
    placed = blind.with_place()
    assert placed.with_place() is placed
    assert [model.moved[0].position for model in (blind, placed)] == ["", "shaft_angle"]
    windows = Windows.of([(100, 300), (400, 700)])
    states = placed.initial_states(record, windows)
    assert states[:, 2] == pytest.approx(found.record.auxiliary["angle"][windows.first], abs=0.02)
    assert np.array_equal(states[:, :2], blind.initial_states(record, windows))
    theta = found.theta[: len(blind.parameters)]
    plain, other = (
        model.simulate(theta, record, windows, s) for model, s in ((blind, states[:, :2]), (placed, states))
    )
    assert np.array_equal(plain, other)
    only = replace(record, outputs=record.outputs[:, 1:], output_names=("current",), output_units=("A",))
    without_speed = DcMotorModel(rig_of("dc_motor"), only)
    assert without_speed.with_place() is without_speed


def test_a_lagging_sensor_agrees_from_rest():
    u = np.concatenate([np.zeros(50), staircase(20.0, 0.01, 0.5, 5.0)])
    found = replay("dc_motor", u, (*VISCOUS, "sensor_lag"))
    # the model lets the speed go straight from sample to sample before the sensor's lag
    assert np.all(disagreement(found, [(0, 2000)]) < 1e-3)


def test_least_squares_scatter_as_the_information_allows():
    """Over several recordings the squared distances from the truth add up to χ²."""
    u = staircase(20.0, 0.01, 0.5, 5.0, 3)
    parameters = {"stribeck_friction.level": 0.1, "stribeck_friction.velocity": 0.3}
    noise = {"speed_noise": 0.03, "current_noise": 0.03}
    total = degrees = 0.0
    for seed in range(4):
        found = replay("dc_motor", u, DRY, parameters, noise=noise, seed=seed)
        far, many = distance(found, DRY, (0.03, 0.03), first=50)
        total, degrees = total + far, degrees + many
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], degrees)
    assert low < total < high


def test_speed_alone_tells_ratios_but_not_sizes():
    """R and L times a, J and torques over a, K as it is: the same speed from the same voltage."""
    found = replay("dc_motor", staircase(10.0, 0.01, 0.5, 5.0), DRY, outputs=("speed",))
    places, theta = index_of(found.model.parameters), found.theta.copy()
    levels = ("viscous_friction.coefficient", "coulomb_friction.level", "stribeck_friction.level")
    for name, power in {"resistance": 1, "inductance": 1, "inertia": -1, **dict.fromkeys(levels, -1)}.items():
        theta[places[name]] *= 3.0**power
    windows = Windows.of([(0, 1000)])
    rest = np.zeros((1, 2))
    same = found.model.simulate(found.theta, found.record, windows, rest)
    assert np.allclose(found.model.simulate(theta, found.record, windows, rest), same, atol=1e-7)


def test_bounds_of_speed_alone_know_ratios_far_better_than_the_torque_constant():
    """With the inertia given, 28 dB and Coulomb friction: K to per cents at best, R·J/K far better."""
    u = staircase(20.0, 0.01, 0.5, 5.0)
    terms = ("viscous_friction", "coulomb_friction")
    found = replay("dc_motor", u, terms, outputs=("speed",), known="inertia = 0.1\n")
    free, windows = places_of(found.model, terms), Windows.of([(0, 2000)])
    sigma = np.array([10 ** (-28 / 20) * found.record.outputs.std()])
    problem = Problem(found.model, found.record, windows, free, found.theta, sigma)
    start = Point(found.theta[free] / problem.scale, np.zeros((1, 2)))
    slopes = problem.linearise(start, problem.residuals(start), central=True)
    relative = problem.project(slopes, slopes.by_parameters) * start.z
    covariance = np.linalg.inv(relative.T @ relative)
    names = [found.model.parameters[i].name for i in free]
    ratio = np.array([{"resistance": 1.0, "torque_constant": -1.0}.get(name, 0.0) for name in names])
    constant = np.sqrt(np.diag(covariance)[names.index("torque_constant")])
    assert constant > 0.02
    assert np.sqrt(ratio @ covariance @ ratio) < 0.5 * constant


@pytest.mark.parametrize(
    ("size", "voltage", "period"),
    [
        ({"inertia": 1e-6, "torque_constant": 0.01, "resistance": 5.0, "inductance": 5e-4}, 6.0, 1e-3),
        ({"inertia": 0.1, "torque_constant": 0.2, "resistance": 1.5, "inductance": 0.1}, 5.0, 0.01),
        ({"inertia": 2.0, "torque_constant": 1.5, "resistance": 0.2, "inductance": 5e-3}, 100.0, 0.01),
    ],
)
def test_starts_fit_motors_of_every_size(size, voltage, period):
    """From the starts alone the model's speed is of the right size, and so is its horizon."""
    friction = {"viscous_friction.coefficient": 0.1 * size["torque_constant"] ** 2 / size["resistance"]}
    u = staircase(1500 * period, period, 150 * period, voltage)
    found = replay("dc_motor", u, VISCOUS, {**size, **friction}, period=period)
    start = start_values(found.model.parameters)
    said = found.model.simulate(start, found.record, Windows.of([(0, 1500)]), np.zeros((1, 2)))
    seen = found.record.outputs
    assert np.all(np.std(said - seen, axis=0) < 0.6 * np.std(seen, axis=0))
    exact = 3.0 * size["inertia"] / (1.1 * size["torque_constant"] ** 2 / size["resistance"])
    assert np.isclose(found.model.horizon_at(found.theta), exact)
    assert exact / 3.0 < found.model.horizon < 3.0 * exact


def test_what_is_known_is_not_estimated_and_what_is_missing_is_said():
    t = 0.01 * np.arange(100)
    record = Record(
        t, np.sin(t)[:, None], np.sin(t)[:, None], ("voltage",), ("speed",), ("rad/s",), (Hold.ZERO,)
    )
    model = DcMotorModel(rig_of("dc_motor", "resistance = 2.0\ninertia = 0.01\n"), record)
    own = [p.name for p in model.parameters if p.term is None]
    assert own == ["torque_constant", "inductance"]
    assert "added_inertia" in model.terms
    assert "added_inertia" not in DcMotorModel(default_rig("dc_motor"), record).terms
    for term, channel in (("cogging_torque", "angle"), ("thermal_resistance", "winding_temperature")):
        assert term not in model.terms
        assert model.unobservable_terms[term] == f"needs {channel}"


def test_from_current_alone_the_speed_is_guessed_by_the_back_emf():
    u = staircase(10.0, 0.01, 0.5, 5.0)
    both = replay("dc_motor", u, VISCOUS)
    alone = replay(
        "dc_motor", u, VISCOUS, outputs=("current",), known="torque_constant = 0.2\nresistance = 1.5\n"
    )
    assert alone.model.terms["sensor_offset"].parameters[0].unit == "A"
    # long after a step, when the current hardly changes
    windows = Windows.of([(349, 500)])
    guess = alone.model.initial_states(alone.record, windows)
    assert np.allclose(guess, both.states[349:350], rtol=0.1, atol=0.2)


def test_offset_and_gain_of_the_currents_sensor():
    found = replay("dc_motor", staircase(5.0, 0.01, 0.5, 5.0), VISCOUS)
    windows, rest = Windows.of([(0, 500)]), np.zeros((1, 2))
    plain = found.model.simulate(found.theta, found.record, windows, rest)
    places, theta = index_of(found.model.parameters), found.theta.copy()
    theta[places["sensor_offset.current_offset"]] = 0.2
    theta[places["sensor_gain.current_gain"]] = 0.1
    bent = found.model.simulate(theta, found.record, windows, rest)
    assert np.allclose(bent[:, 0], plain[:, 0])
    assert np.allclose(bent[:, 1], 1.1 * plain[:, 1] + 0.2)
