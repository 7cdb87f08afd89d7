"""Intervals against a linear problem, where the right answers are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from labhil.diagnose.statements import sum_or_difference
from labhil.errors import UnknownNameError
from labhil.identify.identifiability import (
    Identifiability,
    identifiability,
    weak_parameters,
    with_helpful_options,
)
from labhil.identify.intervals import (
    Intervals,
    bootstrap_intervals,
    interval_method,
    quantile,
    simultaneous_quantile,
)
from labhil.identify.statistics import differ_from_zero
from labhil.physics.terms import Parameter

N, P = 300, 3


def linear(seed: int, share: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Jacobian, residuals (noise AR(1) with this share) and estimates of a straight regression."""
    random = np.random.default_rng(seed)
    J = random.standard_normal((N, P)).cumsum(axis=0)
    white = random.standard_normal(N)
    noise = white.copy()
    for i in range(1, N):
        noise[i] = share * noise[i - 1] + np.sqrt(1 - share**2) * white[i]
    beta = np.linalg.lstsq(J, J @ np.ones(P) + noise, rcond=None)[0]
    return J, J @ (beta - 1.0) - noise, beta


@pytest.mark.extended
@pytest.mark.parametrize("share", [0.0, 0.6])
def test_bootstrap_intervals_cover_white_and_coloured_noise_alike(share):
    covered = []
    for seed in range(40):
        J, residuals, beta = linear(seed, share)
        intervals = bootstrap_intervals(J, residuals, beta, N - P, quantile(0.9), seed=seed)
        covered += [low <= 1.0 <= high for low, high in intervals]
    assert stats.binomtest(sum(covered), len(covered), 0.9).pvalue > 1e-4 or np.mean(covered) > 0.83
    assert np.mean(covered) < 0.97


def test_the_bootstrap_of_white_noise_agrees_with_the_classical_error():
    J, residuals, beta = linear(3)
    error = np.sqrt(np.diag(np.linalg.inv(J.T @ J)) * (residuals @ residuals) / (N - P))
    intervals = np.array(bootstrap_intervals(J, residuals, beta, N - P, quantile()))
    assert intervals[:, 1] - intervals[:, 0] == pytest.approx(2 * quantile() * error, rel=0.15)


INDEPENDENT = stats.norm.ppf(0.5 + 0.5 * 0.99**0.5)


@pytest.mark.parametrize(("correlation", "exact"), [(0.0, INDEPENDENT), (1.0, 2.5758)])
def test_simultaneous_quantiles_of_two_parameters(correlation, exact):
    covariance = np.array([[4.0, 2.0 * correlation], [2.0 * correlation, 1.0]])
    assert simultaneous_quantile(covariance) == pytest.approx(exact, abs=0.03)


def test_a_parameter_without_a_finite_error_does_not_widen_the_others():
    covariance = np.diag([1.0, np.inf])
    assert simultaneous_quantile(covariance) == pytest.approx(quantile(), abs=0.03)


def test_an_unknown_method_is_told_with_those_that_exist():
    assert interval_method("profile") is Intervals.PROFILE
    with pytest.raises(UnknownNameError, match="profile"):
        interval_method("profil")


def parameters(*names: str) -> list[Parameter]:
    return [Parameter(name, "1", 0.1) for name in names]


def test_products_that_are_known_are_named_where_single_values_are_not():
    # y depends on a·b and c/b only
    random = np.random.default_rng(1)
    first, second = random.standard_normal((2, 400, 1))
    values = np.array([2.0, 3.0, 0.5])
    by_log = np.hstack([first, first - second, second]) * 100.0
    found = identifiability(parameters("a", "b", "c"), values, by_log / values, 1.0)
    assert (found.rank, found.of) == (2, 3)
    assert len(found.combinations) == 2
    for text in found.combinations:
        moved = dict(zip("abc", np.exp(np.array([1.0, -1.0, -1.0])), strict=True))
        assert eval(text.replace("·", "*").replace("^", "**"), {}, moved) == pytest.approx(1.0)
    assert weak_parameters(parameters("a", "b", "c"), values, by_log / values, 1.0).all()


def test_what_the_noise_drowns_is_weak_and_what_it_does_not_is_known():
    jacobian = np.eye(2) * np.array([1e3, 1e-1])
    assert weak_parameters(parameters("a", "b"), np.ones(2), jacobian, 1.0).tolist() == [False, True]


def test_channels_that_free_a_direction_are_named():
    lacking = Identifiability(2, 3, ("a·b",), ())
    options = {"current": lambda: Identifiability(3, 3, (), ()), "angle": lambda: lacking}
    assert with_helpful_options(lacking, options).would_help == ("current",)
    whole = Identifiability(3, 3, (), ())
    assert with_helpful_options(whole, options) is whole


def test_two_sizes_are_told_from_zero_together_where_only_their_sum_is_known():
    """A dead zone's width, where its middle is tied to a constant force."""
    tied = np.array([[22.0, -21.9], [-21.9, 22.0]])
    assert differ_from_zero(np.array([6.0, 5.9]), tied)
    assert not any(differ_from_zero(np.array([size]), np.array([[22.0]])) for size in (6.0, 5.9))
    assert not differ_from_zero(np.array([6.0, -5.9]), tied)


def test_of_two_sizes_that_are_tied_what_is_known_better_is_said():
    tied = np.array([[22.0, -21.9], [-21.9, 22.0]])
    assert sum_or_difference(np.array([6.0, 5.9]), tied) == (
        "sum",
        pytest.approx(11.9),
        pytest.approx(0.2**0.5),
    )
    name, value, _ = sum_or_difference(np.array([6.0, 5.5]), np.abs(tied))
    assert (name, value) == ("difference", pytest.approx(0.5))


def test_the_best_of_many_looks_must_stand_out_further():
    values, covariance = np.array([3.0, 1.0]), np.eye(2)
    assert differ_from_zero(values, covariance)
    assert not differ_from_zero(values, covariance, n_candidates=150)


def test_what_nothing_is_known_of_says_nothing():
    assert not differ_from_zero(np.array([6.0]), np.array([[np.inf]]))
    assert differ_from_zero(np.array([6.0, 6.0]), np.diag([np.inf, 1.0]))


@pytest.mark.extended
def test_as_often_as_promised_nothing_is_told_from_zero():
    random = np.random.default_rng(3)
    covariance = np.array([[2.0, -1.0], [-1.0, 1.0]])
    draws = random.multivariate_normal(np.zeros(2), covariance, 4000)
    alarms = sum(differ_from_zero(each, covariance) for each in draws)
    assert stats.binomtest(alarms, len(draws), 0.01).pvalue > 1e-3
