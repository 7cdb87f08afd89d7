"""The simulated motor, axis and solenoid against what can be worked out by hand."""

import numpy as np
import pytest

from labhil.errors import UnknownNameError, UsageError
from labhil.plants.axis import AXIS, AxisPlant
from labhil.plants.dc_motor import MOTOR, DcMotorPlant
from labhil.plants.rigs import PLANT_DEFINITIONS, PLANTS, plant_of
from labhil.plants.solenoid import SOLENOID, SolenoidPlant

pytestmark = pytest.mark.extended

QUIET_MOTOR = {"speed_noise": 0.0, "current_noise": 0.0, "winding_temperature_noise": 0.0}
QUIET_AXIS = {"position_noise": 0.0, "velocity_noise": 0.0, "drive_current_noise": 0.0}
QUIET_COIL = {"plunger_position_noise": 0.0, "magnetic_force_noise": 0.0}
QUIET = {"dc_motor": QUIET_MOTOR, "axis": QUIET_AXIS, "solenoid": QUIET_COIL}
PERIOD = {"dc_motor": 0.01, "axis": 0.001, "solenoid": 0.001}
SIZE = {"dc_motor": 5.0, "axis": 120.0, "solenoid": 1.6}
FIRST = {"dc_motor": "speed", "axis": "position", "solenoid": "plunger_position"}
FRICTION = ("viscous_friction", "coulomb_friction")
ON_VOLTAGE = {
    ("solenoid", effect): "coil_voltage" for effect in ("motional_emf", "thermal_resistance", "pwm_ripple")
}
WARM = {"axis": {"warming": 0.05}}
EFFECTS = [
    (kind, effect)
    for kind in PERIOD
    for effect in (*PLANT_DEFINITIONS[kind].effects, *PLANT_DEFINITIONS[kind].hidden)
]


def wandering(kind: str, n: int = 3000) -> np.ndarray:
    """An input that begins slowly, turns around, rests and comes close to all that a rig can do."""
    t = np.arange(n) * PERIOD[kind]
    swing = np.sin(2.0 * np.pi * t / t[-1] * 2.3) + 0.5 * np.sign(np.sin(2.0 * np.pi * t / t[-1] * 5.1))
    wave = SIZE[kind] * np.where(np.abs(swing) > 0.3, swing, 0.19 * np.sign(swing))
    wave[: n // 10] *= np.linspace(0.0, 1.0, n // 10)
    return np.asarray(np.abs(wave) if kind == "solenoid" else wave)


def test_a_blocked_motor_is_a_coil_with_a_resistance_that_warms():
    parameters = QUIET_MOTOR | {"coulomb_friction.level": 1e6}
    seen = DcMotorPlant(parameters, ["coulomb_friction"]).simulate(np.full(101, 3.0))
    current = 3.0 / 1.5 * (1.0 - np.exp(-seen.t * 1.5 / 0.1))
    np.testing.assert_allclose(seen.measured["current"], current, atol=1e-9)
    assert not np.any(seen.measured["speed"])
    assert not np.any(seen.measured["angle"])
    late = seen.truth["winding_temperature"][[60, 61]]
    assert late[1] - late[0] == pytest.approx(0.01 * (1.5 * 2.0**2 - (late[0] - 25.0) / 4.0) / 60.0, rel=1e-3)


def test_a_free_motor_is_linear_of_second_order():
    seen = DcMotorPlant(QUIET_MOTOR, ["viscous_friction"]).simulate(np.full(301, 3.0))
    matrix = np.array([[-0.05 / 0.1, 0.2 / 0.1], [-0.2 / 0.1, -1.5 / 0.1]])
    rates, modes = np.linalg.eig(matrix)
    final = -np.linalg.solve(matrix, [0.0, 3.0 / 0.1])
    share = np.linalg.solve(modes, -final)
    exact = final[:, None] + (modes * share) @ np.exp(np.outer(rates, seen.t))
    np.testing.assert_allclose(seen.measured["speed"], exact[0].real, atol=1e-8)
    np.testing.assert_allclose(seen.measured["current"], exact[1].real, atol=1e-8)


def test_an_axis_with_dry_and_viscous_friction_coasts_to_a_stop_in_closed_form():
    force = np.r_[np.full(400, 150.0), np.zeros(1001)]
    seen = AxisPlant(QUIET_AXIS, FRICTION).simulate(force)
    rate, dry = 204.0 / 95.0, 20.4 / 204.0
    v, x, t = seen.truth["velocity"], seen.truth["position"], seen.t
    pushed = (150.0 / 204.0 - dry) * (1.0 - np.exp(-rate * t[:401]))
    np.testing.assert_allclose(v[:401], pushed, atol=1e-10)
    after, v0 = t[400:] - t[400], pushed[-1]
    stop = np.log(1.0 + v0 / dry) / rate
    coasting = (v0 + dry) * np.exp(-rate * after) - dry
    assert 0.1 < stop < after[-1]
    np.testing.assert_allclose(v[400:], np.where(after < stop, coasting, 0.0), atol=1e-10)
    assert x[-1] - x[400] == pytest.approx((v0 + dry) * (1.0 - np.exp(-rate * stop)) / rate - dry * stop)


def test_a_mass_that_a_slow_spring_pulls_sticks_and_slips_when_the_closed_form_says():
    """Slips last 2(π − arctan(A·ω/V))/ω and sticks 2·A/V, with A the extra hold over the stiffness."""
    k, dry, extra, pace, h = 100.0, 2.0, 1.0, 0.05, 0.001
    parameters = QUIET_AXIS | {
        "moving_mass": 1.0, "spring_force.stiffness": k, "coulomb_friction.level": dry,
        "static_friction.level": extra,
    }  # fmt: skip
    terms = ["spring_force", "coulomb_friction", "static_friction"]
    seen = AxisPlant(parameters, terms, period=h).simulate(k * pace * h * np.arange(6000))
    moving = seen.truth["velocity"] != 0.0
    turns = seen.t[np.flatnonzero(np.diff(moving.astype(int)))]
    omega, reach = np.sqrt(k), extra / k
    slip = 2.0 * (np.pi - np.arctan(reach * omega / pace)) / omega
    stick = 2.0 * reach / pace
    first = (dry + extra) / (k * pace)
    cycles = np.arange(7) * (slip + stick)
    expected = first + np.column_stack([cycles, cycles + slip]).ravel()
    assert len(turns) == len(expected[expected < 6.0])
    # a held ramp breaks away up to a sample late, which makes every slip a little longer
    np.testing.assert_allclose(np.diff(turns), np.diff(expected[: len(turns)]), atol=1.05 * h)
    np.testing.assert_allclose(turns, expected[: len(turns)], atol=2.0 * h)
    assert np.all(np.diff(seen.truth["position"]) >= 0.0)
    leap = pace * slip + 2.0 * reach
    rests = np.unique(seen.truth["position"][~moving].round(6))
    np.testing.assert_allclose(np.diff(rests), leap, rtol=0.01)


def test_a_plunger_without_friction_is_a_mass_on_a_spring():
    parameters = QUIET_COIL | {"stop_low": -0.004}
    seen = SolenoidPlant(parameters).simulate(np.zeros(19))
    exact = -0.004 * np.cos(np.sqrt(6850.0 / 0.064) * seen.t)
    np.testing.assert_allclose(seen.measured["plunger_position"], exact, atol=1e-9)


def test_a_plunger_leaves_a_stop_with_the_restitution_of_its_speed():
    """From −A the spring shoots it at a stop in the middle: each way back is shorter by the restitution."""
    h, omega = 1e-4, np.sqrt(6850.0 / 0.064)
    parameters = QUIET_COIL | {"stop_low": -0.004, "stop_high": 0.0, "end_stop_contact.restitution": 0.4}
    seen = SolenoidPlant(parameters, ["end_stop_contact"], period=h).simulate(np.zeros(400))
    x, first = seen.truth["plunger_position"], 0.5 * np.pi / omega
    back = seen.t > first
    phase = omega * (seen.t[back] - first)
    ways = -0.004 * 0.4 ** (1.0 + phase // np.pi) * np.abs(np.sin(phase))
    np.testing.assert_allclose(x[back], ways, atol=1e-8)


CARRIED = ((*FRICTION, "presliding_friction"), (*FRICTION, "maxwell_slip_friction"))


@pytest.mark.parametrize("terms", [(), FRICTION, *CARRIED, ("end_stop_contact",)])
def test_no_plunger_goes_past_its_stops_and_pressed_ones_stay(terms):
    current = np.r_[0.0, np.full(300, 3.0), np.zeros(300)]
    x = SolenoidPlant(QUIET_COIL, terms).simulate(current).truth["plunger_position"]
    assert np.all((x >= 0.0) & (x <= 0.005))
    assert np.all(x[200:301] == 0.005)
    assert x[-1] < 1e-3


def test_the_magnetic_force_is_the_one_that_acts():
    """At rest: that of the current and what stays in the iron."""
    seen = SolenoidPlant(QUIET_COIL, ["residual_magnetism"]).simulate(np.full(300, 0.5))
    i = 0.5 + 0.08
    assert seen.truth["field_current"][-1] == pytest.approx(i)
    x = seen.truth["plunger_position"][-1] / 0.005
    expected = i * (8.0 + 2.0 * x - 3.0 * x**2 + i * (12.0 + 1.5 * x - 2.0 * i))
    assert seen.measured["magnetic_force"][-1] == pytest.approx(expected)


@pytest.mark.parametrize("kind", PERIOD)
def test_one_step_after_the_other_is_the_whole_simulation(kind):
    terms = [*FRICTION, "time_delay", "sensor_lag", "presliding_friction"]
    own = ["eddy_current", "magnetic_hysteresis"], ["actuator_lag", "rate_limit", "added_inertia"]
    terms += own[kind != "solenoid"]
    u = wandering(kind, 300)
    u[0] = 0.0
    whole = plant_of(kind, QUIET[kind], terms, 0, PERIOD[kind]).simulate(u)
    plant = PLANTS[kind](QUIET[kind], terms, 0, PERIOD[kind])
    # a held command is the one before the sample, a straight one ends at it
    steps = [plant.step(float(value)) for value in (u[1:] if kind == "solenoid" else u[:-1])]
    for name in set(whole.measured) - {"drive_voltage"}:
        one_by_one = np.array([step[name] for step in steps])
        np.testing.assert_allclose(one_by_one, whole.measured[name][1:], rtol=1e-9, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("kind", PERIOD)
def test_two_halves_are_the_whole(kind):
    lag = "eddy_current" if kind == "solenoid" else "actuator_lag"
    terms, u = [*FRICTION, "time_delay", "sensor_lag", lag], wandering(kind, 300)
    whole = plant_of(kind, QUIET[kind], terms, 0, PERIOD[kind]).simulate(u)
    plant = plant_of(kind, QUIET[kind], terms, 0, PERIOD[kind])
    halves = plant.simulate(u[:151]), plant.simulate(u[150:])
    for name, values in whole.measured.items():
        glued = np.r_[halves[0].measured[name], halves[1].measured[name][1:]]
        np.testing.assert_allclose(glued, values, rtol=1e-9, atol=1e-12, err_msg=name)


@pytest.mark.parametrize(("kind", "effect"), EFFECTS)
def test_every_effect_changes_what_is_measured_and_nothing_but_finite_numbers_come_out(kind, effect):
    u, parameters = wandering(kind), QUIET[kind] | WARM.get(kind, {})
    beside = [term for term in FRICTION if term != effect]
    without = plant_of(kind, parameters, beside, 0, PERIOD[kind]).simulate(u)
    with_it = plant_of(kind, parameters, [*beside, effect], 0, PERIOD[kind]).simulate(u)
    assert all(np.all(np.isfinite(values)) for values in with_it.measured.values())
    name = ON_VOLTAGE.get((kind, effect), FIRST[kind])
    spread = np.ptp(without.measured[name])
    assert np.max(np.abs(with_it.measured[name] - without.measured[name])) > 1e-4 * spread


@pytest.mark.parametrize("kind", PERIOD)
def test_the_seed_fixes_every_sample(kind):
    parameters = {"stamp_error": 1e-4, "noise_correlation": 0.5}
    one, same, other = (
        plant_of(kind, parameters, FRICTION, seed, PERIOD[kind]).simulate(wandering(kind, 200))
        for seed in (3, 3, 4)
    )
    assert np.array_equal(one.t, same.t)
    assert not np.array_equal(one.t, other.t)
    for name, values in one.measured.items():
        assert np.array_equal(values, same.measured[name])
    assert not np.array_equal(one.measured[FIRST[kind]], other.measured[FIRST[kind]])
    for name, values in one.truth.items():
        assert np.array_equal(values, other.truth[name])


@pytest.mark.parametrize("kind", PERIOD)
@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_noise_has_the_size_and_the_correlation_that_were_asked_for(kind, rho):
    name, n = FIRST[kind], 20000
    parameters = QUIET[kind] | {f"{name}_noise": 0.01, "noise_correlation": rho}
    noise = plant_of(kind, parameters, ["coulomb_friction"], 5, PERIOD[kind]).simulate(np.zeros(n))
    e = noise.measured[name] - noise.truth[name]
    # a variance of correlated samples is known as well as one of fewer
    effective = n * (1.0 - rho**2) / (1.0 + rho**2)
    assert np.var(e) == pytest.approx(1e-4, rel=4.0 * np.sqrt(2.0 / effective))
    for lag in (1, 3):
        found = np.mean(e[lag:] * e[:-lag]) / np.var(e)
        assert found == pytest.approx(rho**lag, abs=4.0 / np.sqrt(n) + 0.02)


def test_coloured_noise_goes_on_from_step_to_step():
    plant = AxisPlant({"position_noise": 0.01, "noise_correlation": 0.9}, ["coulomb_friction"], seed=1)
    e = np.array([plant.step(0.0)["position"] for _ in range(3000)])
    assert np.corrcoef(e[1:], e[:-1])[0, 1] == pytest.approx(0.9, abs=0.03)
    assert np.std(e) == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize("kind", PERIOD)
def test_resolution_and_jitter_are_those_that_were_asked_for(kind):
    name = FIRST[kind]
    step = {"dc_motor": 0.05, "axis": 1e-3, "solenoid": 1e-4}[kind]
    parameters = QUIET[kind] | {f"{name}_resolution": step, "stamp_jitter": 1e-4}
    seen = plant_of(kind, parameters, FRICTION, 6, PERIOD[kind]).simulate(wandering(kind))
    counts = seen.measured[name] / step
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-9)
    assert np.max(np.abs(seen.measured[name] - seen.truth[name])) <= 0.5 * step + 1e-12
    jitter = seen.t - PERIOD[kind] * np.arange(len(seen.t))
    assert np.std(jitter) == pytest.approx(1e-4, rel=0.1)


def test_a_delayed_command_acts_later_by_the_delay_to_the_fraction_of_a_sample():
    force, parameters = np.full(101, 50.0), QUIET_AXIS | {"time_delay.delay": 0.0123}
    seen = AxisPlant(parameters, ["time_delay"]).simulate(force)
    late = np.maximum(seen.t - 0.0123, 0.0)
    np.testing.assert_allclose(seen.truth["position"], 0.5 * 50.0 / 95.0 * late**2, atol=1e-12)


def test_a_lag_in_the_drive_is_of_first_order():
    seen = AxisPlant(QUIET_AXIS, ["actuator_lag"]).simulate(np.full(101, 50.0))
    t, lag = seen.t, 0.005
    exact = 50.0 / 95.0 * (t - lag * (1.0 - np.exp(-t / lag)))
    np.testing.assert_allclose(seen.truth["velocity"], exact, rtol=2e-4, atol=1e-6)


def test_friction_heat_warms_the_axis_and_a_warm_axis_runs_more_easily():
    terms = [*FRICTION, "temperature_dependent_friction"]
    seen = AxisPlant(QUIET_AXIS | {"warming": 0.05}, terms).simulate(np.full(3001, 150.0))
    v, warmth = seen.truth["velocity"][-1], seen.truth["temperature"][-1] - 25.0
    work = 150.0 * seen.truth["position"][-1] - 0.5 * 95.0 * v**2
    assert warmth == pytest.approx(0.05 * work, rel=0.01)
    cold = AxisPlant(QUIET_AXIS, terms).simulate(np.full(3001, 150.0)).truth["velocity"][-1]
    assert v > 1.05 * cold


@pytest.mark.parametrize("kind", PERIOD)
def test_a_single_sample_is_a_simulation_too(kind):
    seen = plant_of(kind, {}, (), 0, PERIOD[kind]).simulate(np.zeros(1))
    assert all(len(values) == 1 for values in (*seen.measured.values(), *seen.truth.values(), seen.t))


@pytest.mark.parametrize("world", [MOTOR, AXIS, SOLENOID])
def test_names_that_do_not_exist_are_refused_with_those_that_do_but_not_the_hidden_ones(world):
    with pytest.raises(UnknownNameError, match="did you mean 'coulomb_friction'") as effect:
        world.resolve(["coulomb_frictoin"], {})
    with pytest.raises(UnknownNameError, match=r"coulomb_friction\.level") as parameter:
        world.resolve(["coulomb_friction"], {"coulomb_friction.lvl": 1.0})
    with pytest.raises(UnknownNameError) as near:
        world.resolve(["hidden_magnt"], {})
    for refusal in (effect, parameter, near):
        assert not any(name in str(refusal.value) for name in world.hidden)


def test_values_that_make_no_world_are_refused_with_their_name():
    with pytest.raises(UsageError, match=r"coulomb_friction\.level belongs to coulomb_friction"):
        AxisPlant({"coulomb_friction.level": 1.0})
    for name, value, words in (
        ("moving_mass", 0.0, "positive"),
        ("moving_mass", np.nan, "positive"),
        ("position_noise", np.inf, "finite"),
        ("position_noise", -1.0, "negative"),
        ("noise_correlation", 1.0, "between"),
        ("stamp_jitter", -1e-3, "negative"),
    ):
        with pytest.raises(UsageError, match=f"{name} must .*{words}"):
            AxisPlant({name: value})
    with pytest.raises(UsageError, match=r"time_delay\.delay must .*negative"):
        AxisPlant({"time_delay.delay": -0.1}, ["time_delay"])
    with pytest.raises(UsageError, match=r"time_delay\.delay is too long"):
        AxisPlant({"time_delay.delay": 10.0}, ["time_delay"])
    with pytest.raises(UsageError, match="stop_high"):
        SolenoidPlant({"stop_low": 0.006})
    with pytest.raises(UsageError, match="restitution"):
        SolenoidPlant({"end_stop_contact.restitution": 1.5}, ["end_stop_contact"])
    for plant in PLANTS.values():
        with pytest.raises(UsageError, match="period"):
            plant(period=0.0)
    with pytest.raises(UnknownNameError, match="dc_motor"):
        plant_of("dcmotor", {}, (), 0, 0.01)


@pytest.mark.parametrize("inductance", [0.1, 1e-4])
@pytest.mark.parametrize("inertia", [0.1, 1e-5])
def test_small_motors_with_brushes_and_bristles_settle_as_large_ones_do(inertia, inductance):
    terms = [*FRICTION, "brush_drop", "presliding_friction"]
    parameters = QUIET_MOTOR | {
        "inertia": inertia, "inductance": inductance, "viscous_friction.coefficient": 0.05,
    }  # fmt: skip
    seen = DcMotorPlant(parameters, terms).simulate(np.full(1600, 5.0))
    # 5 − 0.3 = R·i + K·ω and K·i = c·ω + F, but for the winding's warmth, which it has no effect for
    speed = (0.2 * 4.7 - 1.5 * 0.2) / (0.2**2 + 1.5 * 0.05)
    assert seen.measured["speed"][-1] == pytest.approx(speed, rel=1e-3)
    assert np.std(seen.measured["speed"][-20:]) < 1e-3 * speed
