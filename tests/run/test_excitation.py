from __future__ import annotations

from math import pi

import numpy as np
import pytest

from labhil.errors import UnknownNameError
from labhil.experiment.excitation import (
    ExcitationKeys,
    chirp,
    crest_factor,
    hold,
    make_excitation,
    multisine,
    sample_at_rate,
    schroeder_phases,
    steps,
    two_sine,
)

RATE = 100.0


def test_two_sines_are_the_sum_of_two_sines() -> None:
    t = np.arange(6000) / RATE
    expected = 0.6 * np.sin(2 * pi * 0.23 * t) + 0.6 * np.sin(2 * pi * 0.31 * t)
    np.testing.assert_allclose(sample_at_rate(two_sine([0.23, 0.31], 0.6), 60.0, RATE), expected, atol=1e-12)


def test_phases_amplitudes_and_offset_go_by_tone() -> None:
    t = np.arange(500) / RATE
    expected = 0.1 + 0.5 * np.sin(2 * pi * 0.4 * t + 0.3) + 0.2 * np.sin(2 * pi * 1.1 * t - 1.0)
    made = multisine([0.4, 1.1], [0.5, 0.2], phases=[0.3, -1.0], offset=0.1)
    np.testing.assert_allclose(sample_at_rate(made, 5.0, RATE), expected, atol=1e-12)


def test_schroeder_phases_of_a_flat_comb_are_the_known_ones() -> None:
    k = np.arange(16)
    # φ_k − φ_0 = −2π Σ_{l<k} (k−l)/N = −π k(k+1)/N
    np.testing.assert_allclose(schroeder_phases([0.3] * 16), -pi * k * (k + 1) / 16, atol=1e-12)


def test_schroeder_phases_lower_the_crest_factor() -> None:
    comb = [0.1 * k for k in range(1, 17)]
    values = sample_at_rate(multisine(comb, 0.1), 10.0, RATE)
    aligned = sample_at_rate(multisine(comb, 0.1, phases=[pi / 2] * 16), 10.0, RATE)
    assert crest_factor(aligned) == pytest.approx(np.sqrt(2 * 16), rel=1e-6)
    assert crest_factor(values) < 2.0


def test_a_sines_crest_factor_is_the_root_of_two() -> None:
    assert crest_factor(sample_at_rate(multisine([1.0], 2.0), 10.0, 1000.0)) == pytest.approx(
        np.sqrt(2), rel=1e-5
    )
    assert crest_factor(np.zeros(3)) == np.inf


def test_a_chirp_passes_through_its_frequencies() -> None:
    made = chirp([0.5, 4.5], 1.0, duration=10.0)
    t = np.arange(10000) / 1000.0
    expected = np.sin(2 * pi * (0.5 * t + 0.2 * t**2))
    np.testing.assert_allclose(sample_at_rate(made, 10.0, 1000.0), expected, atol=1e-9)


def test_steps_dwell_and_begin_again() -> None:
    made = steps([0.0, 0.2, -0.1], dwell=0.5)
    assert [made(t) for t in (0.0, 0.49, 0.5, 1.2, 1.5)] == [0.0, 0.0, 0.2, -0.1, 0.0]


def test_hold_holds() -> None:
    assert set(sample_at_rate(hold(0.3), 1.0, RATE)) == {0.3}


def test_an_unknown_excitation_names_those_there_are() -> None:
    with pytest.raises(
        UnknownNameError, match=r"did you mean 'multisine'.*chirp, file, fourier, hold, .*two_sine"
    ):
        make_excitation("multisin", ExcitationKeys(), 1.0)


@pytest.mark.parametrize(
    ("name", "keys", "message"),
    [
        ("two_sine", ExcitationKeys(frequencies=(1.0, 2.0)), "needs the key `amplitude`"),
        ("two_sine", ExcitationKeys(frequencies=(1.0,), amplitude=1.0), "takes two"),
        (
            "two_sine",
            ExcitationKeys(frequencies=(1.0, -2.0), amplitude=1.0),
            "positive numbers of Hz, found -2",
        ),
        ("multisine", ExcitationKeys(frequencies=(), amplitude=1.0), "empty"),
        ("multisine", ExcitationKeys(frequencies=(1.0, 2.0), amplitude=(1.0,)), "1 values for 2 tones"),
        ("hold", ExcitationKeys(level=1.0, dwell=2.0), "has no key `dwell`; it takes: level"),
        ("steps", ExcitationKeys(levels=(), dwell=2.0), "`levels` is empty"),
        ("steps", ExcitationKeys(levels=(1.0,), dwell=0.0), "`dwell` must be positive"),
    ],
)
def test_wrong_settings_are_told(name: str, keys: ExcitationKeys, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_excitation(name, keys, 10.0)
