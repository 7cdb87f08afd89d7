"""White noise of a measured input is taken off; nothing else of an input is."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.physics.ball_beam import BallBeamModel
from labhil.physics.measured_input import smoothing_notes, smoothing_of
from labhil.physics.model import Record, joined
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
    how = smoothing_of(pulled(0.004, stepped))
    assert how is None or how.width <= 5


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
    found = prepared(joined([one, other]))
    assert np.array_equal(found[: len(one)], prepared(one))
    assert np.array_equal(found[len(one) :], CURRENT)
