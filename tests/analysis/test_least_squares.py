"""Estimator, errors and metric on a model that is linear in its parameters: the answers are known."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

from labhil.identify import statistics
from labhil.identify.identifiability import invariants
from labhil.identify.least_squares import least_squares
from labhil.identify.problem import Problem
from labhil.identify.score import score
from labhil.identify.window_states import estimate_states, evaluate, refine
from labhil.identify.windows import split
from labhil.physics.model import Metric
from labhil.physics.record import Record, Windows
from labhil.physics.terms import Parameter

COUNT, LENGTH = 6, 50
SIGMA = np.array([0.1])


class Straight:
    """y = level + slope·t within its window + a·sin t + b·cos 3t; level and slope are the window's state."""

    kind = "straight"
    state_names = ("level", "slope")
    state_scale = np.array([1.0, 1.0])
    terms = MappingProxyType({})
    horizon = 1.0
    metric = Metric.WINDOWED_SIMULATION
    fading_memory = False

    def horizon_at(self, theta) -> float:
        return self.horizon

    def __init__(self, lower: float = -np.inf, upper: float = np.inf) -> None:
        self.parameters = (
            Parameter("a", "m", 1.0, lower, upper, starts=(0.5,)),
            Parameter("b", "m", 2.0, lower, upper, starts=(0.5,)),
        )

    def initial_states(self, record: Record, windows: Windows) -> np.ndarray:
        return np.zeros((len(windows), 2))

    def simulate(self, theta, record: Record, windows: Windows, states: np.ndarray) -> np.ndarray:
        t, own = record.t[windows.rows], states[windows.owner]
        along = t - record.t[windows.first][windows.owner]
        shapes = theta[0] * np.sin(t) + theta[1] * np.cos(3.0 * t)
        return (own[:, 0] + own[:, 1] * along + shapes)[:, None]


def measured(a: float, b: float, seed: int, noise: np.ndarray | None = None) -> tuple[Record, Windows]:
    random = np.random.default_rng(seed)
    t = 0.05 * np.arange(COUNT * LENGTH)
    windows = Windows.of([(LENGTH * w, LENGTH * (w + 1)) for w in range(COUNT)])
    blank = Record(t, np.sin(t)[:, None], np.zeros((len(t), 1)), ("u",), ("y",), ("m",))
    states = random.standard_normal((COUNT, 2))
    y = Straight().simulate(np.array([a, b]), blank, windows, states)
    noise = random.standard_normal(len(t)) if noise is None else noise
    return Record(t, blank.inputs, y + SIGMA * noise[:, None], ("u",), ("y",), ("m",)), windows


def solved(record: Record, windows: Windows, lower: float = -np.inf, upper: float = np.inf):
    problem = Problem(Straight(lower, upper), record, windows, np.array([0, 1]), np.array([0.5, 0.5]), SIGMA)
    return problem, least_squares(problem, problem.start())


def design(record: Record, windows: Windows) -> np.ndarray:
    """The whole linear problem: both parameters, then level and slope of each window."""
    columns = [np.sin(record.t), np.cos(3.0 * record.t)]
    for first, last in zip(windows.first, windows.last, strict=True):
        inside = (record.t >= record.t[first]) & (np.arange(len(record.t)) < last)
        columns += [inside * 1.0, inside * (record.t - record.t[first])]
    return np.column_stack(columns)


@settings(max_examples=25, deadline=None)
@given(a=st.floats(-2.0, 2.0), b=st.floats(-2.0, 2.0), lower=st.floats(-1.5, 0.0), upper=st.floats(0.6, 1.5))
def test_the_bounded_minimum_is_that_of_the_whole_linear_problem(a, b, lower, upper):
    record, windows = measured(a, b, 1)
    problem, _ = solved(record, windows, lower, upper)
    # near a bound the usual tolerance of the cost, 1e-6, leaves a parameter a fiftieth of its error away
    solution = least_squares(problem, problem.start(), tolerance=1e-9)
    matrix, limits = design(record, windows), np.full(2 * COUNT, np.inf)
    bounds = (np.r_[lower, lower, -limits], np.r_[upper, upper, limits])
    exact = lsq_linear(matrix / SIGMA, record.outputs[:, 0] / SIGMA, bounds, tol=1e-14)
    theta = problem.theta(solution.point.z)
    assert np.all((theta >= lower - 1e-12) & (theta <= upper + 1e-12))
    assert solution.converged
    assert solution.cost == pytest.approx(2.0 * exact.cost, rel=1e-5)
    assert np.allclose(theta, exact.x[:2], atol=2e-4)


def test_every_step_that_is_taken_lowers_the_cost():
    record, windows = measured(1.5, -0.7, 2)
    problem = Problem(Straight(), record, windows, np.array([0, 1]), np.array([0.5, 0.5]), SIGMA)
    costs: list[float] = []
    solution = least_squares(problem, problem.start(), on_step=costs.append)
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == solution.cost


def test_projected_jacobian_gives_the_covariance_of_the_whole_problem():
    record, windows = measured(1.0, 1.0, 3)
    problem, solution = solved(record, windows)
    lin = problem.linearise(solution.point, solution.residuals)
    own = problem.project(lin, lin.by_parameters) / problem.scale
    matrix = design(record, windows) / SIGMA
    whole = np.linalg.inv(matrix.T @ matrix)[:2, :2]
    assert np.allclose(np.linalg.inv(own.T @ own), whole, rtol=1e-4)


def autoregressive(random: np.random.Generator, n: int, rho: float) -> np.ndarray:
    return np.asarray(lfilter([1.0], [1.0, -rho], random.standard_normal(n + 100))[100:])


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_the_error_of_a_mean_of_correlated_noise_is_the_long_run_one(rho):
    random, n = np.random.default_rng(7), 4000
    ones = np.ones((n, 1))
    found = [
        statistics.robust_covariance(ones, noise - noise.mean(), n - 1)[0, 0]
        for noise in (autoregressive(random, n, rho) for _ in range(30))
    ]
    # Bartlett's kernel falls a little short; a factor of two would be a mistake
    assert np.mean(found) == pytest.approx(1.0 / (1.0 - rho) ** 2 / n, rel=0.15)


@pytest.mark.extended
def test_intervals_of_correlated_noise_cover_the_truth():
    random, hits = np.random.default_rng(8), 0
    for seed in range(150):
        record, windows = measured(1.0, -1.0, seed, autoregressive(random, COUNT * LENGTH, 0.3))
        problem, solution = solved(record, windows)
        lin = problem.linearise(solution.point, solution.residuals)
        own = problem.project(lin, lin.by_parameters) / problem.scale
        covariance = statistics.robust_covariance(own, solution.residuals, COUNT * LENGTH - 2 - 2 * COUNT)
        error = problem.theta(solution.point.z) - [1.0, -1.0]
        hits += int(np.sum(np.abs(error) < 2.576 * np.sqrt(np.diag(covariance))))
    # of 300; with 99 % fewer than 285 would be a rarity, 95 % is what a small sample of windows may cost
    assert hits >= 285


def test_p_values_of_a_null_are_uniform_also_under_correlated_noise():
    random = np.random.default_rng(9)
    inputs = np.sin(np.arange(700) / 11.0) + 0.3 * np.sin(np.arange(700) / 3.7)
    found = [
        statistics.input_crosscorrelation(autoregressive(random, 700, 0.6), inputs, 6) for _ in range(100)
    ]
    assert stats.kstest(found, "uniform").pvalue > 1e-3


@settings(max_examples=60, deadline=None)
@given(powers=st.lists(st.integers(-3, 3), min_size=2, max_size=4), names=st.just(list("abcd")))
def test_invariants_do_not_change_along_the_direction_that_the_data_do_not_know(powers, names):
    direction = np.array([float(p) for p in powers])
    if not np.any(direction):
        return
    names = names[: len(powers)]
    for moved in (0.0, 0.7):
        values = dict(zip(names, np.exp(moved * direction).tolist(), strict=True))
        for text in invariants(names, direction[None]):
            python = text.replace("·", "*").replace("^", "**")
            # exponents are written with two digits
            assert eval(python, {}, values) == pytest.approx(1.0, rel=0.05)


def test_the_noise_floor_is_noise_and_what_the_lead_in_leaves_of_the_state():
    random = np.random.default_rng(10)
    t = 0.05 * np.arange(4000)
    shapes = np.sin(t) - np.cos(3.0 * t)
    y = shapes + SIGMA * random.standard_normal(len(t))
    record = Record(t, t[:, None], y[:, None], ("u",), ("y",), ("m",))
    marks = score(Straight(), np.array([1.0, -1.0]), record, SIGMA, horizon=2.0)
    lead, after = 0.05 * np.arange(20), 0.05 * np.arange(20, 60)
    carried = [np.column_stack([np.ones_like(x), x]) for x in (lead, after)]
    spread = np.linalg.inv(carried[0].T @ carried[0])
    exact = SIGMA[0] * np.sqrt(1.0 + np.mean(np.einsum("ns,st,nt->n", carried[1], spread, carried[1])))
    assert marks.noise_floor == pytest.approx(exact, rel=0.01)
    assert marks.rmse == pytest.approx(exact, rel=0.15)


@settings(max_examples=50, deadline=None)
@given(n=st.integers(50, 3000), share=st.floats(0.05, 0.9), gap=st.floats(0.0, 5.0))
def test_what_is_held_out_is_the_end_after_a_gap(n, share, gap):
    t = 0.01 * np.arange(n)
    record = Record(t, t[:, None], t[:, None], ("u",), ("y",), ("m",))
    learn, judge = split(record, share, gap)
    assert judge.t[-1] == t[-1]
    assert judge.t[0] == pytest.approx((1.0 - share) * t[-1], abs=0.0101)
    assert not len(learn) or judge.t[0] - learn.t[-1] >= gap
    assert np.array_equal(record.part(n - len(judge), n).t, judge.t)


@settings(deadline=None, max_examples=30)
@given(st.sets(st.integers(0, COUNT - 1), min_size=1))
def test_a_problem_on_some_windows_is_that_part_of_the_whole(chosen: set[int]) -> None:
    record, windows = measured(1.0, -0.5, seed=4)
    whole = Problem(Straight(), record, windows, np.array([0, 1]), np.array([0.5, 0.5]), SIGMA)
    which = np.array(sorted(chosen))
    part = whole.select_windows(which)
    states = np.random.default_rng(1).standard_normal((COUNT, 2))
    z = np.array([0.7, 0.1])
    np.testing.assert_array_equal(
        evaluate(part, z, states[which]).residuals,
        evaluate(whole, z, states).residuals[np.isin(whole.owner, which)],
    )
    named = Windows.of([(LENGTH * w, LENGTH * (w + 1)) for w in sorted(chosen)])
    np.testing.assert_array_equal(part.windows.rows, named.rows)
    np.testing.assert_array_equal(part.windows.owner, named.owner)
    np.testing.assert_array_equal(part.effective_fraction, np.ones(len(named.rows)))


class Saturating(Straight):
    """y is the arctangent of the first state: an undamped step from afar overshoots."""

    state_scale = np.array([1.0, 1.0])

    def simulate(self, theta, record: Record, windows: Windows, states: np.ndarray) -> np.ndarray:
        return np.arctan(states[windows.owner, :1])


def test_a_window_that_only_a_short_step_improves_is_not_given_up() -> None:
    record, windows = measured(0.0, 0.0, seed=5)
    record = replace(record, outputs=np.full_like(record.outputs, np.arctan(0.5)))
    problem = Problem(Saturating(), record, windows, np.empty(0, dtype=np.int64), np.zeros(2), SIGMA)
    begin = np.full((COUNT, 2), 0.5)
    begin[1, 0] = 8.0
    z = np.empty(0)
    begun = evaluate(problem, z, begin)
    found = refine(problem, z, begun, begun, iterations=10)
    np.testing.assert_allclose(found.states[:, 0], 0.5, atol=0.01)


class Bouncing(Straight):
    """y moves at a constant rate up to a stop at 1, from where it returns at half that rate."""

    state_scale = np.array([0.02, 0.02])

    def initial_states(self, record: Record, windows: Windows) -> np.ndarray:
        """Where it is at first, taken to move as on the way back."""
        return np.column_stack([record.outputs[windows.first, 0], np.full(len(windows), -0.3)])

    def simulate(self, theta, record: Record, windows: Windows, states: np.ndarray) -> np.ndarray:
        along = record.t[windows.rows] - record.t[windows.first][windows.owner]
        begin, rate = states[windows.owner].T
        free = begin + rate * along
        return np.where(free > 1.0, 1.0 - 0.5 * (free - 1.0), free)[:, None]


def test_a_state_is_found_before_a_bounce_in_the_first_samples() -> None:
    t = 0.05 * np.arange(3 * LENGTH)
    windows = Windows.of([(LENGTH * w, LENGTH * (w + 1)) for w in range(3)])
    blank = Record(t, np.sin(t)[:, None], np.zeros((len(t), 1)), ("u",), ("y",), ("m",))
    states = np.array([[0.85, 1.7], [0.8, 1.9], [0.9, 1.5]])
    y = Bouncing().simulate(np.zeros(2), blank, windows, states)
    noise = 0.01 * np.random.default_rng(3).standard_normal(y.shape)
    record = Record(t, blank.inputs, y + noise, ("u",), ("y",), ("m",))
    problem = Problem(Bouncing(), record, windows, np.empty(0, dtype=np.int64), np.zeros(2), np.array([0.01]))
    found = estimate_states(problem, np.empty(0))
    np.testing.assert_allclose(found.states, states, atol=0.05)
