"""The simulated arm: what its controller reports of a motion, effect by effect."""

import time

import numpy as np
import pytest

from labhil.errors import UnknownNameError, UsageError
from labhil.kinds import kind_named
from labhil.plants.arm import EFFECTS, HIDDEN, UR5, ArmPlant, all_parameters, parameters_of
from labhil.plants.arm.rigid_body import RigidBody

BARE = ["viscous_friction", "coulomb_friction"]
EXACT = {
    "q_noise": 0.0,
    "qd_noise": 0.0,
    "current_noise": 0.0,
    "current_resolution": 0.0,
    "temperature_noise": 0.0,
    "temperature_resolution": 0.0,
    "voltage_noise": 0.0,
}
MIDDLE = np.array([0.2, -1.2, 1.0, -0.5, 0.6, 0.1])
CONSTANTS = np.array([13.26, 11.13, 10.62, 11.03, 11.47, 11.61])


def fourier(seconds=10.0, rate=125.0, harmonics=4, seed=0, fastest=0.8):
    """A periodic excitation of all joints about ``MIDDLE``: angles, velocities, accelerations (n, 6)."""
    t = np.arange(round(seconds * rate)) / rate
    w = 2.0 * np.pi / 10.0 * np.arange(1, harmonics + 1)
    a, b = np.random.default_rng(seed).normal(size=(2, harmonics, 6))
    sine, cosine = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    q = sine @ (a / w[:, None]) - cosine @ (b / w[:, None])
    qd = cosine @ a + sine @ b
    qdd = -(sine * w) @ a + (cosine * w) @ b
    gain = fastest / np.abs(qd).max(axis=0)
    return MIDDLE + gain * q, gain * qd, gain * qdd


def rest(n, q=MIDDLE):
    return np.tile(q, (n, 1)), np.zeros((n, 6)), np.zeros((n, 6))


def followed(terms, parameters=None, plan=None, **options):
    return ArmPlant(parameters or {}, terms, **options).follow(*(plan or fourier()))


def beside_the_body(terms, parameters=None):
    """Torque beyond the rigid body where no joint is near a reversal; with velocities and angles there."""
    truth = followed(terms, EXACT | (parameters or {})).truth
    moving = np.abs(truth.qd).min(axis=1) > 0.02
    assert moving.sum() > 300
    return (truth.torque - truth.body)[moving], truth.qd[moving], truth.q[moving], truth.body[moving]


@pytest.mark.extended
def test_a_bare_arm_needs_the_rigid_bodys_torque_and_nothing_else():
    run = followed([], EXACT)
    expected = RigidBody(UR5).torques(run.truth.q, run.truth.qd, run.truth.qdd)
    np.testing.assert_allclose(run.actual_current * CONSTANTS, expected, atol=1e-9)
    np.testing.assert_array_equal(run.truth.friction, 0.0)


@pytest.mark.extended
def test_signals_are_those_of_the_contract():
    run = followed(BARE)
    declared = {signal.name: signal for signal in kind_named("ur5").signals()}
    signals = run.signals()
    assert set(signals) == set(declared)
    for name, values in signals.items():
        assert values.shape == ((1250, 6) if declared[name].width == 6 else (1250,))
        assert np.all(np.isfinite(values))
    assert run.truth.torque.shape == (1250, 6)


def test_the_controller_expects_links_alone():
    run = followed([*BARE, "payload", "base_tilt"], EXACT)
    expected = RigidBody(UR5).torques(run.target_q, run.target_qd, run.target_qdd)
    np.testing.assert_array_equal(run.target_moment, expected)
    np.testing.assert_allclose(run.target_current, expected / CONSTANTS)


def test_the_servo_lags_by_its_law():
    """Under one sine the error is −q̈_plan/(ω + s)²: found here by complex numbers."""
    t, w, bandwidth = np.arange(2000) * 0.002, 5.0, 50.0
    phase = np.exp(1j * w * t)[:, None] * np.ones(6)
    run = followed(
        [],
        EXACT | {"servo_bandwidth": bandwidth},
        (phase.imag, w * phase.real, -(w**2) * phase.imag),
        period=0.002,
    )
    error = (w**2 * phase / (bandwidth + 1j * w) ** 2).imag
    settled = t > 0.5
    np.testing.assert_allclose((run.truth.q - run.target_q)[settled], error[settled], atol=1e-6)
    by_difference = np.gradient(run.truth.q, t, axis=0)[settled][:-2]
    np.testing.assert_allclose(by_difference, run.truth.qd[settled][:-2], atol=1e-3)
    by_difference = np.gradient(run.truth.qd, t, axis=0)[settled][:-2]
    np.testing.assert_allclose(by_difference, run.truth.qdd[settled][:-2], atol=1e-3)


def test_friction_of_each_joint_is_as_the_reference_text_states():
    terms = [*BARE, "stribeck_friction", "quadratic_viscous_friction", "cubic_viscous_friction"]
    torque, v, _, _ = beside_the_body(terms, {"stribeck_friction.velocity": 0.2})
    coulomb, viscous = [0.91, 0.95, 0.59, 0.2, 0.17, 0.2], [0.9, 0.4, 0.89, 0.16, 0.17, 0.12]
    stribeck = [-0.27, -0.45, -0.05, 0.03, 0.03, 0.09]
    quadratic, cubic = [0.4] * 3 + [0.1] * 3, [0.2] * 3 + [0.05] * 3
    dry = (coulomb + stribeck * np.exp(-np.abs(v) / 0.2)) * np.sign(v)
    np.testing.assert_allclose(
        torque, dry + viscous * v + quadratic * v * np.abs(v) + cubic * v**3, atol=1e-12
    )


LAWS = {
    "friction_asymmetry": lambda v, q, load: (
        [0.3, 0.3, 0.3, 0.06, 0.06, 0.06] * np.abs(v) + [0.2, 0.2, 0.15, 0.05, 0.05, 0.05]
    ),
    "position_dependent_friction": lambda v, q, load: [0.01, 0.02, 0.03, 0.01, 0.02, 0.03] * q * np.sign(v),
    "load_dependent_friction": lambda v, q, load: 0.05 * np.abs(load) * np.sign(v),
    "torque_ripple": lambda v, q, load: [0.5, 0.5, 0.4, 0.15, 0.15, 0.15] * np.sin(202.0 * q),
    "constant_force": lambda v, q, load: [0.4, 0.4, 0.3, 0.1, 0.1, 0.1] + 0.0 * q,
    "hidden_sticky_patch": lambda v, q, load: (
        [0, 0, 1.2, 0, 0, 0] * np.exp(-(((q - 0.3) / 0.15) ** 2)) * np.sign(v)
    ),
}


@pytest.mark.parametrize("effect", LAWS)
def test_an_effect_adds_its_law(effect):
    slope = {"position_dependent_friction.slope": [0.01, 0.02, 0.03, 0.01, 0.02, 0.03]}
    parameters = slope if effect == "position_dependent_friction" else {}
    torque, v, q, load = beside_the_body([*BARE, effect], parameters)
    without, _, _, _ = beside_the_body(BARE)
    np.testing.assert_allclose(torque - without, LAWS[effect](v, q, load), atol=1e-9)


def test_added_inertia_resists_acceleration():
    with_it, without = (followed([*BARE, *more], EXACT).truth for more in (["added_inertia"], []))
    expected = [0.6, 0.6, 0.4, 0.08, 0.08, 0.08] * without.qdd
    np.testing.assert_allclose(with_it.torque - without.torque, expected, atol=1e-9)


def test_one_joint_alone_may_have_an_effect_or_another_value():
    plan = fourier()
    without = followed(BARE, EXACT, plan).truth.friction
    one = followed([*BARE, "load_dependent_friction[1]"], EXACT, plan).truth.friction
    assert np.abs(one - without)[:, 1].max() > 1.0
    np.testing.assert_array_equal((one - without)[:, [0, 2, 3, 4, 5]], 0.0)
    plant = ArmPlant({"coulomb_friction.level[2]": 7.0, "coulomb_friction.level": 1.0}, BARE)
    levels = [plant.parameters[f"coulomb_friction.level[{joint}]"] for joint in range(6)]
    assert levels == [1.0, 1.0, 7.0, 1.0, 1.0, 1.0]


@pytest.mark.parametrize("terms", [BARE, [*BARE, "static_friction"], [*BARE, "presliding_friction"]])
def test_current_at_rest_is_gravity_and_what_friction_holds(terms):
    there, speeds, accelerations = fourier(4.0)
    plant = ArmPlant(EXACT, terms)
    plant.follow(there, speeds, accelerations)
    stop = there[-1] + 0.05 * speeds[-1]
    held = [plant.step(stop, np.zeros(6), np.zeros(6), 0.008).truth for _ in range(300)][-1]
    gravity = RigidBody(UR5).torques(stop[None], np.zeros((1, 6)), np.zeros((1, 6)))
    residual = held.torque - gravity
    hold = np.array([0.91, 0.95, 0.59, 0.2, 0.17, 0.2])
    if "static_friction" in terms:
        hold += [0.6, 0.6, 0.4, 0.15, 0.15, 0.15]
    assert np.all(np.abs(residual) <= hold + 1e-9)
    assert np.all(np.abs(residual) > 0.01 * hold)


def test_an_arm_that_is_put_down_is_still_and_held_within_its_friction():
    run = followed(BARE, EXACT, rest(50))
    residual = run.truth.torque - run.truth.body
    assert np.all(np.abs(residual) <= [0.91, 0.95, 0.59, 0.2, 0.17, 0.2])
    np.testing.assert_array_equal(np.ptp(run.truth.torque, axis=0), 0.0)
    assert np.any(residual != 0.0)


def test_bristles_bend_before_they_slip():
    plant = ArmPlant(
        EXACT | {"presliding_friction.damping": 0.0}, ["coulomb_friction", "presliding_friction"]
    )
    plant.place(MIDDLE)
    still = np.zeros(6)

    def move(begin, end):
        return np.array(
            [
                plant.step(MIDDLE + x, still, still, 0.008).truth.friction[0]
                for x in np.linspace(begin, end, 400)
            ]
        )

    level = np.array([0.91, 0.95, 0.59, 0.2, 0.17, 0.2])
    stiffness = np.array([600.0, 600.0, 400.0, 150.0, 150.0, 150.0])
    np.testing.assert_allclose(move(0.0, 0.02)[-1], level, rtol=1e-3)
    np.testing.assert_allclose(move(0.02, -0.02)[-1], -level, rtol=1e-3)
    turned = move(-0.02, -0.0199)
    np.testing.assert_allclose(turned[-1] + level, 2.0 * stiffness * 1e-4, rtol=0.2)


def test_joints_warm_up_and_their_friction_thins():
    terms = ["viscous_friction", "temperature_dependent_friction"]
    quick = EXACT | {"warming_time": 5.0}
    truth = followed(terms, quick, fourier(20.0)).truth
    viscous = [0.9, 0.4, 0.89, 0.16, 0.17, 0.12]
    before = np.vstack([np.full((1, 6), np.nan), truth.temperature[:-1]])
    expected = viscous * truth.qd * np.exp(-0.03 * (before - 30.0))
    np.testing.assert_allclose(truth.friction[1:], expected[1:], rtol=1e-12, atol=1e-15)
    plant = ArmPlant(quick, terms)
    hanging = np.array([0.0, -0.3, 0.0, 0.0, 0.0, 0.0])
    warm = plant.follow(*rest(7500, hanging)).truth
    heat = np.array([1.2, 1.2, 1.2, 2.0, 2.0, 2.0]) * warm.current[-1] ** 2
    final = 24.0 + np.array([15.0, 8.0, 12.0, 60.0, 80.0, 80.0]) * heat
    np.testing.assert_allclose(plant.temperature, final, rtol=1e-3)
    plant.place(MIDDLE)
    np.testing.assert_allclose(plant.temperature, final, rtol=1e-3)
    start = np.array([27.0, 27.0, 27.0, 28.0, 28.0, 28.0])
    after_ten_seconds = final + (start - final) * np.exp(-2.0)
    np.testing.assert_allclose(warm.temperature[1250], after_ten_seconds, rtol=1e-3)


def test_currents_are_reported_late():
    late = followed([*BARE, "clock_offset"], EXACT | {"clock_offset.offset": 0.016})
    prompt = followed(BARE, EXACT)
    np.testing.assert_allclose(late.actual_current[100:], prompt.actual_current[98:-2], atol=2e-6)
    np.testing.assert_array_equal(late.actual_q, prompt.actual_q)


def test_a_stiff_spring_is_no_spring():
    stiff = followed([], EXACT).truth
    all_joints = followed(["joint_elasticity"], EXACT | {"joint_elasticity.compliance": 1e-5}).truth
    np.testing.assert_allclose(all_joints.torque[50:], stiff.torque[50:], atol=0.04)
    one_joint = followed(["joint_elasticity[5]"], EXACT).truth
    np.testing.assert_allclose(one_joint.torque[50:], stiff.torque[50:], atol=0.03)


def test_links_hang_from_their_springs():
    truth = followed(["joint_elasticity"], EXACT, rest(100)).truth
    compliance = np.array([2e-4, 2e-4, 2e-4, 4e-4, 4e-4, 4e-4])
    sagged = MIDDLE - compliance * truth.torque[-1]
    gravity = RigidBody(UR5).torques(sagged[None], np.zeros((1, 6)), np.zeros((1, 6)))[0]
    np.testing.assert_allclose(truth.torque[-1], gravity, atol=1e-6)
    assert abs(sagged[1] - MIDDLE[1]) > 1e-3


def test_a_link_rings_at_its_own_frequency_and_dies_away():
    """Only joint 0 gives; a jerk sets the arm swinging at √(1/(c·M₀₀)), damped by half of relaxation·ω."""
    terms, c, relaxation = ["joint_elasticity[0]"], 4e-4, 1e-3
    plant = ArmPlant(
        EXACT | {"joint_elasticity.compliance[0]": c, "joint_elasticity.relaxation": relaxation}, terms
    )
    plant.place(MIDDLE)
    aside = MIDDLE + 0.01 * np.eye(6)[0]
    ringing = np.array(
        [plant.step(aside, np.zeros(6), np.zeros(6), 0.002).truth.torque[0, 0] for _ in range(600)]
    )
    body = RigidBody(UR5)
    unit = np.eye(6)[:1]
    still = np.zeros((1, 6))
    inertia = (body.torques(MIDDLE[None], still, unit) - body.torques(MIDDLE[None], still, still))[0, 0]
    w = np.sqrt(1.0 / (c * inertia))
    t = 0.002 * np.arange(600)
    late = t > 0.1
    crossings = t[late][1:][np.diff(np.sign(ringing[late])) != 0]
    assert np.pi / np.diff(crossings).mean() == pytest.approx(w, rel=0.03)
    first, last = (np.abs(ringing[(t > a) & (t < a + 2 * np.pi / w)]).max() for a in (0.1, 0.9))
    assert np.log(first / last) / 0.8 == pytest.approx(0.5 * relaxation * w**2, rel=0.3)


def test_the_current_meter_errs_as_it_is_told():
    plan = fourier()
    clean = followed(BARE, EXACT, plan).actual_current
    gained = followed([*BARE, "sensor_gain", "sensor_offset"], EXACT, plan).actual_current
    np.testing.assert_allclose(gained, 1.05 * clean + [0.1, -0.08, 0.06, 0.05, -0.04, 0.03], atol=1e-12)
    coarse = followed(BARE, EXACT | {"current_resolution": 0.02}, plan).actual_current
    np.testing.assert_allclose(coarse / 0.02, np.rint(coarse / 0.02), atol=1e-9)
    assert np.abs(coarse - clean).max() <= 0.01 + 1e-9


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_the_noise_has_its_size_and_its_memory(memory):
    plan, parameters = rest(20000), EXACT | {"current_noise": 0.05, "current_noise_memory": memory}
    run = followed(BARE, parameters, plan, seed=3)
    noise = run.actual_current - run.truth.current
    np.testing.assert_allclose(noise.std(axis=0), 0.05, rtol=0.06)
    lagged = np.mean(noise[1:] * noise[:-1], axis=0) / noise.var(axis=0)
    np.testing.assert_allclose(lagged, memory, atol=0.04)


def test_the_encoders_and_the_supply_are_noisy_too():
    run = followed(BARE)
    assert np.std(run.actual_q - run.truth.q) == pytest.approx(1e-5, rel=0.05)
    assert np.std(run.actual_qd - run.truth.qd) == pytest.approx(1e-3, rel=0.05)
    assert np.all((run.actual_main_voltage > 46.0) & (run.actual_main_voltage < 48.5))
    steps = run.joint_temperatures / 0.0625
    np.testing.assert_array_equal(steps, np.rint(steps))


def test_jittered_samples_are_true_samples_of_the_same_motion():
    even, jittered = (
        followed(BARE, EXACT | more, seed=5, period=0.01) for more in ({}, {"stamp_jitter": 0.004})
    )
    gaps = np.diff(jittered.t)
    assert 0.001 < gaps.std() < 0.006
    assert gaps.min() > 0.0
    for name in ("actual_q", "actual_qd"):
        expected = [np.interp(jittered.t, even.t, column) for column in getattr(even, name).T]
        np.testing.assert_allclose(getattr(jittered, name), np.transpose(expected), atol=5e-4)
    np.testing.assert_array_equal(jittered.truth.body[0], even.truth.body[0])


def test_the_seed_decides_the_noise_and_what_rest_left_behind():
    runs = [followed(BARE, seed=seed) for seed in (3, 3, 4)]
    np.testing.assert_array_equal(runs[0].actual_current, runs[1].actual_current)
    np.testing.assert_array_equal(runs[0].truth.torque, runs[2].truth.torque)
    assert np.all(np.any(runs[0].actual_current != runs[2].actual_current, axis=0))


ALL_EFFECTS = [*EFFECTS, *HIDDEN]


@pytest.mark.parametrize("effect", ALL_EFFECTS)
def test_each_effect_changes_what_is_seen(effect):
    others = [term for term in BARE if term != effect]
    with_it = followed([*others, effect], seed=1).actual_current
    without = followed(others, seed=1).actual_current
    assert np.any(with_it != without)


@pytest.mark.parametrize("effect", ALL_EFFECTS)
def test_an_effect_of_no_strength_is_exactly_absent(effect):
    others = [term for term in BARE if term != effect]
    strengths = {f"{effect}.{name}": 0.0 for name in (EFFECTS | HIDDEN)[effect].strengths}
    with_it = followed([*others, effect], strengths, seed=2).signals()
    without = followed(others, seed=2).signals()
    for name, values in with_it.items():
        np.testing.assert_array_equal(values, without[name])


def test_stepping_is_following():
    terms = [
        *BARE,
        "stribeck_friction",
        "presliding_friction[0]",
        "joint_elasticity",
        "clock_offset",
        "payload",
    ]
    parameters = EXACT | {"clock_offset.offset": 0.013}
    plan = fourier(2.0)
    whole = ArmPlant(parameters, terms).follow(*plan)
    plant = ArmPlant(parameters, terms)
    plant.follow(*(rows[:1] for rows in plan))
    steps = [plant.step(*row, 0.008) for row in zip(*(rows[1:] for rows in plan), strict=True)]
    for name, values in whole.signals().items():
        stepped = np.concatenate([getattr(step, name) for step in steps])
        np.testing.assert_allclose(stepped, values[1:], atol=1e-9)
    np.testing.assert_allclose([step.t[0] for step in steps], whole.t[1:])


def test_names_and_values_that_make_no_world_are_refused():
    with pytest.raises(UnknownNameError, match="did you mean 'payload'"):
        ArmPlant(terms=["paylod"])
    with pytest.raises(UnknownNameError, match="did you mean 'torque_constant'"):
        ArmPlant({"torque_constnt": 1.0})
    with pytest.raises(UsageError, match="belongs to payload"):
        ArmPlant({"payload.mass": 0.1})
    with pytest.raises(UsageError, match="from 0 to 5"):
        ArmPlant({"torque_constant[6]": 1.0})
    with pytest.raises(UsageError, match="takes no joint"):
        ArmPlant(terms=["payload[1]"])
    with pytest.raises(UsageError, match="one number, or 6"):
        ArmPlant({"torque_constant": [1.0, 2.0]})
    with pytest.raises(UsageError, match="positive"):
        ArmPlant({"torque_constant[3]": 0.0})
    with pytest.raises(UsageError, match=r"at most 0\.1"):
        ArmPlant({"clock_offset.offset": 1.0}, ["clock_offset"])
    with pytest.raises(UsageError, match="needs viscous_friction"):
        ArmPlant(terms=["temperature_dependent_friction"])
    with pytest.raises(UsageError, match="dry friction"):
        ArmPlant(terms=["presliding_friction"])
    with pytest.raises(UsageError, match="half the sample period"):
        ArmPlant({"stamp_jitter": 0.004})
    assert {name for effect in ALL_EFFECTS for name in parameters_of(effect)} < set(all_parameters())


@pytest.mark.parametrize("rows", [np.zeros((5, 5)), np.zeros((0, 6)), np.full((5, 6), np.nan), np.zeros(6)])
def test_plans_that_are_none_are_refused(rows):
    with pytest.raises(UsageError, match=r"finite numbers of shape \(n, 6\)"):
        ArmPlant().follow(rows, rows, rows)
    with pytest.raises(UsageError, match="positive time"):
        ArmPlant().step(np.zeros(6), np.zeros(6), np.zeros(6), 0.0)


@pytest.mark.extended
def test_forty_seconds_are_simulated_in_much_less():
    plan, terms = (
        fourier(40.0),
        [*BARE, "stribeck_friction", "load_dependent_friction", "presliding_friction"],
    )
    followed(terms, plan=fourier(0.1))
    for more in ([], ["joint_elasticity"]):
        begin = time.perf_counter()
        run = followed([*terms, *more], plan=plan)
        print(f"40 s with {', '.join(more) or 'stiff joints'}: {time.perf_counter() - begin:.2f} s")
        assert len(run.t) == 5000
