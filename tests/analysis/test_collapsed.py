"""Collapsed baselines, and errors of values beside which a change has to be significant."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import replay, rig_of, staircase

import labhil as lh
from labhil.analysis.results import finite
from labhil.diagnose.accepted import Accepted
from labhil.diagnose.begin import prepare_data
from labhil.diagnose.collapsed import NEAR_FACTOR, bound_near_nominal, find_collapsed
from labhil.diagnose.diagnosis import _changes, diagnose
from labhil.identify.fitted import fit_terms
from labhil.identify.statistics import estimates_from_errors
from labhil.identify.windows import split
from labhil.physics.ball_beam import BallBeamModel
from labhil.physics.dc_motor import DcMotorModel
from labhil.physics.model import index_of
from labhil.physics.record import Record
from labhil.physics.terms import Parameter
from labhil.rig import parse_rig
from labhil.signals import Hold

GAIN = 5.0 / 7.0 * 9.81
SIZE = Parameter("level", "N", 1.0)


def tilted(seconds: float, seed: int) -> Record:
    """A ball on a tube whose angle reads 0.06 rad too much, pushed about now and then, at rest in between."""
    random, period = np.random.default_rng(seed), 0.01
    n = round(seconds / period)
    t, angle, x, v = period * np.arange(n), np.empty(n), np.empty(n), np.empty(n)
    x[0], v[0], goal = 0.0, 0.0, 0.0
    for k in range(n):
        if k % 300 == 0:
            goal = random.uniform(-0.15, 0.15)
        wanted = float(np.clip(-0.9 * (x[k] - goal) - 0.55 * v[k], -0.25, 0.25))
        angle[k] = 0.06 + wanted
        if k + 1 < n:
            a = GAIN * np.sin(angle[k] - 0.06) - 0.4 * v[k]
            x[k + 1], v[k + 1] = x[k] + period * v[k], v[k] + period * a
    y = x + 1e-3 * random.standard_normal(n)
    return Record(t, angle[:, None], y[:, None], ("beam_angle",), ("ball_position",), ("m",))


def offset(seconds: float, seed: int) -> Record:
    """A ball on a tube whose angle reads 0.06 rad too much, moved on purpose; the motion to 10⁻⁶ m."""
    random, period, parts = np.random.default_rng(seed), 0.01, 20
    n, h = round(seconds / period), period / parts
    t, angle, y = period * np.arange(n), np.empty(n), np.empty(n)
    x, v, goal = 0.0, 0.0, 0.0
    for k in range(n):
        if k % 300 == 0:
            goal = random.uniform(-0.15, 0.15)
        y[k], angle[k] = x, 0.06 + float(np.clip(-0.9 * (x - goal) - 0.55 * v, -0.25, 0.25))
        for _ in range(parts):
            later = v + h * (GAIN * np.sin(angle[k] - 0.06) - 0.4 * v)
            x, v = x + 0.5 * h * (v + later), later
    y += 1e-3 * random.standard_normal(n)
    held = (Hold.ZERO,)
    return Record(
        t, angle[:, None], y[:, None], ("beam_angle",), ("ball_position",), ("m",), input_holds=held
    )


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_an_offset_on_which_the_whole_motion_depends_is_named_instead_of_a_curve():
    record = offset(50.0, 1)
    model = BallBeamModel(parse_rig('[rig]\nkind = "ball_beam"\n', Path("rig.toml")), record)
    learn, judge = split(record, 0.3, model.horizon)
    found = diagnose(model, learn, judge, heldout_is_test=False, baseline=["viscous_friction"])
    first = found.missing[0]
    assert (found.verdict, first.term) == ("missing_physics", "constant_force")
    # the reading's own gain, where it is named too, scales both
    values = {row.name: row.value for row in found.final}
    reading = 1.0 + values.get("sensor_gain.gain", 0.0)
    assert reading * first.parameters[0].value == pytest.approx(-GAIN * np.sin(0.06), rel=0.02)
    assert reading * values["acceleration_per_radian"] == pytest.approx(GAIN, rel=0.02)
    assert found.curve is None


def test_sizes_known_only_as_a_ratio_have_not_collapsed():
    u = staircase(12.0, 0.01, 0.6, 6.0, 1)
    terms, noise = ["viscous_friction", "coulomb_friction"], {"speed_noise": 0.02}
    record = replay("dc_motor", u, terms, noise=noise, seed=1, outputs=("speed",)).record
    model = DcMotorModel(rig_of("dc_motor"), record)
    data = prepare_data(model, record, record)
    fitted = fit_terms(
        model, record, ("viscous_friction",), data.window, data.sigma, start=data.begin, iterations=5
    )
    theta, own = fitted.theta.copy(), ("inertia", "torque_constant", "resistance", "inductance")
    for p, place in index_of(model.parameters).items():
        if p in own:
            theta[place] = model.parameters[place].lower
    assert find_collapsed(data, replace(fitted, theta=theta)) == ()


def test_a_gain_at_its_bound_has_collapsed_and_is_bounded_near_nominal():
    record = tilted(6.0, 1)
    model = BallBeamModel(parse_rig('[rig]\nkind = "ball_beam"\n', Path("rig.toml")), record)
    data = prepare_data(model, record, record)
    place = [p.key for p in model.parameters].index("acceleration_per_radian")

    def at(gain: float):
        theta = data.begin.copy()
        theta[place] = gain
        return fit_terms(
            model, record, ("viscous_friction",), 1.0, data.sigma, start=theta, iterations=0, thorough=False
        )

    (lost,) = find_collapsed(data, at(1e-3))
    assert (lost.key, lost.nominal) == ("acceleration_per_radian", pytest.approx(GAIN))
    assert "far from its nominal or typical 7.007 m/s²" in lost.statement
    assert find_collapsed(data, at(0.5 * GAIN)) == ()
    near = bound_near_nominal(model, [lost]).parameters[place]
    assert near.lower == pytest.approx(GAIN / NEAR_FACTOR) and near.upper == pytest.approx(GAIN * NEAR_FACTOR)
    assert model.parameters[place].lower == 1e-3


def test_a_held_value_has_no_interval():
    (row,) = estimates_from_errors([SIZE], np.array([2.0]), np.array([0.0]))
    assert not row.identifiable and not row.significant
    assert finite(row.ci99) == [None, None] and finite(row.std_error) is None


def test_a_change_has_to_exceed_the_errors_of_both_values():
    (row,) = estimates_from_errors([SIZE], np.array([-10.5]), np.array([0.3]))
    row = replace(row, identifiable=True)

    def accepted(error: float) -> Accepted:
        return Accepted("fit.json", None, (), {"level": -3.25}, ("level",), np.array([[error**2]]))

    assert _changes([row], {"level": -3.25}, accepted(5.7)) == ()
    assert _changes([row], {"level": -3.25}, accepted(float("inf"))) == ()
    assert len(_changes([row], {"level": -3.25}, accepted(0.3))) == 1
    assert len(_changes([row], {"level": -3.25}, None)) == 1
    assert _changes([replace(row, identifiable=False)], {"level": -3.25}, accepted(0.3)) == ()


def geared(seconds: float = 10.0) -> lh.Recording:
    """A motor with 2 Ω, 0.05 N·m/A and 2e-4 kg·m² under a constant 0.0102 N·m, its speed alone recorded."""
    step, period = 1e-4, 2e-3
    t = period * np.arange(int(seconds / period))
    voltage = 6.0 * np.sign(np.sin(2.5 * t)) * (0.5 + 0.5 * np.sin(0.9 * t)) + 1.5 * np.sin(10.7 * t)
    speed, seen = 0.0, np.empty(len(t))
    for i, u in enumerate(voltage):
        seen[i] = speed
        for _ in range(int(period / step)):
            speed += step * (0.05 * (u - 0.05 * speed) / 2.0 - 1e-4 * speed - 0.0102) / 2e-4
    seen += 0.3 * np.random.default_rng(5).standard_normal(len(t))
    return lh.recording(t, {"voltage": voltage}, {"speed": seen}, rig="dc_motor")


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_constant_load_that_collapsed_sizes_of_a_motor_absorb_is_found():
    found = lh.diagnose(geared(), baseline=["viscous_friction"])
    # a motor without dry friction cannot tell the two apart
    named = {effect.term for effect in found.missing} | {rival.term for rival in found.rivals}
    assert {"constant_force", "sensor_offset"} == named
    assert not named & {effect.term for effect in found.excluded}
    (channel,) = found.improvement.per_channel
    assert channel.rmse_after < 1.1 * channel.noise_floor
