"""White noise of a measured input is taken off; nothing else of an input is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import labhil as lh
from labhil.identify.fitted import fit_terms
from labhil.identify.score import score
from labhil.identify.windows import noise_of, with_noise_scales
from labhil.physics.ball_beam import BallBeamModel
from labhil.physics.joining import join_records
from labhil.physics.measured_input import smoothing_notes
from labhil.physics.record import Begin, Record
from labhil.physics.rigs import model_for
from labhil.plants.rigs import plant_of
from labhil.rig import default_rig
from labhil.signals import FloatArray, Hold

T = 1e-3 * np.arange(8000)
CURRENT = 1.05 + 0.45 * np.sin(8.2 * T) + 0.3 * np.sin(19.5 * T + 1.0) + 0.2 * np.sin(46.0 * T + 2.0)


def pulled(noise: float, current: FloatArray = CURRENT) -> Record:
    values = {"coil_current_noise": noise, "plunger_position_noise": 1e-5}
    made = plant_of("solenoid", values, ["viscous_friction", "coulomb_friction"], 3, 1e-3).simulate(current)
    names = (("coil_current",), ("plunger_position",), ("m",))
    return Record(made.t, made.input[:, None], made.measured["plunger_position"][:, None], *names)


def prepared(record: Record) -> FloatArray:
    return np.asarray(model_for(default_rig("solenoid"), record).prepare(record).inputs[:, 0])


def test_a_model_is_not_driven_by_the_noise_of_a_measured_current():
    noisy = pulled(0.004)
    assert np.std(noisy.inputs[:, 0] - CURRENT) == pytest.approx(0.004, rel=0.05)
    assert np.std(prepared(noisy) - CURRENT) < 0.0015
    (told,) = smoothing_notes(noisy, "A")
    assert "white noise of 0.004" in told and "smoothed over" in told


def test_an_input_without_noise_stays_as_it_is():
    assert np.array_equal(prepared(pulled(0.0)), CURRENT)
    assert smoothing_notes(pulled(0.0), "A") == []


def test_what_jumps_is_not_smeared():
    stepped = np.where(T % 0.4 < 0.2, 0.8, 1.2)
    off = np.abs(prepared(pulled(0.004, stepped)) - stepped)
    assert np.max(off) < 0.03


def test_a_command_and_an_input_that_is_noise_itself_stay_as_they_are():
    random = np.random.default_rng(0)
    noise = 1.0 + 0.3 * random.standard_normal(len(T))
    assert np.array_equal(prepared(pulled(0.0, noise)), noise)
    y = 0.01 * np.sin(T)[:, None]
    angle = (0.1 * np.sin(3.0 * T) + 1e-3 * random.standard_normal(len(T)))[:, None]
    for name, hold in (("servo_angle", Hold.LINEAR), ("beam_angle", Hold.ZERO)):
        record = Record(T, angle, y, (name,), ("ball_position",), ("m",), (hold,))
        assert np.array_equal(BallBeamModel(default_rig("ball_beam"), record).prepare(record).inputs, angle)


def test_each_recording_is_smoothed_by_itself():
    one, other = pulled(0.004), pulled(0.0)
    found = prepared(join_records([one, other]))
    assert np.array_equal(found[: len(one)], prepared(one))
    assert np.array_equal(found[len(one) :], CURRENT)


QUIET = 0.85 + 0.25 * np.sin(8.2 * T) + 0.15 * np.sin(19.5 * T + 1.0) + 0.1 * np.sin(46.0 * T + 2.0)
"""A current that keeps the plunger off its stops."""

FRICTION = ("viscous_friction", "coulomb_friction")


@pytest.mark.extended
def test_what_the_noise_of_a_measured_input_makes_of_a_simulation_is_in_the_floor():
    record = pulled(0.004, QUIET)
    model = model_for(default_rig("solenoid"), record)
    prepared_record = with_noise_scales(model, model.prepare(record))
    sigma = noise_of(prepared_record)
    fitted = fit_terms(model, prepared_record, FRICTION, 0.1, sigma)
    (channel,) = score(model, fitted.theta, prepared_record, sigma).channels
    assert channel.noise_floor > 1.15 * sigma[0]
    assert 0.8 < channel.rmse / channel.noise_floor < 1.2
    silent = replace(prepared_record, begins=(Begin(),))
    (unknown,) = score(model, fitted.theta, silent, sigma).channels
    assert unknown.noise_floor < 0.9 * channel.noise_floor


@pytest.mark.extended
@pytest.mark.timeout(600)
def test_an_exact_model_under_a_noisy_measured_current_has_no_mismatch():
    made = pulled(0.004, QUIET)
    recording = lh.recording(
        made.t,
        {"coil_current": made.inputs[:, 0]},
        {"plunger_position": made.outputs[:, 0]},
        rig="solenoid",
    )
    assert lh.diagnose(recording, baseline=FRICTION).verdict == "no_mismatch"


def balanced(seed: int, offset: float, seconds: float = 30.0) -> lh.Recording:
    """A ball held by a controller on a beam whose angle is measured ``offset`` rad wrong, 100 Hz."""
    random, step = np.random.default_rng(seed), 1e-3
    x, v, angle, rate_of_error, last, summed = 0.03, 0.0, offset, 0.0, 0.0, 0.0
    rows = []
    for k in range(int(seconds / step)):
        if k % 10 == 0:
            wanted = (0.05, 0.02, 0.065)[min(int(k * step / 10.0), 2)]
            reading = round(1e3 * (x + 1.2e-3 * random.standard_normal())) / 1e3
            error = wanted - reading
            rate_of_error = 0.9 * rate_of_error + 0.1 * (error - (last if k else error)) / 0.01
            last, summed = error, summed + 0.01 * error
            command = np.clip(2.0 * error + 0.8 * rate_of_error + summed, -0.4, 0.4)
            rows.append((k * step, angle + 7e-3 * random.standard_normal(), reading))
        turning = (command - angle) / 0.05
        angle += step * turning
        v += step * (7.007 * np.sin(angle - offset) + 5.0 / 7.0 * x * turning**2 - v)
        x += step * v
    t, beam_angle, position = np.array(rows).T
    return lh.recording(t, {"beam_angle": beam_angle}, {"ball_position": position}, rig="ball_beam")


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_beam_angle_that_is_noisy_and_off_is_a_constant_push_not_a_dead_zone(seed: int):
    found = lh.diagnose(balanced(seed, 0.041), baseline=["viscous_friction"])
    assert "constant_force" in [effect.term for effect in found.missing]
    assert not {"dead_zone", "sensor_offset", "backlash"} & {effect.term for effect in found.missing}
    rows = {row.name: row for row in found.final.parameters}
    low, high = rows["acceleration_per_radian"].ci99
    assert low < 7.007 < high
    low, high = rows["constant_force.force"].ci99
    assert low < -7.007 * 0.041 < high
