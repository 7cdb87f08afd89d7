"""Fits from known slopes, steps within bounds and profiles, against problems with answers in closed form."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from labhil.identify.fitted import Fitted
from labhil.identify.intervals import profile_of, quantile
from labhil.identify.least_squares import _bounded_minimum, _worthwhile_step, least_squares
from labhil.identify.problem import Point, evenly_spread
from labhil.identify.shapes import _other_minima
from labhil.identify.table import table_of

sys.path.insert(0, str(Path(__file__).parent))

from test_least_squares import measured, solved


def test_a_fit_with_known_slopes_takes_fewer_simulations_to_the_same_place():
    problem, solution = solved(*measured(1.0, -2.0, 4))
    slopes = problem.linearise(solution.point, solution.residuals)
    start = problem.start()
    counts, ends = [], []
    for known in (None, slopes):
        before = problem.evaluations
        found = least_squares(problem, start, settled=True, thorough=False, slopes=known)
        counts.append(problem.evaluations - before)
        ends.append(found.point.z)
    assert ends[1] == pytest.approx(ends[0], abs=1e-4)
    assert counts[1] < counts[0]


@given(st.integers(0, 10_000), st.integers(1, 6))
def test_the_bounded_step_is_the_minimum_within_the_bounds(seed: int, n: int):
    random = np.random.default_rng(seed)
    root = random.standard_normal((n + 2, n)) * 10.0 ** random.uniform(-2, 2, n)
    normal, gradient = root.T @ root + 1e-9 * np.eye(n), random.standard_normal(n) * 10.0
    unit = np.sqrt(np.diag(normal))
    lower, upper = -random.uniform(0.0, 2.0, n) / unit, random.uniform(0.0, 2.0, n) / unit
    step = _bounded_minimum(normal, gradient, lower, upper)
    assert np.all(step >= lower - 1e-12) and np.all(step <= upper + 1e-12)

    def cost(d: np.ndarray) -> float:
        return float(0.5 * d @ normal @ d + gradient @ d)

    scaled = minimize(
        lambda d: cost(d / unit),
        np.zeros(n),
        jac=lambda d: (normal @ (d / unit) + gradient) / unit,
        bounds=list(zip(lower * unit, upper * unit, strict=True)),
        method="L-BFGS-B",
        options={"ftol": 1e-14, "gtol": 1e-10},
    )
    assert cost(step) <= scaled.fun + 1e-6 * (1.0 + abs(scaled.fun))


def test_a_direction_that_gains_nothing_is_not_stepped_along():
    normal, gradient = np.diag([1.0, 1e-8]), np.array([-1.0, -1e-6])
    step = _worthwhile_step(normal, gradient, least_gain=0.01)
    assert step == pytest.approx([1.0, 0.0])
    assert _worthwhile_step(normal, gradient, least_gain=0.0) == pytest.approx([1.0, 100.0])


@given(st.integers(1, 200), st.integers(1, 20))
def test_windows_are_spread_evenly(n: int, count: int):
    chosen = evenly_spread(n, count)
    assert len(chosen) == len(set(chosen.tolist())) <= min(n, count)
    assert chosen[0] == 0 and (count == 1 or chosen[-1] == n - 1)
    if len(chosen) > 2:
        assert np.ptp(np.diff(chosen)) <= 1


def test_the_profile_of_a_linear_problem_ends_where_walds_interval_does():
    problem, solution = solved(*measured(1.0, -2.0, 5))
    fitted = Fitted(("straight",), problem.theta(solution.point.z), problem, solution, 1.0)
    _, classical, _ = fitted.covariances
    slopes = problem.linearise(solution.point, solution.residuals)
    for j in range(2):
        scaled = classical / np.outer(problem.scale, problem.scale)
        profile = profile_of(problem, solution, slopes, j, scaled, 1.0, quantile())
        value = solution.point.z[j] * problem.scale[j]
        reach = quantile() * np.sqrt(classical[j, j])
        assert profile.lower is None
        assert (profile.low, profile.high) == pytest.approx((value - reach, value + reach), rel=0.07)


def test_a_profile_that_comes_upon_a_lower_minimum_hands_it_on():
    problem, solution = solved(*measured(1.0, -2.0, 6))
    off = Point(solution.point.z + np.array([0.4, 0.0]), solution.point.states)
    worse = least_squares(problem, off, iterations=0, settled=True, thorough=False)
    fitted = Fitted(("straight",), problem.theta(worse.point.z), problem, worse, 1.0)
    slopes = problem.linearise(worse.point, worse.residuals)
    _, classical, _ = fitted.covariances
    profile = profile_of(
        problem, worse, slopes, 1, classical / np.outer(problem.scale, problem.scale), 1.0, 2.6
    )
    assert profile.lower is not None
    assert profile.lower.cost < worse.cost
    assert table_of(fitted).lower is None  # Wald's intervals follow no profile


class Cost:
    """Stands for a solution in a profile."""

    def __init__(self, cost: float) -> None:
        self.cost = cost


@pytest.mark.parametrize(
    ("costs", "own", "found"),
    [
        ([9.0, 5.0, 1.0, 5.0, 9.0], 2, []),
        ([9.0, 5.0, 1.0, 5.0, 2.0], 2, [4]),
        ([1.9, 1.0, 1.2, 1.1, 1.3], 1, []),  # nothing between them
        ([0.5, 4.0, 1.0, 1.5, 7.0, 6.0], 2, [0, 5]),
        ([1.0, 2.0], 0, []),
    ],
)
def test_another_minimum_has_a_barrier_before_it(costs: list[float], own: int, found: list[int]):
    profile = [Cost(cost) for cost in costs]
    minima = _other_minima(profile, own, 1.0)  # type: ignore[arg-type]
    assert [profile.index(minimum) for minimum in minima] == found  # type: ignore[arg-type]
