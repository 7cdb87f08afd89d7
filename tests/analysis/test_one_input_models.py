"""What the models of motor, axis and solenoid have in common: neutral terms, windows, smooth costs."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.errors import UsageError
from labhil.physics.model import index_of, starts_of, terms_named
from labhil.physics.record import Windows
from labhil.physics.rigs import model_for
from labhil.physics.solenoid import AMPLIFIER_TERMS
from labhil.plants.rigs import effects_of
from labhil.rig import default_rig

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import Replay, places_of, replay, staircase, two_tones, without

DRY = ("viscous_friction", "coulomb_friction", "stribeck_friction")
RIGS = {
    "dc_motor": (staircase(10.0, 0.01, 0.4, 5.0, 1), "inertia = 0.1\n", 0.01),
    "axis": (staircase(2.0, 1e-3, 0.1, 80.0, 1), "moving_mass = 95.0\n", 1e-3),
    "solenoid": (two_tones(1.2), "stop_low = 0.0\nstop_high = 0.005\n", 1e-3),
}


@pytest.fixture(scope="module", params=RIGS)
def found(request) -> Replay:
    u, known, period = RIGS[request.param]
    return replay(request.param, u, DRY, known=known, period=period)


def outputs(found: Replay, theta: np.ndarray, windows: Windows) -> np.ndarray:
    return found.model.simulate(theta, found.record, windows, found.states[windows.first])


@pytest.mark.extended
def test_every_term_is_neutral_at_zero_and_shows_at_its_start(found):
    n, places = len(found.record), index_of(found.model.parameters)
    windows = Windows.of([(100, n // 2), (n // 2, n)])
    dry = without(found, [key for key in found.model.terms if key not in DRY]).theta
    plain = outputs(found, dry, windows)
    scale = np.sqrt(np.mean(plain**2, axis=0))
    for key, term in found.model.terms.items():
        if key in DRY:
            continue
        neutral = dry.copy()
        for parameter in term.parameters:
            neutral[places[parameter.key]] = parameter.neutral
        assert np.array_equal(outputs(found, neutral, windows), plain), key
        begun = dry.copy()
        for name, value in starts_of(found.model, (term,), found.record)[-1].items():
            begun[places[name]] = value or 0.1 * found.model.parameters[places[name]].scale
        changed = np.abs(outputs(found, begun, windows) - plain).max(axis=0) / scale
        assert changed.max() > 1e-5, key


def test_terms_are_documented_and_their_starts_lie_within_bounds(found):
    measure = found.model.characteristic_scales(found.record)
    for key, term in found.model.terms.items():
        assert all((term.statement, term.equation, term.source, term.revealed_by)), key
        assert term.parameters, key
        for p in term.parameters:
            assert p.unit, p.key
            assert p.scale > 0.0, p.key
            assert p.neutral == 0.0 if p.is_positive else p.lower <= p.neutral <= p.upper, p.key
            for start in p.starts:
                assert p.lower <= start * measure[p.of] ** p.power <= p.upper, p.key


def test_windows_are_simulated_each_on_its_own(found):
    n = len(found.record)
    spans = [(50, 200), (200, 201), (150, 400), (n - 100, n)]
    together = outputs(found, found.theta, Windows.of(spans))
    alone = [outputs(found, found.theta, Windows.of([span])) for span in spans]
    assert np.array_equal(together, np.concatenate(alone))


def test_a_window_goes_on_from_any_state_on_its_way(found):
    """Cutting in two moves the steps a little, and nothing else."""
    n, middle = len(found.record), 300
    whole = outputs(found, found.theta, Windows.of([(100, n)]))
    along = found.model.coordinates(found.theta, found.record, Windows.of([(100, n)]), found.states[100:101])
    state = np.array([[along[name][middle - 100] for name in found.model.state_names]])
    rest = found.model.simulate(found.theta, found.record, Windows.of([(middle, n)]), state)
    scale = np.abs(whole).max(axis=0)
    assert np.all(np.abs(rest - whole[middle - 100 :]).max(axis=0) < 1e-5 * scale)


def test_outputs_change_smoothly_with_every_parameter(found):
    """Slopes over a step and over half of it agree: no parameter makes the simulation jump."""
    windows = Windows.of([(100, len(found.record))])
    at = outputs(found, found.theta, windows)
    for i in places_of(found.model, DRY):
        slopes = []
        for share in (1e-5, 5e-6):
            theta = found.theta.copy()
            theta[i] *= 1.0 + share
            slopes.append((outputs(found, theta, windows) - at) / share)
        curved = np.sqrt(np.mean((slopes[0] - slopes[1]) ** 2)) / np.sqrt(np.mean(slopes[0] ** 2))
        assert curved < 0.02, found.model.parameters[i].key


def test_effort_is_the_slope_of_velocity_where_it_moves(found):
    windows = Windows.of([(100, len(found.record))])
    along = found.model.coordinates(found.theta, found.record, windows, found.states[100:101])
    v = along[found.model.state_names[-1 if found.model.kind != "dc_motor" else 0]]
    inertia = {"dc_motor": 0.1, "axis": 95.0, "solenoid": 0.064}[found.model.kind]
    force = found.model.generalised_force(found.theta, along)
    assert np.all(force[v == 0.0] == 0.0)
    moves = np.concatenate(([False], v[2:] * v[:-2] > 0.0, [False]))
    assert np.mean(moves) > 0.1
    slope = np.gradient(v, found.record.t[windows.rows])
    close = np.abs(inertia * slope - force)[moves] < 0.15 * np.abs(force).max()
    assert np.mean(close) > 0.9


def test_scales_come_from_the_record_or_are_typical(found):
    model = model_for(default_rig(found.model.kind))
    assert model.horizon > 0.0
    assert set(found.model.terms) - set(model.terms) <= {"added_inertia"}
    stated = replace(found.record, auxiliary={})
    few = model_for(default_rig(found.model.kind), stated)
    for key, term in model.terms.items():
        assert key in few.terms or set(term.needs) == set(
            few.unobservable_terms[key].removeprefix("needs ").split(", ")
        )


def test_behind_a_measured_current_there_is_no_amplifier():
    """Its lag is the field's lag to the letter, its play the iron's: only one of each pair has a name."""
    model = model_for(default_rig("solenoid"))
    assert set(AMPLIFIER_TERMS).isdisjoint(model.terms)
    assert set(AMPLIFIER_TERMS) <= set(model.unobservable_terms)
    assert set(AMPLIFIER_TERMS).isdisjoint(effects_of("solenoid"))
    with pytest.raises(UsageError, match=r"actuator_lag.* the current is measured"):
        terms_named(model, ["viscous_friction", "actuator_lag"])


@pytest.mark.parametrize("terms", [(), ("spring_force",), ("coulomb_friction", "static_friction")])
def test_a_fit_of_an_axis_starts_near_its_mass_whatever_holds_it(terms):
    """A spring that holds the axis near zero all the time: the mass is a small part of what pushes."""
    stiff = {"spring_force.stiffness": 400.0} if terms == ("spring_force",) else {}
    made = replay("axis", staircase(20.0, 0.01, 0.5, 60.0), terms, stiff, noise={"position_noise": 1e-5})
    (mass,) = [p for p in made.model.parameters if p.name == "moving_mass"]
    assert mass.starts[0] == pytest.approx(95.0, rel=0.1)
