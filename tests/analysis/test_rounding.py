"""What rounding leaves that noise does not dither."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labhil.diagnose.evidence import independent_samples
from labhil.identify.rounding import Rounding, effective_fractions
from labhil.physics.record import Record

STEP = 0.02


def rounded(values, deviation, random):
    return STEP * np.rint((values + deviation * STEP * random.standard_normal(values.shape)) / STEP)


@pytest.mark.parametrize("deviation", [0.0, 0.1, 0.2, 0.35])
def test_the_error_of_a_rounded_reading_is_that_of_many(deviation):
    random = np.random.default_rng(5)
    readings = STEP * np.arange(-40.0, 40.0)
    found = Rounding.of(readings, STEP * np.sqrt(deviation**2 + 1.0 / 12.0))
    assert found is not None
    assert found.step == pytest.approx(STEP)
    values = STEP * np.linspace(-1.03, 1.02, 57)
    many = rounded(np.tile(values, (20_000, 1)), deviation, random)
    # within a place of a jump the table is between both sides
    near = np.abs(np.mod(values / STEP, 1.0) - 0.5) < 0.005
    off = np.abs(found.mean_error(values, 0.0) - (many.mean(axis=0) - values))
    assert np.max(off[~near]) < 0.012 * STEP


def test_noise_as_large_as_a_step_leaves_nothing_that_lasts():
    readings = STEP * np.arange(-40.0, 40.0)
    assert Rounding.of(readings, STEP * np.sqrt(0.6**2 + 1.0 / 12.0)) is None
    assert Rounding.of(np.random.default_rng(1).standard_normal(50), 1.0) is None
    whole = Rounding.of(readings, STEP / np.sqrt(12.0))
    assert whole is not None
    assert whole.share == pytest.approx(1.0, abs=0.02)


def test_a_phase_moves_the_steps():
    found = Rounding.of(STEP * np.arange(9.0), STEP / np.sqrt(12.0))
    assert found is not None
    values = STEP * np.array([0.1, 0.3])
    assert found.mean_error(values, 0.5) == pytest.approx(found.mean_error(values + 0.5 * STEP, 0.0))


def test_a_reading_that_repeats_itself_tells_nothing_new():
    """Each value of a slow ramp twenty times; noise of a whole step makes every reading one of its own."""
    ramp, random = STEP * np.arange(2000)[:, None] / 20.0, np.random.default_rng(3)
    record = Record(0.01 * np.arange(2000), np.zeros_like(ramp), ramp, ("force",), ("position",), ("m",))
    for deviation, least, most in ((0.0, 0.04, 0.06), (0.1, 0.05, 0.5), (0.6, 1.0, 1.0)):
        sigma = np.array([STEP * np.sqrt(deviation**2 + 1.0 / 12.0)])
        share = effective_fractions(replace(record, outputs=rounded(ramp, deviation, random)), sigma).mean()
        assert least <= share <= most
        white = random.standard_normal((4000, 1))
        assert independent_samples(white, effective_fraction=share) == pytest.approx(
            4000 * min(share, 1.0), rel=0.05
        )


def test_a_channel_at_rest_tells_little_though_noise_flips_its_last_digit():
    """A thousand readings of one place have one lasting error; those of a quick motion each their own."""
    random, deviation = np.random.default_rng(4), 0.2
    values = np.r_[np.full(1000, 0.3), 0.3 + np.linspace(0.0, 50.0, 1000)][:, None] * STEP
    record = Record(0.01 * np.arange(2000), np.zeros_like(values), values, ("force",), ("position",), ("m",))
    sigma = np.array([STEP * np.sqrt(deviation**2 + 1.0 / 12.0)])
    readings = rounded(values, deviation, random)
    shares = effective_fractions(replace(record, outputs=readings), sigma)
    lasting = Rounding.of(readings[:, 0], float(sigma[0]))
    assert lasting is not None
    # a mean of the readings at rest is off by the lasting error, however many there are
    assert shares[:990].sum() < 1.5 / lasting.share
    assert shares[1010:].mean() > 10.0 * shares[:990].mean()
    assert abs(readings[:1000].mean() - values[0, 0]) > 3.0 * sigma[0] / np.sqrt(1000.0)
