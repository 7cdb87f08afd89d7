"""Noise that lasts for a few samples is told from motion, and what is more than noise from noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from labhil.diagnose.adequacy import exceeds_noise, residual_rms_on
from labhil.diagnose.judge import Data
from labhil.identify.fitted import start_theta
from labhil.identify.noise import CORRELATIONS, estimate_coloured_noise
from labhil.identify.score import score, scored_horizon
from labhil.identify.windows import noise_of
from labhil.physics.record import Record

TERMS = ("viscous_friction",)
TRUTH = {"viscous_friction.coefficient": 0.26}
LEVEL = 1e-3


@pytest.fixture(scope="module")
def still(acquire):
    """A recording without any noise but the rounding of sixteen bits."""
    return acquire(TERMS, 1, parameters={"position_noise": 0.0, "adc_bits": 16.0}, duration=30.0)


def noisy(record, correlation, seed=0):
    """The record under first-order noise of standard deviation LEVEL."""
    drive = np.random.default_rng(seed).standard_normal((len(record) + 200, 1))
    noise = signal.lfilter([np.sqrt(1.0 - correlation**2)], [1.0, -correlation], drive, axis=0)[200:]
    return replace(record, outputs=record.outputs + LEVEL * noise)


@pytest.mark.parametrize("correlation", [0.0, 0.4, 0.7, 0.8])
def test_size_and_correlation_of_noise_are_found(model, still, correlation):
    record = noisy(still, correlation)
    theta = start_theta(model, TRUTH)
    found = estimate_coloured_noise(model, theta, record, noise_of(record))
    assert found.sigma[0] == pytest.approx(LEVEL, rel=0.08)
    assert found.correlation[0] == pytest.approx(correlation, abs=0.08)
    left = residual_rms_on(model, theta, record, found, 1.5)
    assert left[0] == pytest.approx(1.0, abs=0.1)


def test_a_motion_that_a_model_lacks_is_no_noise(model, still):
    record = noisy(still, 0.5)
    theta = start_theta(model, {"viscous_friction.coefficient": 0.5})
    found = estimate_coloured_noise(model, theta, record, noise_of(record))
    assert found.sigma[0] < 1.15 * LEVEL
    assert residual_rms_on(model, theta, record, found, 1.5)[0] > 1.5


def test_correlated_noise_makes_initial_states_worse_and_so_the_floor_higher(model, still):
    theta = start_theta(model, TRUTH)
    sigma = np.array([LEVEL])
    white, lasting = (score(model, theta, still, sigma, 4.0, lasts) for lasts in (None, np.array([9.0])))
    carried = [(marks.noise_floor / LEVEL) ** 2 - 1.0 for marks in (white, lasting)]
    assert carried[1] == pytest.approx(9.0 * carried[0], rel=1e-6)


def test_what_is_left_decides(model, still):
    data = Data(model, still, still, np.array([LEVEL]), np.array([LEVEL]), 1.5, start_theta(model, TRUTH))
    assert not exceeds_noise(data, np.array([1.1]))
    assert exceeds_noise(data, np.array([1.0, 1.3]))


class Undamped:
    """A model whose horizon follows from its vector."""

    def horizon_at(self, theta):
        return float(theta[0])


def test_a_horizon_longer_than_the_recording_is_cut_to_what_fits_twice(still):
    assert still.max_horizon == pytest.approx(0.4 * 29.99)
    assert scored_horizon(Undamped(), np.array([1e3]), still) == still.max_horizon
    assert scored_horizon(Undamped(), np.array([3.0]), still) == 3.0


def test_correlations_are_looked_for_in_order():
    assert np.all(np.diff(CORRELATIONS) > 0.0)


@pytest.mark.parametrize("jitter", [0.0, 0.15])
def test_a_fast_motion_at_uneven_stamps_is_no_noise(jitter: float) -> None:
    """Third differences of even weights would take 0.6 m/s at stamps 0.75 ms off for many times the noise."""
    random = np.random.default_rng(7)
    t = 0.005 * (np.arange(4000) + random.uniform(-jitter, jitter, 4000))
    x = 0.2 * np.sin(2.0 * np.pi * 0.5 * t) + random.normal(0.0, 2.5e-5, len(t))
    record = Record(t, x[:, None], x[:, None], ("drive_force",), ("position",), ("m",))
    assert noise_of(record)[0] == pytest.approx(2.5e-5, rel=0.05)
