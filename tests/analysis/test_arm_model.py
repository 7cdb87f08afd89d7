"""The model of the arm against the simulated arm, which shares no code with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import optimize

from labhil.errors import RecordingError, UnknownNameError
from labhil.identify.fit import fit
from labhil.physics.arm import ArmModel
from labhil.physics.arm.motion import REST_VELOCITY, PreparedRecord
from labhil.physics.model import index_of, start_values, terms_named
from labhil.physics.record import Record, Windows
from labhil.plants.arm import ArmPlant
from labhil.rig import parse_rig

CONSTANTS = [13.26, 11.13, 10.62, 11.03, 11.47, 11.61]
EXACT = {
    "q_noise": 0.0,
    "qd_noise": 0.0,
    "current_noise": 0.0,
    "current_resolution": 0.0,
    "temperature_noise": 0.0,
    "temperature_resolution": 0.0,
}
LENGTHS = """
[[joint]]
d = 0.089159
a = 0.0
alpha = 1.5707963267948966
[[joint]]
d = 0.0
a = -0.425
alpha = 0.0
[[joint]]
d = 0.0
a = -0.39225
alpha = 0.0
[[joint]]
d = 0.10915
a = 0.0
alpha = 1.5707963267948966
[[joint]]
d = 0.09465
a = 0.0
alpha = -1.5707963267948966
[[joint]]
d = 0.0823
a = 0.0
alpha = 0.0
"""
KNOWN = f"[known]\ntorque_constant = {CONSTANTS}\n"
BASELINE = ["viscous_friction", "coulomb_friction"]


def rig(text=KNOWN, folder=Path()):
    return parse_rig('[rig]\nkind = "ur5"\n' + text, folder / "rig.toml")


def plan(seconds, seed, fastest=0.8, rate=125.0):
    """Sines of four frequencies on all joints that swell from rest and die down again."""
    t = np.arange(round(seconds * rate)) / rate
    random = np.random.default_rng(seed)
    w = 2.0 * np.pi * np.array([0.1, 0.23, 0.31, 0.47])
    swell = np.sin(np.pi * t / seconds) ** 2
    phase = random.uniform(0.0, 2.0 * np.pi, (4, 6))
    shape = sum(np.sin(np.outer(t, w[k : k + 1]) + phase[k]) / w[k] for k in range(4))
    q = swell[:, None] * shape
    qd = np.gradient(q, t, axis=0)
    gain = fastest / np.abs(qd).max(axis=0)
    q = np.array([0.2, -1.2, 1.0, -0.5, 0.6, 0.1]) + gain * q
    qd = np.gradient(q, t, axis=0)
    return q, qd, np.gradient(qd, t, axis=0)


def acquired(terms, parameters=None, seconds=16.0, seed=0, warm=True):
    """What the simulated arm reports of a motion, as a model sees it."""
    signals = ArmPlant(parameters or {}, terms, seed=seed).follow(*plan(seconds, seed)).signals()
    t = np.arange(len(signals["actual_q"])) * 0.008
    temperatures = {f"joint_temperatures_{j}": signals["joint_temperatures"][:, j] for j in range(6)}
    return Record(
        t=t,
        inputs=np.hstack([signals["actual_q"], signals["actual_qd"]]),
        outputs=signals["actual_current"],
        input_names=named("actual_q") + named("actual_qd"),
        output_names=named("actual_current"),
        output_units=("A",) * 6,
        output_joints=tuple(range(6)),
        auxiliary=temperatures if warm else {},
    )


def named(signal):
    return tuple(f"{signal}_{j}" for j in range(6))


def simulated(model, theta, record):
    return model.simulate(theta, record, Windows.of([(0, len(record))]), np.empty((1, 0)))


def free_keys(model, terms):
    chosen = {p.key for term in terms_named(model, terms) for p in term.parameters}
    return [p.key for p in model.parameters if p.term is None or p.key in chosen]


def solved(model, record, terms, start=None):
    """Least squares on the linear parameters of these terms: values by key, residuals (n, 6)."""
    linear = {p.key for p in model.parameters if p.linear}
    keys = [key for key in free_keys(model, terms) if key in linear]
    places = [index_of(model.parameters)[key] for key in keys]
    theta = start_values(model.parameters) if start is None else start.copy()
    theta[places] = 0.0
    columns = model.regressor(theta, record, keys)
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    left = (record.outputs - simulated(model, theta, record)).ravel()
    theta[places] = np.linalg.lstsq(columns / size, left, rcond=1e-9)[0] / size
    return theta, record.outputs - simulated(model, theta, record)


def refine(model, record, terms, start, keys):
    """Least squares on ``keys`` with differences, the linear parameters solved within."""
    places = [index_of(model.parameters)[key] for key in keys]
    scale = np.array([model.parameters[i].scale for i in places])

    def residuals(z):
        theta = start.copy()
        theta[places] = z * scale
        return solved(model, record, terms, theta)[1].ravel()

    found = optimize.least_squares(residuals, start[places] / scale, diff_step=1e-4, xtol=1e-6)
    theta = start.copy()
    theta[places] = found.x * scale
    return solved(model, record, terms, theta)[0]


def six(model, theta, name):
    places = index_of(model.parameters)
    return np.array([theta[places[f"{name}[{joint}]"]] for joint in range(6)])


@pytest.fixture(scope="module")
def bare():
    return acquired(BASELINE)


@pytest.fixture(scope="module")
def model(bare):
    return ArmModel(rig(), bare)


@pytest.fixture(scope="module")
def prepared(model, bare):
    return model.prepare(bare)


def everything_on(model, seed=0):
    """A vector with every term away from neutral."""
    random = np.random.default_rng(seed)
    theta = start_values(model.parameters)
    for i, p in enumerate(model.parameters):
        if "." in p.name and not p.shape:
            theta[i] = np.clip(0.2 * p.scale * random.uniform(0.5, 1.0), p.lower, p.upper)
    return theta


def test_keys_tell_joints_apart_and_a_name_means_all_of_them(model):
    keys = [p.key for p in model.parameters]
    assert len(keys) == len(set(keys))
    assert [t.key for t in terms_named(model, ["coulomb_friction"])] == [
        f"coulomb_friction[{joint}]" for joint in range(6)
    ]
    assert [t.joint for t in terms_named(model, ["coulomb_friction[4]"])] == [4]
    assert model.blocks["coulomb_friction.level[4]"] == (4,)
    assert model.blocks["payload.mass"] == tuple(range(6))
    for term in model.terms.values():
        assert set(term.with_terms) <= set(model.terms)
    assert set(model.blocks) == set(keys)
    assert model.state_names == ()
    assert model.metric == "inverse_dynamics"


@pytest.mark.extended
def test_bare_links_are_the_engines_rigid_body():
    bare = acquired([], EXACT, seconds=6.0)
    model = ArmModel(rig(), bare)
    record = model.prepare(bare)
    error = record.outputs - simulated(model, start_values(model.parameters), record)
    assert np.abs(error).max() < 1e-3 * np.abs(record.outputs).max()


def test_every_term_is_neutral_at_zero(model, prepared):
    start = start_values(model.parameters)
    quiet = simulated(model, start, prepared)
    for p in model.parameters:
        if p.shape:
            theta = start.copy()
            theta[index_of(model.parameters)[p.key]] = 1.3 * p.scale
            np.testing.assert_array_equal(simulated(model, theta, prepared), quiet, err_msg=p.key)
    for key, term in model.terms.items():
        theta = start.copy()
        for p in term.parameters:
            theta[index_of(model.parameters)[p.key]] = 0.5 * p.scale if not p.shape else p.scale
        alone = key.partition("[")[0] in ("presliding_friction", "temperature_dependent_friction")
        if not alone:
            assert np.abs(simulated(model, theta, prepared) - quiet).max() > 0.0, key


@pytest.mark.extended
@pytest.mark.parametrize("lengths_only", [False, True], ids=["masses", "lengths only"])
def test_the_regressor_is_the_slope_of_the_simulation_by_linear_parameters(bare, lengths_only, tmp_path):
    (tmp_path / "links.toml").write_text(LENGTHS)
    model = ArmModel(rig(KNOWN + ('links = "links.toml"\n' if lengths_only else ""), tmp_path), bare)
    record = model.prepare(bare)
    theta = everything_on(model)
    linear = [p for p in model.parameters if p.linear]
    columns = model.regressor(theta, record, [p.key for p in linear]).reshape(-1, 6, len(linear))
    at = simulated(model, theta, record)
    assert any(p.name.startswith("grouped_") for p in linear) == lengths_only
    for i, p in enumerate(linear):
        for step in (0.3, 1.0):
            moved = theta.copy()
            moved[index_of(model.parameters)[p.key]] += step * p.scale
            change = (simulated(model, moved, record) - at) / (step * p.scale)
            np.testing.assert_allclose(change, columns[:, :, i], atol=1e-9 + 1e-9 / p.scale)
        touched = np.flatnonzero(np.abs(columns[:, :, i]).max(axis=0))
        assert set(touched) <= set(model.blocks[p.key]), p.key
    with pytest.raises(UnknownNameError, match="linear parameter"):
        model.regressor(theta, record, ["stribeck_friction.velocity[0]"])


def test_blocks_name_the_joints_that_a_parameter_touches(model, prepared):
    theta = everything_on(model)
    at = simulated(model, theta, prepared)
    for i, p in enumerate(model.parameters):
        moved = theta.copy()
        moved[i] += 0.1 * p.scale
        touched = np.flatnonzero(np.abs(simulated(model, moved, prepared) - at).max(axis=0) > 1e-12)
        assert set(touched.tolist()) <= set(model.blocks[p.key]), p.key


def test_friction_of_each_joint_comes_back(model, prepared):
    theta, residuals = solved(model, prepared, [*BASELINE, "sensor_offset"])
    viscous, coulomb = [0.9, 0.4, 0.89, 0.16, 0.17, 0.12], [0.91, 0.95, 0.59, 0.2, 0.17, 0.2]
    np.testing.assert_allclose(six(model, theta, "coulomb_friction.level"), coulomb, rtol=0.06)
    np.testing.assert_allclose(six(model, theta, "viscous_friction.coefficient"), viscous, atol=0.08)
    np.testing.assert_allclose(six(model, theta, "sensor_offset.offset"), 0.0, atol=2e-3)
    # what is left is the currents' noise after the filter
    passed = np.sqrt(2.0 * model.cut_off * 0.008)
    noise = np.array([0.02, 0.02, 0.015, 0.006, 0.006, 0.006]) * passed
    np.testing.assert_allclose(residuals.std(axis=0), noise, rtol=0.2)


LINEAR = {
    "load_dependent_friction": {"coefficient": [0.05] * 6},
    "friction_asymmetry": {"coefficient": [0.3, 0.3, 0.3, 0.06, 0.06, 0.06]},
    "position_dependent_friction": {"slope": [0.3, 0.3, 0.2, 0.08, 0.08, 0.08]},
    "torque_ripple": {"sine": [0.5, 0.5, 0.4, 0.15, 0.15, 0.15], "cosine": [0.0] * 6},
    "added_inertia": {"inertia": [0.6, 0.6, 0.4, 0.08, 0.08, 0.08]},
    "quadratic_viscous_friction": {"coefficient": [0.4, 0.4, 0.4, 0.1, 0.1, 0.1]},
    "cubic_viscous_friction": {"coefficient": [0.2, 0.2, 0.2, 0.05, 0.05, 0.05]},
}


@pytest.mark.parametrize("term", LINEAR)
def test_an_exact_effect_of_the_arm_comes_back(term):
    bare = acquired([*BASELINE, term], EXACT)
    model = ArmModel(rig(), bare)
    theta, _ = solved(model, model.prepare(bare), [*BASELINE, "sensor_offset", term])
    # the last joint's load is too small to rub
    joints = slice(0, 5 if term == "load_dependent_friction" else 6)
    for name, expected in LINEAR[term].items():
        found = six(model, theta, f"{term}.{name}")[joints]
        np.testing.assert_allclose(found, expected[joints], atol=0.03 * np.max(expected) + 2e-3)


def test_a_ripple_repeats_twice_for_each_turn_of_the_gear():
    bare = acquired([*BASELINE, "torque_ripple"], EXACT)
    left = []
    for text in (KNOWN, KNOWN + f"gear_ratio = {[95.0] * 6}\n"):
        model = ArmModel(rig(text), bare)
        left.append(solved(model, model.prepare(bare), [*BASELINE, "torque_ripple"])[1].std(axis=0))
        (order,) = model.terms["torque_ripple[3]"].known
        assert order.scale == (190.0 if "gear_ratio" in text else 202.0)
    assert np.all(left[0] < 0.2 * left[1])


SHAPED = {
    "payload": {"mass": 1.5, "centre_x": 0.03, "centre_y": 0.0, "centre_z": 0.08},
    "base_tilt": {"roll": 0.02, "pitch": 0.03},
    "clock_offset": {"offset": 0.008},
    "joint_elasticity[1]": {"compliance": 2e-4},
    "presliding_friction[1]": {"length": 0.95 / 600.0},
}


@pytest.mark.parametrize("term", SHAPED)
def test_what_is_not_linear_comes_back_from_noisy_data(term):
    name = term.partition("[")[0]
    more = {"payload.centre_x": 0.03} if term == "payload" else {}
    bare = acquired([*BASELINE, term], more)
    model = ArmModel(rig(), bare)
    keys = [p.key for p in model.terms[term].parameters]
    start = start_values(model.parameters)
    for key, p in zip(keys, model.terms[term].parameters, strict=True):
        start[index_of(model.parameters)[key]] = p.starts[0] if p.starts else 0.0
    terms = [*BASELINE, "sensor_offset"]
    theta = refine(model, model.prepare(bare), terms, start, keys)
    for key, (parameter, expected) in zip(keys, SHAPED[term].items(), strict=True):
        assert key.startswith(f"{name}.{parameter}")
        found = theta[index_of(model.parameters)[key]]
        scale = max(abs(value) for value in SHAPED[term].values())
        assert found == pytest.approx(expected, rel=0.2, abs=0.02 * scale), key


def test_torque_constants_that_are_not_known_follow_from_known_masses(bare):
    model = ArmModel(rig(""), bare)
    assert model.fixed == {}
    assert "torque_constant[0]" in model.unobservable_terms
    keys = [f"torque_constant[{joint}]" for joint in range(6)]
    start = start_values(model.parameters)
    theta = refine(model, model.prepare(bare), BASELINE, start, keys)
    # the last joint carries next to nothing, so nothing says how strong it is
    np.testing.assert_allclose(six(model, theta, "torque_constant")[:5], CONSTANTS[:5], rtol=0.06)


def test_an_arm_without_masses_is_learned_and_predicts_another_motion(bare, tmp_path):
    (tmp_path / "links.toml").write_text(LENGTHS)
    model = ArmModel(rig(KNOWN + 'links = "links.toml"\n', tmp_path), bare)
    terms = [*BASELINE, "sensor_offset"]
    theta, _ = solved(model, model.prepare(bare), terms)
    other = model.prepare(acquired(BASELINE, seed=7))
    error = other.outputs - simulated(model, theta, other)
    share = np.sqrt(np.mean(error**2, axis=0)) / other.outputs.std(axis=0)
    assert np.all(share < 0.1), share
    assert model.combinations["grouped_first_moment_x[2]"].startswith("mx_2")
    assert len(model.combinations) < 36


def test_rest_is_not_judged_and_not_kept(model, bare):
    still = replace(
        bare,
        t=np.arange(2 * len(bare)) * 0.008,
        inputs=np.vstack([np.tile(bare.inputs[:1] * ([1.0] * 6 + [0.0] * 6), (len(bare), 1)), bare.inputs]),
        outputs=np.vstack([np.full((len(bare), 6), 9.0), bare.outputs]),
        auxiliary={},
    )
    record = model.prepare(still)
    assert record.t[0] > bare.t[-1]
    judged = record.motion.judged[record.places]
    slow = np.abs(record.inputs[:, 6:]) < REST_VELOCITY
    assert slow.any()
    assert not judged[slow].any()
    theta = everything_on(model)
    current = simulated(model, theta, record)
    np.testing.assert_array_equal(current[~judged], record.outputs[~judged])
    assert np.all(
        model.regressor(theta, record, ["sensor_offset.offset[2]"]).reshape(-1, 6)[:, 2] == judged[:, 2]
    )


def test_preparation_is_the_same_every_time_and_keeps_slow_currents(model, bare):
    slow = np.sin(2.0 * np.pi * 0.5 * bare.t)[:, None] * np.ones(6)
    first, second = (model.prepare(replace(bare, outputs=slow)) for _ in range(2))
    np.testing.assert_array_equal(first.outputs, second.outputs)
    expected = np.sin(2.0 * np.pi * 0.5 * first.t)
    np.testing.assert_allclose(first.outputs[:, 3], expected, atol=2e-3)
    assert model.prepare(first) is first
    assert 2.0 * model.cut_off <= 1.0 / first.period <= 3.5 * model.cut_off


def test_samples_that_were_lost_are_not_made_up(model, bare):
    there = (bare.t < 6.0) | (bare.t > 7.0)
    record = model.prepare(
        replace(bare, t=bare.t[there], inputs=bare.inputs[there], outputs=bare.outputs[there], auxiliary={})
    )
    assert not np.any((record.t > 5.98) & (record.t < 7.02))
    assert np.any(record.t < 5.9)


def test_parts_and_replaced_outputs_of_a_prepared_record_are_simulated_alike(model, prepared):
    theta = everything_on(model)
    whole = simulated(model, theta, prepared)
    part = prepared.part(50, 120)
    assert isinstance(part, PreparedRecord)
    np.testing.assert_allclose(simulated(model, theta, part), whole[50:120])
    other = replace(prepared, outputs=prepared.outputs + 1.0)
    judged = prepared.motion.judged[prepared.places]
    np.testing.assert_array_equal(simulated(model, theta, other)[judged], whole[judged])
    some = model.simulate(theta, prepared, Windows.of([(10, 20), (40, 45)]), np.empty((2, 0)))
    np.testing.assert_array_equal(some, whole[[*range(10, 20), *range(40, 45)]])


def test_what_is_told_at_coordinates_is_what_drives_the_joints(model, prepared):
    theta, _ = solved(model, prepared, [*BASELINE, "load_dependent_friction"])
    windows, none = Windows.of([(0, len(prepared))]), np.empty((1, 0))
    coordinates = model.coordinates(theta, prepared, windows, none)
    assert coordinates["load_1"].shape == (len(prepared),)
    generalised_force = model.generalised_force(theta, coordinates)
    current = simulated(model, theta, prepared) * CONSTANTS
    sure = np.abs(prepared.inputs[:, 6:]) > 0.2
    np.testing.assert_allclose(generalised_force[sure], current[sure], atol=0.05)


def test_a_term_without_its_channel_is_not_offered(bare):
    cold = ArmModel(rig(), acquired(BASELINE, seconds=6.0, warm=False))
    assert "temperature_dependent_friction[3]" not in cold.terms
    assert cold.unobservable_terms["temperature_dependent_friction[3]"] == "needs joint_temperatures"
    assert "temperature_dependent_friction[3]" in ArmModel(rig(), bare).terms
    assert "static_friction" in cold.unobservable_terms


def test_a_model_without_a_record_lists_its_terms(tmp_path):
    (tmp_path / "links.toml").write_text(LENGTHS)
    for text in (KNOWN, KNOWN + 'links = "links.toml"\n', ""):
        listed = ArmModel(rig(text, tmp_path))
        assert {"coulomb_friction[0]", "payload", "torque_ripple[5]"} <= set(listed.terms)


def test_a_record_that_was_not_prepared_is_simulated_too(model, bare):
    few = bare.part(600, 640)
    current = simulated(model, everything_on(model), few)
    assert current.shape == (40, 6)
    assert np.all(np.isfinite(current))


def test_too_little_motion_is_refused_in_words(model, bare):
    with pytest.raises(RecordingError, match="too short for inverse dynamics: 20 samples"):
        model.prepare(bare.part(0, 20))
    still = replace(bare, inputs=np.zeros_like(bare.inputs))
    with pytest.raises(RecordingError, match="too little motion"):
        model.prepare(still)


def test_a_fit_finds_the_friction_of_every_joint_and_a_mass_that_nobody_told_of():
    terms = [*BASELINE, "sensor_offset", "payload"]
    record = acquired([*BASELINE, "payload"], {"payload.mass": 1.5, "payload.centre_z": 0.05}, seed=4)
    model = ArmModel(rig(), record)
    found = fit(model, model.prepare(record), terms)
    rows = {(row.name, row.joint): row for row in found.estimates}
    friction = [rows["coulomb_friction.level", joint] for joint in range(6)]
    for row, truth in zip(friction, [0.91, 0.95, 0.59, 0.2, 0.17, 0.2], strict=True):
        assert abs(row.value - truth) < 4.0 * row.std_error + 0.02 * truth
    mass = rows["payload.mass", None]
    assert mass.value == pytest.approx(1.5, abs=max(5.0 * mass.std_error, 0.02))
    assert found.test is None
    assert found.train.metric == "inverse_dynamics"
    assert [channel.joint for channel in found.train.channels] == list(range(6))
