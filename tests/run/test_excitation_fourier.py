"""Fourier trajectories: limits hold at every time, and joints begin and end at rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labhil.experiment.excitation import (
    ExcitationKeys,
    Excitations,
    FourierSeries,
    evaluate_motion,
    fourier,
    hold,
    make_excitation,
    sample,
)

SIZES = st.floats(0.05, 20.0)


@st.composite
def joints(draw: st.DrawFn) -> dict[str, Any]:
    width = draw(st.integers(1, 6))
    rows = [
        (draw(st.floats(-3, 3)), draw(SIZES), draw(st.floats(0.1, 0.9)), draw(SIZES), draw(SIZES))
        for _ in range(width)
    ]
    base = draw(st.floats(0.02, 2.0))
    return {
        "low": [low for low, *_ in rows],
        "high": [low + span for low, span, *_ in rows],
        "centre": [low + span * share for low, span, share, *_ in rows],
        "speed": [row[3] for row in rows],
        "acceleration": [row[4] for row in rows],
        "base_frequency": base,
        "duration": draw(st.integers(1, 3)) / base,
        "harmonics": draw(st.integers(3, 12)),
        "seed": draw(st.integers(0, 2**32)),
    }


@given(keys=joints())
@settings(max_examples=60, deadline=None)
def test_limits_hold_and_ends_are_at_rest(keys: dict[str, Any]) -> None:
    made = fourier(**keys)
    duration = keys["duration"]
    t = np.linspace(0.0, duration, 4001)  # no multiple of the grid that was searched
    q, qd, qdd = evaluate_motion(made, t)
    low, high, speed, hardest = (np.array(keys[k]) for k in ("low", "high", "speed", "acceleration"))
    assert np.all(q >= low)
    assert np.all(q <= high)
    assert np.all(np.abs(qd) <= speed)
    assert np.all(np.abs(qdd) <= hardest)
    for end in (0, -1):
        np.testing.assert_allclose(q[end], keys["centre"], atol=1e-9 * np.max(high - low))
        assert np.all(np.abs(qd[end]) <= 1e-9 * speed)
        assert np.all(np.abs(qdd[end]) <= 1e-7 * hardest)
    # one limit of each joint is reached, all but a thousandth or two
    shares = np.max(
        [
            (q - keys["centre"]).max(0) / (high - keys["centre"]),
            (q - keys["centre"]).min(0) / (low - keys["centre"]),
            np.abs(qd).max(0) / speed,
            np.abs(qdd).max(0) / hardest,
        ],
        axis=0,
    )
    assert np.all(shares > 0.98)


def six(**changes: Any) -> Excitations | FourierSeries:
    keys = {"low": [-1.0] * 6, "high": 1.0, "speed": 2.0, "acceleration": 5.0, "base_frequency": 0.1}
    return fourier(**{**keys, "duration": 10.0, **changes})


def test_positions_velocities_and_accelerations_belong_together() -> None:
    made = six(seed=4)
    t = np.linspace(0.0, 10.0, 20001)
    q, qd, qdd = evaluate_motion(made, t)
    assert q.shape == (20001, 6)
    np.testing.assert_allclose(sample(made, t[::500]), q[::500], atol=1e-12)
    np.testing.assert_allclose(np.gradient(q, t, axis=0)[1:-1], qd[1:-1], atol=1e-5)
    np.testing.assert_allclose(np.gradient(qd, t, axis=0)[1:-1], qdd[1:-1], atol=1e-4)


def test_joints_differ_and_a_seed_makes_the_same_again() -> None:
    assert six(seed=1) == six(seed=1)
    assert six(seed=1) != six(seed=2)
    first = six(seed=1)
    assert isinstance(first, Excitations)
    assert len(set(first.columns)) == 6


def test_coefficients_may_be_given() -> None:
    made = six(low=-1.0, sine=[[0.1, -0.1]], cosine=[[0.02, -0.01]])
    assert isinstance(made, FourierSeries)
    w = 2 * np.pi * 0.1
    t = np.linspace(0.0, 10.0, 50)
    expected = (0.1 * np.sin(w * t) - 0.02 * np.cos(w * t)) / w
    expected += (-0.1 * np.sin(2 * w * t) + 0.01 * np.cos(2 * w * t)) / (2 * w)
    np.testing.assert_allclose(sample(made, t), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"duration": 12.0}, "`duration` must be whole periods of 10 s"),
        ({"base_frequency": 0.0}, "`base_frequency` must be a positive number"),
        ({"harmonics": 2}, "`harmonics` must be 3 at least, found 2"),
        ({"high": [1.0, 1.0]}, "`high` has 2 values for 6 joints"),
        ({"centre": 1.5}, "`centre` must lie between"),
        ({"speed": 0.0}, "`speed` must be positive"),
        ({"sine": [[0.0]]}, "give both `sine` and `cosine`"),
        ({"sine": [[0.0]], "cosine": [[0.0]]}, "a list for each of 6 joints, found 1 and 1"),
        ({"low": -1.0, "sine": [[9.0, -9.0]], "cosine": [[0.0, 0.0]]}, "joint 0: position reaches"),
        ({"low": -1.0, "sine": [[0.1, 0.1]], "cosine": [[0.0, 0.0]]}, "velocity is not zero"),
        ({"low": -1.0, "sine": [[0.1, -0.1]], "cosine": [[0.1, 0.1]]}, "acceleration is not zero"),
        ({"low": -1.0, "sine": [[0.1]], "cosine": [[]]}, "found 1 and 0"),
    ],
)
def test_wrong_settings_are_told(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        six(**changes)


def test_only_fourier_series_have_known_derivatives() -> None:
    with pytest.raises(TypeError, match="expected Fourier series, found Hold"):
        evaluate_motion(Excitations((hold(1.0),)), [0.0])


def test_six_joints_from_an_experiments_keys() -> None:
    keys = ExcitationKeys(low=(-1.0,) * 6, high=1.0, speed=2.0, acceleration=5.0, base_frequency=0.1)
    made = make_excitation("fourier", keys, 20.0, seed=(1, 0))
    assert isinstance(made, Excitations)
    assert sample(made, [0.0, 1.0]).shape == (2, 6)
