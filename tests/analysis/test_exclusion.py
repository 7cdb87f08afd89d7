"""Exclusion limits of absent effects, with noise alone and with other model errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labhil.diagnose.begin import prepare_data
from labhil.diagnose.discrepancy import absent_effects
from labhil.diagnose.exclusions import exclusions
from labhil.identify.fitted import fit_terms
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.rig import default_rig
from labhil_benchmarks.statistics.cases import driven, held_ball, levels

DRY = ("viscous_friction", "coulomb_friction")
CHANNELS = (("speed", "rad/s"), ("current", "A"))


def limits(record: Record) -> dict[str, float]:
    model = model_for(default_rig("dc_motor"), record)
    data = prepare_data(model, record, record)
    found = fit_terms(model, record, DRY, data.window, data.sigma, start=data.begin, iterations=8)
    stated, _ = exclusions(absent_effects(found), ())
    return {item.term: item.largest_hidden for item in stated}


def test_model_errors_hide_larger_effects_than_noise_of_the_same_size():
    random = np.random.default_rng(2)
    u = levels(1500, 40, 5.0, random)
    clean = driven("dc_motor", u, 0.01, {}, DRY, 50.0, False, random, CHANNELS)[0]
    size = 0.1 * np.std(clean.outputs[:, 0])
    # a slow wandering of a few seconds, and noise of the same size
    slow = np.convolve(random.standard_normal(2500), np.ones(200), mode="same")[500:2000]
    errors = (size * slow / np.std(slow), size * random.standard_normal(len(slow)))
    left, noisy = (
        limits(replace(clean, outputs=clean.outputs + np.column_stack([each, np.zeros(len(each))])))
        for each in errors
    )
    offset = "constant_force"
    assert left[offset] > 2.0 * noisy[offset]
    assert limits(clean)[offset] < 0.3 * noisy[offset]


def test_a_limit_above_all_that_was_measured_excludes_nothing():
    """Beside a missing dry friction an error of the sensor's gain could be several times the gain itself."""
    random = np.random.default_rng(4)
    record = held_ball(DRY, {"coulomb_friction.level": 0.09}, 4e-4 * random.standard_normal(2000), 1.0)
    model = model_for(default_rig("ball_beam"), record)
    data = prepare_data(model, record, record)
    fitted = fit_terms(model, record, DRY[:1], data.window, data.sigma, start=data.begin)
    stated, unseen = exclusions(absent_effects(fitted), ())
    largest = {"m": float(np.ptp(record.outputs)), "1": 1.0}
    assert all(item.largest_hidden <= largest.get(item.unit, np.inf) for item in stated)
    assert {item.term for item in unseen} == {"sensor_gain"}
