"""How exact the plants' integrator is, at its events and between them, and what each effect is worth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labhil.errors import UnknownNameError, UsageError
from labhil.plants import solenoid
from labhil.plants.axis import AxisPlant
from labhil.plants.dc_motor import DcMotorPlant
from labhil.plants.definition import INPUT_EFFECTS as EFFECTS_IN
from labhil.plants.rigs import PLANT_DEFINITIONS, PLANTS, effects_of, plant_of
from labhil.plants.solenoid import SOLENOID, Plunger, SolenoidPlant, force_per_current, magnet_force

PERIOD = {"ball_beam": 0.01, "dc_motor": 0.01, "axis": 0.001, "solenoid": 0.001}
SIZE = {"ball_beam": 0.4, "dc_motor": 5.0, "axis": 150.0, "solenoid": 1.8}
FRICTION = ("viscous_friction", "coulomb_friction", "stribeck_friction")
WAY_IN = ("time_delay", "backlash", "dead_zone", "saturation", "rate_limit", "actuator_lag")
QUIET = {
    kind: {name: 0.0 for name in world.bare if name.endswith("_noise")}
    for kind, world in PLANT_DEFINITIONS.items()
}
STATES = {
    "dc_motor": ("speed", "current", "angle"),
    "axis": ("position", "velocity"),
    "solenoid": ("plunger_position", "field_current"),
}
WORLDLY = {
    "friction": FRICTION,
    "stiction": (*FRICTION, "static_friction", "friction_asymmetry", "position_dependent_friction"),
    "bristles": (*FRICTION, "presliding_friction"),
    "elements": (*FRICTION, "maxwell_slip_friction"),
    "way in": (*FRICTION, *WAY_IN, "sensor_lag"),
    "load": (*FRICTION, "load_dependent_friction", "constant_force"),
}
OWN = {
    "dc_motor": ("cogging_torque", "spring_force", "brush_drop", "thermal_resistance"),
    "axis": ("cogging_torque", "spring_hardening", "joint_elasticity", "temperature_dependent_friction"),
    "solenoid": ("spring_hardening", "end_stop_contact", "eddy_current", "magnetic_hysteresis"),
}

MAGNET = Plunger.of(SOLENOID.resolve((), {}))


def levels(kind, seconds, seed=0):
    """Levels of random size, each held for a while; straight in between where the rig wants it."""
    n = round(seconds / PERIOD[kind])
    random = np.random.default_rng(seed)
    nodes = random.uniform(-SIZE[kind], SIZE[kind], n // 40 + 2)
    if kind == "solenoid":
        return np.interp(np.arange(n) / 40.0, np.arange(len(nodes)), np.abs(nodes))
    return np.repeat(nodes, 40)[:n]


@pytest.mark.extended
@pytest.mark.parametrize("kind", STATES)
@pytest.mark.parametrize("what", [*WORLDLY, "own"])
def test_a_finer_step_changes_nothing(kind, what):
    terms = (*FRICTION, *OWN[kind]) if what == "own" else WORLDLY[what]
    terms = [term for term in terms if term in PLANT_DEFINITIONS[kind].effects]
    u = levels(kind, 1000 * PERIOD[kind])
    runs = []
    for tolerance in (None, 1e-12):
        plant = PLANTS[kind](QUIET[kind], terms, 0, PERIOD[kind])
        plant.simulation.tolerance = tolerance or plant.simulation.tolerance
        runs.append(plant.simulate(u).truth)
    for name in STATES[kind]:
        coarse, fine = (run[name] for run in runs)
        assert np.max(np.abs(coarse - fine)) < 1e-7 * np.ptp(fine), name


@pytest.mark.extended
@pytest.mark.parametrize("kind", STATES)
def test_another_integrator_finds_the_same_motion_where_nothing_rests(kind):
    """scipy's, on right-hand sides written out anew; with a bias that keeps the part from turning round."""
    n, h = 400, PERIOD[kind]
    t = h * np.arange(n)
    if kind == "dc_motor":
        u = 4.0 + np.repeat(np.random.default_rng(1).uniform(-1.0, 1.0, n // 40), 40)

        def rates(now, s):
            w, i = s
            level = 0.2 - 0.1 * np.exp(-w / 0.01)
            friction = 0.05 * w + level + 0.05 * w**2 + 0.02 * w**3
            volts = u[min(int((now + 1e-12) / h), n - 1)]
            return [(0.2 * i - friction) / 0.1, (volts - 1.5 * i - 0.2 * w) / 0.1]

        terms = (*FRICTION, "quadratic_viscous_friction", "cubic_viscous_friction")
        found = DcMotorPlant(QUIET[kind], terms).simulate(u).truth
        begin = 40
        state = [found["speed"][begin], found["current"][begin]]
        seen = np.array([found["speed"], found["current"]])
    elif kind == "axis":
        u = np.full(n, 150.0)

        def rates(now, s):
            x, v = s
            friction = 204.0 * v + 20.4 + 8.0 * np.exp(-v / 0.01)
            return [v, (150.0 - friction - 3.0 * np.sin(314.0 * x)) / 95.0]

        found = AxisPlant(QUIET[kind], (*FRICTION, "cogging_torque")).simulate(u).truth
        begin, state = 1, [found["position"][1], found["velocity"][1]]
        seen = np.array([found["position"], found["velocity"]])
    else:
        u = 1.0 + 0.5 * t / t[-1] + 0.2 * np.sin(60.0 * t)
        parameters = QUIET[kind] | {"stop_high": 0.01}
        found = SolenoidPlant(parameters, ("viscous_friction", "eddy_current")).simulate(u).truth

        def rates(now, s):
            x, v, i = s
            force = magnet_force(i, x, MAGNET) - 6850.0 * x - 5.0 * v
            return [v, force / 0.064, (np.interp(now, t, u) - i) / 0.003]

        begin, state = 0, [0.0, 0.0, 0.0]
        seen = np.array([found["plunger_position"], found["plunger_velocity"], found["field_current"]])
    pieces = [np.array(state)]
    for k in range(begin, n - 1):
        made = solve_ivp(rates, (t[k], t[k + 1]), pieces[-1], rtol=1e-11, atol=1e-13)
        pieces.append(made.y[:, -1])
    exact = np.array(pieces).T
    np.testing.assert_allclose(seen[:, begin:], exact, rtol=0, atol=1e-7 * np.abs(exact).max(axis=1).min())


@pytest.mark.extended
def test_a_motor_that_coasts_down_comes_to_rest_and_stays_there():
    parameters = QUIET["dc_motor"] | {"inductance": 1e-4}
    terms = ("viscous_friction", "coulomb_friction", "brush_drop")
    u = np.r_[np.full(300, 5.0), np.zeros(400)]
    seen = DcMotorPlant(parameters, terms).simulate(u).truth
    stopped = np.flatnonzero((seen["speed"] == 0.0) & (np.arange(700) > 300))[0]
    assert np.all(seen["speed"][stopped:] == 0.0)
    assert np.all(seen["angle"][stopped:] == seen["angle"][stopped])
    assert np.all(np.diff(seen["speed"][301 : stopped + 1]) < 0.0)


@pytest.mark.extended
def test_work_done_on_an_elastic_axis_is_kept_or_lost_to_friction():
    """Force times way = kinetic + spring energy where nothing rubs; less the damper's loss."""
    parameters = QUIET["axis"] | {"joint_elasticity.damping": 0.0, "joint_elasticity.compliance": 1e-5}
    plant = AxisPlant(parameters, ["joint_elasticity"])
    force = levels("axis", 0.5, 3)
    plant.simulate(force)
    rows = [plant.simulation._row.copy()]
    work = 0.0
    for value in levels("axis", 0.5, 4):
        plant.step(float(value))
        rows.append(plant.simulation._row.copy())
        work += value * (rows[-1][0] - rows[-2][0])
    rows = np.array(rows)
    x, v, far, fast = rows[:, 0], rows[:, 1], rows[:, 6], rows[:, 7]
    energy = 0.5 * 0.3 * 95.0 * v**2 + 0.5 * 0.7 * 95.0 * fast**2 + 0.5 * 1e5 * (x - far) ** 2
    assert energy[-1] - energy[0] == pytest.approx(work, rel=1e-6)
    assert np.max(np.abs(x - far)) > 1e-4


@pytest.mark.extended
def test_a_coil_takes_in_what_the_plunger_gives_out_by_motion():
    """∂F/∂i is the rate at which a moving plunger induces voltage: λ = ∂W'/∂i and F = ∂W'/∂x."""
    i, x, d = 1.3, 0.002, 1e-6
    slope = (magnet_force(i + d, x, MAGNET) - magnet_force(i - d, x, MAGNET)) / (2.0 * d)
    assert force_per_current(i, x, MAGNET) == pytest.approx(slope, rel=1e-6)
    current = levels("solenoid", 0.5)
    with_it, without = (
        SolenoidPlant(QUIET["solenoid"], (*FRICTION, *more)).simulate(current)
        for more in (["motional_emf"], [])
    )
    induced = with_it.measured["coil_voltage"] - without.measured["coil_voltage"]
    v, x = with_it.truth["plunger_velocity"], with_it.truth["plunger_position"]
    expected = [force_per_current(a, b, MAGNET) * c for a, b, c in zip(current, x, v, strict=True)]
    np.testing.assert_allclose(induced, expected, atol=1e-9)


@pytest.mark.extended
def test_a_straight_command_bends_at_the_very_moment(monkeypatch):
    """Dead zone, play, saturation and rate limit of a triangle, seen through the force at the samples.

    A solenoid's current is its own; here it comes through a way in like any other straight command.
    """
    monkeypatch.setattr(solenoid, "SOLENOID", replace(SOLENOID, effects={**SOLENOID.effects, **EFFECTS_IN}))
    n = 200
    t = 0.001 * np.arange(n)
    u = np.interp(t, [0.0, 0.0503, 0.1509, 0.2], [0.0, 1.7, -1.7, 0.0])
    fine = np.linspace(0.0, t[-1], 1000 * (n - 1) + 1)
    wave = np.interp(fine, t, u)

    def seen(**parameters):
        terms = {name.partition(".")[0] for name in parameters}
        run = SolenoidPlant(QUIET["solenoid"] | parameters, terms).simulate(u)
        return run.truth["field_current"]

    at = 1000 * np.arange(n)
    zone = np.maximum(wave - 0.3, 0.0) + np.minimum(wave + 0.2, 0.0)
    np.testing.assert_allclose(seen(**{"dead_zone.left": 0.2, "dead_zone.right": 0.3}), zone[at], atol=1e-9)
    np.testing.assert_allclose(seen(**{"saturation.limit": 1.1}), np.clip(wave, -1.1, 1.1)[at], atol=1e-9)
    play, slow = np.zeros_like(wave), np.zeros_like(wave)
    most = 12.0 * (fine[1] - fine[0])
    for k in range(1, len(fine)):
        play[k] = min(max(play[k - 1], wave[k] - 0.15), wave[k] + 0.15)
        slow[k] = min(max(wave[k], slow[k - 1] - most), slow[k - 1] + most)
    np.testing.assert_allclose(seen(**{"backlash.gap": 0.3}), play[at], atol=1e-9)
    np.testing.assert_allclose(seen(**{"magnetic_hysteresis.width": 0.3}), play[at], atol=1e-9)
    np.testing.assert_allclose(seen(**{"rate_limit.rate": 12.0}), slow[at], atol=2e-4)
    late = np.interp(t - 0.0034, t, u, left=0.0)
    np.testing.assert_allclose(seen(**{"time_delay.delay": 0.0034}), late, atol=1e-9)


@pytest.mark.extended
@pytest.mark.parametrize("kind", ["dc_motor", "axis", "solenoid"])
def test_uneven_samples_are_those_of_the_same_motion_at_the_stamps(kind):
    """A command that changes nothing while time passes: the same motion, looked at elsewhere."""
    u = np.full(200, SIZE[kind])
    if kind == "solenoid":
        u[0] = 0.0
        u[:] = 0.8
    even, uneven = (
        plant_of(kind, QUIET[kind] | {"stamp_jitter": jitter}, FRICTION, 3, PERIOD[kind]).simulate(u)
        for jitter in (0.0, 0.2 * PERIOD[kind])
    )
    assert np.all(np.diff(uneven.t) > 0.0)
    assert np.std(np.diff(uneven.t)) > 0.1 * PERIOD[kind]
    name = {"dc_motor": "angle", "axis": "position", "solenoid": "plunger_position"}[kind]
    dense = plant_of(kind, QUIET[kind], FRICTION, 3, PERIOD[kind] / 20).simulate(np.repeat(u, 20))
    found = np.interp(uneven.t, dense.t, dense.truth[name])
    scale = np.ptp(even.truth[name])
    inside = uneven.t < dense.t[-1]
    np.testing.assert_allclose(uneven.truth[name][inside], found[inside], atol=2e-3 * scale)


@pytest.mark.extended
def test_stamps_that_lie_leave_the_samples_alone():
    u = levels("dc_motor", 2.0)
    honest, lying = (
        DcMotorPlant(QUIET["dc_motor"] | {"stamp_error": error}, FRICTION).simulate(u)
        for error in (0.0, 1e-3)
    )
    assert np.array_equal(honest.truth["speed"], lying.truth["speed"])
    assert np.std(lying.t - honest.t) == pytest.approx(1e-3, rel=0.2)


@pytest.mark.extended
def test_a_warm_winding_settles_where_heat_in_is_heat_out():
    parameters = QUIET["dc_motor"] | {"heat_capacity": 0.5, "coulomb_friction.level": 1e6}
    run = DcMotorPlant(parameters, ["coulomb_friction", "thermal_resistance"]).simulate(np.full(3001, 3.0))
    warmth, i = run.truth["winding_temperature"][-1] - 25.0, run.truth["current"][-1]
    resistance = 1.5 * (1.0 + 0.0039 * warmth)
    assert i == pytest.approx(3.0 / resistance, rel=1e-6)
    assert warmth == pytest.approx(4.0 * resistance * i**2, rel=1e-6)


NEUTRAL = {
    "presliding_friction", "maxwell_slip_friction", "stribeck_friction", "saturation", "rate_limit",
    "actuator_lag", "sensor_lag",
}  # fmt: skip
"""Effects with a parameter that must not be zero."""


@pytest.mark.extended
@pytest.mark.parametrize("kind", STATES)
def test_an_effect_of_no_strength_is_no_effect(kind):
    u = levels(kind, 300 * PERIOD[kind])
    name = STATES[kind][0]
    bare = plant_of(kind, QUIET[kind], FRICTION, 0, PERIOD[kind]).simulate(u).measured[name]
    for effect in (*PLANT_DEFINITIONS[kind].effects, *PLANT_DEFINITIONS[kind].hidden):
        if effect in NEUTRAL or effect in FRICTION:
            continue
        zero = {
            full: 0.0
            for full in PLANT_DEFINITIONS[kind].parameters_of(effect)
            if full not in PLANT_DEFINITIONS[kind].positive
        }
        made = plant_of(kind, QUIET[kind] | zero, (*FRICTION, effect), 0, PERIOD[kind]).simulate(u)
        np.testing.assert_allclose(made.measured[name], bare, atol=1e-12, err_msg=effect)


@pytest.mark.extended
@pytest.mark.parametrize("kind", PLANTS)
def test_every_rig_has_physics_that_is_in_no_list(kind):
    assert len(effects_of(kind, hidden=True)) >= 2
    assert all(name.startswith("hidden_") for name in effects_of(kind, hidden=True))
    assert not set(effects_of(kind)) & set(effects_of(kind, hidden=True))
    with pytest.raises(UnknownNameError, match="dc_motor"):
        effects_of("dcmotor")


@pytest.mark.extended
@pytest.mark.parametrize("effect", PLANT_DEFINITIONS["ball_beam"].hidden)
def test_hidden_physics_moves_the_ball(effect):
    u = 0.9 * np.cos(3.0 * 0.01 * np.arange(800))
    bare, moved = (
        plant_of("ball_beam", QUIET["ball_beam"], (*FRICTION, *more), 0, 0.01).simulate(u)
        for more in ((), (effect,))
    )
    assert np.max(np.abs(bare.truth["ball_position"] - moved.truth["ball_position"])) > 1e-3


@pytest.mark.extended
def test_a_ball_and_beam_is_a_rig_like_the_others():
    u = levels("ball_beam", 5.0)
    parameters = {"noise_correlation": 0.7, "stamp_jitter": 1e-3}
    runs = [plant_of("ball_beam", parameters, FRICTION, 4, 0.01).simulate(u) for _ in range(2)]
    assert np.array_equal(runs[0].measured["ball_position"], runs[1].measured["ball_position"])
    assert np.std(np.diff(runs[0].t)) > 5e-4
    even = plant_of("ball_beam", {}, FRICTION, 4, 0.01)
    stepped = plant_of("ball_beam", {}, FRICTION, 4, 0.01)
    whole = even.simulate(u)
    stepped.simulate(u[:1])
    ones = [stepped.step(float(angle))["ball_position"] for angle in u[1:]]
    assert np.array_equal(ones, whole.measured["ball_position"][1:])


@pytest.mark.extended
def test_inputs_that_are_no_numbers_and_plants_that_run_away_are_refused():
    with pytest.raises(UsageError, match="finite"):
        DcMotorPlant().simulate(np.array([0.0, np.nan]))
    with pytest.raises(UsageError, match="one finite value"):
        AxisPlant().simulate(np.zeros(0))
    runaway = {"viscous_friction.coefficient": -50.0}
    with pytest.raises(UsageError, match="runs away"):
        DcMotorPlant(runaway, ["viscous_friction"]).simulate(np.ones(3000))
