"""Pseudo-random sequences, staircases, sweeps, phases and tables."""

from __future__ import annotations

from math import log, pi
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import max_len_seq

from labhil.experiment.excitation import (
    EXCITATIONS,
    Chirp,
    ExcitationKeys,
    Excitations,
    chirp,
    columns_of,
    crest_factor,
    make_excitation,
    maximum_length_sequence,
    multisine,
    prbs,
    prms,
    read_table,
    sample,
    sample_at_rate,
    schroeder_phases,
    spectrum_of,
    staircase,
)
from labhil.experiment.excitation.shift_register import TAPS

few = settings(max_examples=40, deadline=None)
LEVELS = st.floats(-100, 100, allow_nan=False)


@pytest.mark.parametrize("stages", [n for n in TAPS if n <= 16])
def test_every_register_has_the_greatest_length(stages: int) -> None:
    bits = maximum_length_sequence(stages)
    length = 2**stages - 1
    assert bits.sum() == 2 ** (stages - 1)  # one more high than low
    # every window of that many bits is another state: none comes twice within the period
    ring = np.concatenate((bits, bits[: stages - 1])).astype(np.int64)
    states = sum(ring[i : i + length] << i for i in range(stages))
    assert len(np.unique(states)) == length


@given(stages=st.integers(3, 11), start=st.integers(1, 2**11 - 1))
@few
def test_the_autocorrelation_is_two_valued_and_starts_are_shifts(stages: int, start: int) -> None:
    length = 2**stages - 1
    first = np.where(maximum_length_sequence(stages), 1.0, -1.0)
    other = np.where(maximum_length_sequence(stages, 1 + start % length), 1.0, -1.0)
    spectrum = np.fft.fft(first)
    own = np.fft.ifft(spectrum * spectrum.conj()).real
    np.testing.assert_allclose(own, [length] + [-1.0] * (length - 1), atol=1e-8)
    crossed = np.fft.ifft(spectrum * np.fft.fft(other).conj()).real
    assert sorted(np.rint(crossed))[-1] == length


def test_the_sequence_is_as_long_as_scipys() -> None:
    theirs = max_len_seq(9)[0]
    ours = maximum_length_sequence(9)
    assert (len(ours), ours.sum()) == (len(theirs), theirs.sum())


@given(
    ends=st.tuples(LEVELS, LEVELS).filter(lambda pair: pair[0] < pair[1]),
    dwell=st.floats(0.01, 2.0),
    holds=st.integers(1, 300),
    count=st.integers(2, 30),
    seed=st.integers(0, 2**32),
)
@few
def test_levels_stay_within_their_ends(
    ends: tuple[float, float], dwell: float, holds: int, count: int, seed: int
) -> None:
    low, high = ends
    duration = holds * dwell
    binary = prbs(low, high, dwell, duration, seed=seed)
    assert set(binary.levels) == {low, high}
    assert len(binary.levels) * dwell >= duration * (1 - 1e-12)
    many = prms(low, high, count, dwell, duration, seed=seed)
    assert len(many.levels) >= holds
    assert min(many.levels) >= low
    assert max(many.levels) <= high
    rounds = len(many.levels) // count
    ladder = np.linspace(low, high, count)
    for i in range(rounds):
        np.testing.assert_allclose(sorted(many.levels[i * count : (i + 1) * count]), ladder)
    stairs = staircase(low, high, count, dwell)
    assert np.all(np.abs(np.diff((*stairs.levels, low))) <= (high - low) / (count - 1) * (1 + 1e-9))


@given(seed=st.integers(0, 2**32))
@few
def test_a_seed_makes_one_sequence_and_another_makes_another(seed: int) -> None:
    for make in (lambda s: prms(-5, 5, 11, 0.1, 10.0, seed=s), lambda s: prbs(-1, 1, 0.1, 100.0, seed=s)):
        assert make(seed) == make(seed)
        assert any(make(seed) != make((seed, i)) for i in range(3))


def test_a_prms_covers_its_range_evenly() -> None:
    values = sample_at_rate(prms(-5.0, 5.0, 11, 0.5, 55.0, seed=2), 55.0, 100.0)
    counts = np.unique(np.round(values, 9), return_counts=True)[1]
    assert set(counts) == {500}
    assert spectrum_of(values, 100.0).crest_factor == pytest.approx(5.0 / np.sqrt(10.0))


def test_a_staircase_goes_both_ways() -> None:
    assert staircase(-1.0, 1.0, 5, 0.2).levels == (-1.0, -0.5, 0.0, 0.5, 1.0, 0.5, 0.0, -0.5)


@given(count=st.integers(3, 24), base=st.sampled_from([0.1, 0.25, 1.0, 7.5]), seed=st.integers(0, 1000))
@settings(max_examples=5, deadline=None)
def test_phases_are_never_worse_than_schroeders(count: int, base: float, seed: int) -> None:
    comb = [base * k for k in range(1, count + 1)]
    rate = 40 * comb[-1]
    chosen = crest_factor(sample_at_rate(multisine(comb, 1.0, seed=seed), 1 / base, rate))
    schroeder = crest_factor(sample_at_rate(multisine(comb, 1.0, phases="schroeder"), 1 / base, rate))
    assert chosen <= schroeder * 1.035
    assert multisine(comb, 1.0, seed=seed) == multisine(comb, 1.0, seed=seed)


def test_a_comb_of_many_tones_has_a_low_crest_factor() -> None:
    comb = [0.1 * k for k in range(1, 17)]
    assert crest_factor(sample_at_rate(multisine(comb, 0.1), 10.0, 400.0)) < 1.5
    assert crest_factor(sample_at_rate(multisine(comb, 0.1, phases="schroeder"), 10.0, 400.0)) > 1.6
    drawn = multisine(comb, 0.1, phases="random", seed=3)
    assert drawn == multisine(comb, 0.1, phases="random", seed=3)
    assert drawn != multisine(comb, 0.1, phases="random", seed=4)
    assert schroeder_phases([0.0, 0.0]) == (0.0, 0.0)


def phase_rate(made: Chirp, t: float) -> float:
    """Frequency (Hz) at ``t``, from the phase's own differences."""
    turns = made._cycles
    return (turns(t + 1e-5) - turns(t - 1e-5)) / 2e-5


def test_a_logarithmic_sweep_passes_octaves_in_even_times() -> None:
    made = chirp([0.5, 8.0], 1.0, 10.0, sweep="logarithmic")
    for t, expected in ((0.0, 0.5), (2.5, 1.0), (5.0, 2.0), (10.0, 8.0)):
        assert phase_rate(made, t) == pytest.approx(expected, rel=1e-4)
    t = np.arange(1000) / 100.0
    turns = 0.5 * 10 / log(16) * (16 ** (t / 10) - 1)
    np.testing.assert_allclose(sample_at_rate(made, 10.0, 100.0), np.sin(2 * pi * turns), atol=1e-9)


@pytest.mark.parametrize("sweep", ["linear", "logarithmic"])
def test_a_sweep_there_and_back_mirrors_itself(sweep: str) -> None:
    made = chirp([0.5, 8.0], 1.0, 10.0, sweep=sweep, there_and_back=True)
    for t, expected in ((0.0, 0.5), (5.0, 8.0), (10.0, 0.5)):
        assert phase_rate(made, t) == pytest.approx(expected, rel=1e-3)
    assert phase_rate(made, 3.0) == pytest.approx(phase_rate(made, 7.0), rel=1e-4)


def test_a_table_is_followed(tmp_path: Path) -> None:
    (tmp_path / "u.csv").write_text("t,value\n0,1\n\n1.0,3\n2.0, -1\n")
    line = read_table("u.csv", directory=tmp_path)
    np.testing.assert_allclose(sample(line, [-1, 0, 0.5, 1, 1.5, 2, 9]), [1, 1, 2, 3, 1, -1, -1])
    held = read_table("u.csv", "hold", tmp_path)
    np.testing.assert_allclose(sample(held, [0, 0.99, 1, 1.99, 2]), [1, 1, 3, 3, -1])
    (tmp_path / "q.csv").write_text("0,1,2,3\n1,2,3,4\n")
    joints = read_table("q.csv", directory=tmp_path)
    assert isinstance(joints, Excitations)
    assert len(columns_of(joints)) == 3
    np.testing.assert_allclose(sample(joints, [0.5]), [[1.5, 2.5, 3.5]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,value\n", "expected rows of t,value, found none"),
        ("0,1\n1,x\n", "line 2: expected 2 finite numbers, found '1,x'"),
        ("0,1\n1,nan\n", "line 2: expected 2 finite numbers"),
        ("0,1\n1,2,3\n", "line 2: expected 2"),
        ("0\n1\n", "line 1: expected 2"),
        ("0,1\n0,2\n", "times must increase, found 0 s after 0 s"),
    ],
)
def test_a_table_that_is_none_says_where(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "u.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_table("u.csv", directory=tmp_path)
    with pytest.raises(ValueError, match=r"v\.csv cannot be read as a table"):
        read_table("v.csv", directory=tmp_path)


def test_bands_are_where_the_power_is() -> None:
    tone = spectrum_of(sample_at_rate(multisine([2.0], 1.0), 20.0, 100.0), 100.0)
    assert tone.rms == pytest.approx(np.sqrt(0.5))
    assert tone.occupied is not None
    assert tone.half_power is not None
    assert tone.occupied.low == pytest.approx(2.0)
    assert tone.occupied.high == pytest.approx(2.0)
    assert tone.half_power.low < 2.0 < tone.half_power.high
    assert tone.bars().strip() in ("█", "██")
    binary = spectrum_of(sample_at_rate(prbs(-1.0, 1.0, 0.1, 102.3, stages=10), 102.3, 1000.0), 1000.0)
    assert binary.half_power is not None
    assert (
        4.4 <= binary.half_power.high <= 5.6
    )  # half of the sinc² is at 0.44/dwell, half of its usual height at 0.53
    still = spectrum_of(np.full(100, 3.0), 10.0)
    assert (still.occupied, still.half_power, still.bars()) == (None, None, "")
    assert (still.rms, still.crest_factor) == (3.0, 1.0)


@pytest.mark.parametrize(
    ("name", "keys", "message"),
    [
        ("prbs", ExcitationKeys(low=1.0, high=1.0, dwell=0.1), "`low` must be smaller than `high`"),
        ("prbs", ExcitationKeys(low=0.0, high=1.0, dwell=0.1, stages=40), "`stages` must be 2 to 20"),
        ("prbs", ExcitationKeys(low=(0.0,), high=1.0, dwell=0.1), "`low` of prbs must be one number"),
        ("prbs", ExcitationKeys(low=0.0, high=1.0, dwell=1e-9), "at most"),
        ("prms", ExcitationKeys(low=0.0, high=1.0, dwell=0.1, count=1), "two levels at least, found 1"),
        ("prms", ExcitationKeys(low=0.0, high=1.0, dwell=0.1), "needs the key `count`"),
        ("steps", ExcitationKeys(dwell=0.1), "needs the key `levels`, or `low`, `high` and `count`"),
        ("steps", ExcitationKeys(dwell=0.1, levels=(1.0,), low=2.0), "needs the key `levels`, or"),
        ("two_sine", ExcitationKeys(frequencies=(1.0, 2.0), amplitude=1.0, seed=2), "has no key `seed`"),
        (
            "two_sine",
            ExcitationKeys(frequencies=(1.0, 2.0), amplitude=1.0, phases="random"),
            "`phases` of two_sine must be numbers",
        ),
        ("file", ExcitationKeys(), "needs the key `path`"),
    ],
)
def test_wrong_settings_are_told(name: str, keys: ExcitationKeys, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_excitation(name, keys, 10.0)


def test_the_contracts_names_are_all_there() -> None:
    expected = "two_sine multisine prbs prms chirp steps fourier hold file"
    assert list(EXCITATIONS) == expected.split()


def test_a_key_of_its_own_seeds_before_the_experiments() -> None:
    keys = ExcitationKeys(low=-1.0, high=1.0, count=5, dwell=0.1)
    own = ExcitationKeys(low=-1.0, high=1.0, count=5, dwell=0.1, seed=7)
    assert make_excitation("prms", keys, 9.0, 7) == make_excitation("prms", own, 9.0, 1)
    assert make_excitation("prms", keys, 9.0, 1) != make_excitation("prms", own, 9.0, 1)
