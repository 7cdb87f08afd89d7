"""Dry friction of elements that stick and slip one by one, against what can be worked out by hand."""

from itertools import pairwise

import numpy as np
import pytest

from labhil.errors import UsageError
from labhil.plants.axis import AXIS, AxisPlant
from labhil.plants.ball_beam import BallBeamPlant
from labhil.plants.friction import ELEMENTS, Friction, bristle_force, bristle_level, relax_bristles
from labhil.plants.integrator import V, X
from labhil.plants.maxwell import N_ELEMENT_STATES, held_force, relax_elements
from labhil.plants.rigs import plant_of

LEVEL, STIFFNESS, SPREAD = 20.0, 2e6, 10.0
QUIET = {name: 0.0 for name in AXIS.bare if name.endswith("_noise")}
TERMS = ("viscous_friction", "coulomb_friction", "maxwell_slip_friction")
DRY = {"coulomb_friction.level": LEVEL}
ELASTIC = {"stiffness": STIFFNESS, "spread": SPREAD, "attraction": 5e3}
LIGHT = QUIET | {"moving_mass": 5.0} | DRY
VALUES = QUIET | DRY | {f"maxwell_slip_friction.{name}": value for name, value in ELASTIC.items()}

SOFTER = SPREAD ** (-np.arange(ELEMENTS) / (ELEMENTS - 1.0))
SPRINGS = STIFFNESS * SOFTER / SOFTER.sum()
SHARE = LEVEL / ELEMENTS
YIELDS = SHARE / SPRINGS
"""How far (m) each element bends before it slips: 4.4, 9.6, 21 and 44 µm."""


def virgin(x):
    """Force (N) at ``x`` (m) of elements that were never loaded before."""
    return np.sum(np.minimum(np.multiply.outer(x, SPRINGS), SHARE), axis=-1)


def way_at(force):
    """How far (m) elements that were never loaded before bend under a force (N)."""
    corners = np.r_[0.0, YIELDS]
    return np.interp(force, virgin(corners), corners)


def pulled(path, speed=1e-6):
    """Force (N) at each place (m) of a part that is pulled from place to place."""
    f, s = Friction.of(VALUES), np.zeros(N_ELEMENT_STATES)
    forces = [0.0]
    for way in np.diff(path):
        relax_elements(s, np.sign(way) * speed, LEVEL, abs(way) / speed, f)
        forces.append(held_force(s))
    return np.array(forces)


def pulled_on_bristles(path, speed=1e-6):
    """The same of bristles (LuGre)."""
    f = Friction.of(DRY | {"presliding_friction.stiffness": STIFFNESS})
    z, forces = 0.0, [0.0]
    for way in np.diff(path):
        v = np.sign(way) * speed
        z = relax_bristles(z, v, LEVEL, abs(way) / speed, f)
        forces.append(bristle_force(z, v, LEVEL, f))
    return np.array(forces)


def legs(*places, n=40):
    """A path through the places (m), each leg in n parts."""
    parts = [np.linspace(a, b, n + 1)[1:] for a, b in pairwise(places)]
    return np.r_[places[0], np.concatenate(parts)]


@pytest.mark.parametrize("far", [0.5 * YIELDS[0], 1.2 * YIELDS[2], 3.0 * YIELDS[3]])
@pytest.mark.parametrize("speed", [1e-6, 0.5])
def test_a_reversal_follows_the_virgin_curve_twice_as_large(far, speed):
    """Masing's rules: F = F_r ∓ 2·f(|x_r − x|/2), whether some, all or no elements have slipped."""
    path = legs(0.0, far, -far, far)
    force, top = pulled(path, speed), virgin(far)
    np.testing.assert_allclose(force[:41], virgin(path[:41]), atol=1e-9 * LEVEL)
    np.testing.assert_allclose(force[40:81], top - 2.0 * virgin((far - path[40:81]) / 2), atol=1e-9 * LEVEL)
    np.testing.assert_allclose(force[80:], -top + 2.0 * virgin((far + path[80:]) / 2), atol=1e-9 * LEVEL)


def test_an_axis_that_is_pushed_slowly_follows_the_same_rules():
    most = 0.9 * LEVEL
    force = most * np.interp(np.arange(4001), [0, 1000, 3000, 4000], [0.0, 1.0, -1.0, 0.0])
    x = AxisPlant(VALUES | LIGHT, TERMS[1:], period=0.01).simulate(force).truth["position"]
    np.testing.assert_allclose(x[:1001], way_at(force[:1001]), atol=1e-2 * x.max())
    far = way_at(most)
    np.testing.assert_allclose(
        x[1000:3001], far - 2.0 * way_at((most - force[1000:3001]) / 2), atol=1e-2 * far
    )
    np.testing.assert_allclose(x[3000:], -far + 2.0 * way_at((most + force[3000:]) / 2), atol=1e-2 * far)


def test_a_small_loop_closes_and_the_large_curve_goes_on_as_if_it_had_not_been():
    """15 µm, back to 3 µm, within that 12 and 4 µm, and on: bristles know nothing of where they turned."""
    turn, far = 15e-6, 60e-6
    plain, looped = legs(0.0, turn, far), legs(0.0, turn, 3e-6, 12e-6, 4e-6, 12e-6, 3e-6, turn, far)
    force, loop = pulled(plain), pulled(looped)
    inner = loop[80:161]
    assert np.ptp(inner) > 0.3 * LEVEL
    assert loop[120] < force[40] - 0.05 * LEVEL
    assert loop[200] == pytest.approx(loop[120], abs=1e-9 * LEVEL)
    assert loop[240] == pytest.approx(loop[80], abs=1e-9 * LEVEL)
    np.testing.assert_allclose(loop[280:], force[40:], atol=1e-9 * LEVEL)
    bristles, bent = pulled_on_bristles(plain), pulled_on_bristles(looped)
    assert bent[200] < bent[120] - 0.01 * LEVEL
    assert bent[280] < bristles[40] - 0.05 * LEVEL


def test_a_trembling_load_makes_bristles_creep_and_elements_stay():
    t = 0.001 * np.arange(4001)
    force = 10.0 * np.minimum(t / 0.5, 1.0) + np.where(
        t > 0.5, 4.0 * np.sin(2.0 * np.pi * 5.0 * (t - 0.5)), 0.0
    )
    ways = {}
    for carrier in ("maxwell_slip_friction", "presliding_friction"):
        parameters = LIGHT | {f"{carrier}.stiffness": STIFFNESS}
        x = AxisPlant(parameters, ("coulomb_friction", carrier)).simulate(force).truth["position"]
        ways[carrier] = x[3900] - x[1100], x[1100]
    creep, reach = ways["presliding_friction"]
    assert creep > 0.5 * reach
    stays, reach = ways["maxwell_slip_friction"]
    assert abs(stays) < 1e-3 * reach


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_steady_sliding_is_the_level_at_that_speed_and_viscous_friction(side):
    terms = (*TERMS, "stribeck_friction", "friction_asymmetry")
    parameters = VALUES | {
        "viscous_friction.coefficient": 204.0, "stribeck_friction.level": 8.0,
        "stribeck_friction.velocity": 0.05, "friction_asymmetry.coefficient": 0.0,
        "friction_asymmetry.level": 3.0,
    }  # fmt: skip
    plant = AxisPlant(parameters, terms)
    v = plant.simulate(np.full(8001, side * 40.0)).truth["velocity"][-1]
    level = LEVEL + 8.0 * np.exp(-abs(v) / 0.05) + side * 3.0
    elements = plant.simulation.simulate(np.zeros(1))[0][
        0, -1 - N_ELEMENT_STATES : -1 - N_ELEMENT_STATES + ELEMENTS
    ]
    assert 0.03 < side * v < 0.12
    np.testing.assert_allclose(elements, side * level / ELEMENTS, rtol=1e-6)
    assert 204.0 * v + side * level == pytest.approx(side * 40.0, rel=1e-6)


def test_what_slips_lags_behind_the_level():
    """From 28 N to 20 N at once: F = s + (F₀ − s)·exp(−C·t/s) of those that slip."""
    f, s = Friction.of(VALUES), np.zeros(N_ELEMENT_STATES)
    relax_elements(s, 0.01, 28.0, 1.0, f)
    relax_elements(s, 0.1, LEVEL, 2e-3, f)
    assert held_force(s) == pytest.approx(LEVEL + 8.0 * np.exp(-5e3 * 2e-3 / LEVEL), rel=1e-9)
    relax_elements(s, 0.1, LEVEL, 1.0, f)
    assert held_force(s) == pytest.approx(LEVEL, rel=1e-9)


@pytest.mark.extended
@pytest.mark.parametrize("load", [0.4 * LEVEL, 0.9 * LEVEL])
def test_a_part_under_less_than_the_hold_stays_and_springs_back(load):
    """All of the way where no element has yielded, else what Masing's rule leaves."""
    assert virgin(YIELDS[0]) > 0.4 * LEVEL
    force = load * np.interp(np.arange(5001), [0, 1500, 2500, 4000], [0.0, 1.0, 1.0, 0.0])
    seen = AxisPlant(VALUES | LIGHT, TERMS[1:], period=0.01).simulate(force).truth
    x, far = seen["position"], way_at(load)
    assert x[2400] == pytest.approx(far, rel=5e-3)
    assert np.ptp(x[2400:2500]) < 1e-3 * far
    assert x[-1] == pytest.approx(far - 2.0 * way_at(load / 2), abs=5e-3 * far)


def test_no_cycle_gives_back_more_than_it_took():
    """No moment takes less work than the springs take up, at whatever Stribeck speeds the part is moved."""
    f = Friction.of(VALUES | {"stribeck_friction.level": 30.0, "stribeck_friction.velocity": 0.01})
    random, h = np.random.default_rng(0), 2e-5
    speeds = np.interp(np.arange(20000), np.arange(0, 20000, 100), 0.02 * random.standard_normal(200))
    s, lost = np.zeros(N_ELEMENT_STATES), []
    for v in speeds:
        before = s[:ELEMENTS].copy()
        relax_elements(s, v, bristle_level(0.0, v, np.sign(v), f), h, f)
        middle, gained = 0.5 * (before + s[:ELEMENTS]), s[:ELEMENTS] - before
        lost.append(np.sum(middle * (v * h - gained / SPRINGS)))
    assert np.sum(lost) > 0.05
    assert np.min(lost) > -1e-9 * np.max(lost)


def test_an_axis_that_is_let_go_loses_energy_all_the_time_and_stops():
    terms = (*TERMS, "stribeck_friction", "static_friction")
    plant = AxisPlant(VALUES, terms)
    plant.simulate(np.full(401, 150.0))
    rows, _ = plant.simulation.simulate(np.zeros(3001))
    springs = np.sum(
        0.5 * rows[:, -1 - N_ELEMENT_STATES : -1 - N_ELEMENT_STATES + ELEMENTS] ** 2 / SPRINGS, axis=1
    )
    energy = 0.5 * 95.0 * rows[:, V] ** 2 + springs
    assert energy[0] > 5.0
    assert np.all(np.diff(energy[1:]) <= 1e-9 * energy[0])
    assert np.max(np.abs(rows[-500:, V])) < 1e-6
    assert np.ptp(rows[-500:, X]) < 1e-9
    assert rows[-1, X] > 0.1
    assert rows[1000, V] == pytest.approx(0.0, abs=1e-2)


def test_a_ball_and_an_axis_of_one_mass_move_alike():
    """Two integrators of the same law: a mass on a spring that swings, slips, creeps and comes to rest."""
    shared = {
        "coulomb_friction.level": 0.09, "stribeck_friction.level": 0.04, "stribeck_friction.velocity": 0.02,
        "constant_force.force": 0.5, "spring_force.stiffness": 2.0, "viscous_friction.coefficient": 0.1,
        "maxwell_slip_friction.stiffness": 500.0, "maxwell_slip_friction.damping": 5.0,
        "maxwell_slip_friction.spread": 6.0, "maxwell_slip_friction.attraction": 5.0,
    }  # fmt: skip
    terms = (*TERMS, "stribeck_friction", "constant_force", "spring_force")
    ball = BallBeamPlant({"stop": 50.0} | shared, terms).simulate(np.zeros(801))
    axis = AxisPlant(QUIET | {"moving_mass": 1.4 * 0.261} | shared, terms, period=0.01).simulate(
        np.zeros(801)
    )
    x = axis.truth["position"]
    assert np.sum(np.diff(np.sign(np.diff(x[x > 0.15]))) != 0) >= 2
    np.testing.assert_allclose(ball.position, x, atol=2e-5)


@pytest.mark.parametrize("kind", ["ball_beam", "dc_motor", "axis", "solenoid"])
def test_one_step_after_the_other_is_the_whole_run_and_the_same_again(kind):
    size = {"ball_beam": 0.3, "dc_motor": 3.0, "axis": 60.0, "solenoid": 0.8}[kind]
    period, u = 0.01 if kind in ("ball_beam", "dc_motor") else 0.001, np.zeros(401)
    u[1:] = (
        size
        * (1.0 + np.sin(0.05 * np.arange(400)))
        * (1.0 if kind == "solenoid" else np.cos(0.02 * np.arange(400)))
    )
    first, again, other = (plant_of(kind, {}, TERMS, seed, period).simulate(u) for seed in (1, 1, 2))
    plant = plant_of(kind, {}, TERMS, 1, period)
    plant.simulate(u[:1])
    steps = [plant.step(float(value)) for value in (u[:-1] if kind in ("dc_motor", "axis") else u[1:])]
    name = next(iter(steps[0]))
    assert np.array_equal(first.measured[name], again.measured[name])
    for key, values in first.truth.items():
        assert np.array_equal(values, other.truth[key])
    np.testing.assert_allclose([s[name] for s in steps], first.measured[name][1:], rtol=1e-9, atol=1e-12)


def test_elements_that_make_no_world_are_refused():
    for plant in (AxisPlant, BallBeamPlant):
        with pytest.raises(UsageError, match="both carry the dry friction"):
            plant(terms=("coulomb_friction", "presliding_friction", "maxwell_slip_friction"))
        for name in ("stiffness", "spread", "attraction"):
            with pytest.raises(UsageError, match=f"maxwell_slip_friction.{name} must be a positive"):
                plant({f"maxwell_slip_friction.{name}": 0.0}, TERMS)
    with pytest.raises(UsageError, match="maxwell_slip_friction needs a dry friction"):
        BallBeamPlant(terms=["maxwell_slip_friction"])
