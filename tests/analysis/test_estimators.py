"""Global searches on costs whose minimum is known, and what they make of a problem with linear parts."""

from __future__ import annotations

import sys
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from labhil.errors import MissingExtraError, UnknownNameError
from labhil.identify.estimators import ESTIMATORS, METHODS, Budget, CostEvaluator, check_estimator, search
from labhil.identify.estimators.coordinates import Coordinates
from labhil.identify.estimators.search import Box
from labhil.identify.estimators.swarm import reference_swarm
from labhil.identify.problem import Problem
from labhil.physics.model import Metric
from labhil.physics.record import Record, Windows
from labhil.physics.terms import Parameter

SIGMA = np.array([0.05])
SHIFT = np.array([0.7, -1.3, 0.2])


def quadratic(z: np.ndarray) -> float:
    return float(np.sum((z - SHIFT[: len(z)]) ** 2))


def rosenbrock(z: np.ndarray) -> float:
    return float(100.0 * (z[1] - z[0] ** 2) ** 2 + (1.0 - z[0]) ** 2)


def box(size: int, half: float = 2.0) -> Box:
    return Box(-half * np.ones(size), half * np.ones(size))


class Decay:
    """y = offset + gain·exp(−t/τ) + wave·cos(f·t): linear in three of its five; no state of a window."""

    kind = "decay"
    state_names = ()
    state_scale = np.array([])
    terms = MappingProxyType({})
    horizon = 1.0
    metric = Metric.WINDOWED_SIMULATION
    fading_memory = False

    def __init__(self, upper: float = np.inf) -> None:
        self.parameters = (
            Parameter("offset", "m", 1.0, linear=True),
            Parameter("gain", "m", 2.0, 0.0, upper, linear=True),
            Parameter("tau", "s", 0.5, 1e-3, 1e3),
            Parameter("wave", "m", 0.1, linear=True),
            Parameter("f", "rad/s", 2.0, 3.0, 8.0),
        )

    def horizon_at(self, theta) -> float:
        return self.horizon

    def prepare(self, record: Record) -> Record:
        return record

    def initial_states(self, record: Record, windows: Windows) -> np.ndarray:
        return np.zeros((len(windows), 0))

    def simulate(self, theta, record: Record, windows: Windows, states: np.ndarray) -> np.ndarray:
        offset, gain, tau, wave, f = theta
        t = record.t[windows.rows]
        y = offset + gain * np.exp(-t / tau) + wave * np.cos(f * t)
        return y[:, None]


TRUTH = np.array([0.4, 1.5, 0.8, 0.3, 5.0])
START = np.array([0.0, 1.0, 0.3, 0.1, 4.0])


def problem_of(model: Decay, free: tuple[int, ...] = (0, 1, 2, 3, 4), seed: int = 1) -> Problem:
    t = 0.02 * np.arange(200)
    windows = Windows.of([(0, 100), (100, 200)])
    blank = Record(t, t[:, None], np.zeros((len(t), 1)), ("u",), ("y",), ("m",))
    y = Decay().simulate(TRUTH, blank, windows, np.zeros((2, 0)))
    y += SIGMA * np.random.default_rng(seed).standard_normal((len(t), 1))
    record = Record(t, blank.inputs, y, ("u",), ("y",), ("m",))
    base = np.where(np.isin(np.arange(5), free), START, TRUTH)
    return Problem(model, record, windows, np.array(free), base, SIGMA)


@pytest.mark.parametrize("name", METHODS)
@settings(max_examples=12, deadline=None)
@given(
    middle=st.lists(st.floats(-50.0, 50.0), min_size=2, max_size=3),
    width=st.floats(1e-3, 100.0),
    seed=st.integers(0, 10**6),
    given_start=st.booleans(),
)
def test_no_point_outside_the_box_is_ever_tried(name, middle, width, seed, given_start):
    limits = Box(np.array(middle) - width, np.array(middle) + width)
    tried: list[np.ndarray] = []

    def cost(z: np.ndarray) -> float:
        tried.append(z.copy())
        # downhill through a corner, and no number in a part of the box
        return float(np.nan if z[0] > middle[0] + 0.8 * width else np.sum(z))

    evaluator = CostEvaluator(cost, limits, Budget(150))
    found = METHODS[name](evaluator, seed, limits.upper + 1.0 if given_start else None)
    points = np.array(tried)
    assert np.all((points >= limits.lower) & (points <= limits.upper))
    assert found.evaluations == len(tried)
    assert np.all((found.z >= limits.lower) & (found.z <= limits.upper))
    assert np.isfinite(found.cost)
    assert found.cost == np.nanmin([np.sum(z) if z[0] <= middle[0] + 0.8 * width else 1e100 for z in points])


@pytest.mark.parametrize("name", METHODS)
def test_a_seed_repeats_every_point_bit_for_bit_and_leaves_others_draws_alone(name):
    def points(seed: int) -> np.ndarray:
        tried: list[np.ndarray] = []

        def cost(z: np.ndarray) -> float:
            tried.append(z.copy())
            return rosenbrock(z)

        METHODS[name](CostEvaluator(cost, box(2), Budget(300)), seed)
        return np.array(tried)

    np.random.seed(5)
    before = np.random.get_state()[1].copy()
    first, again, other = points(7), points(7), points(8)
    assert np.array_equal(first, again)
    assert first.shape != other.shape or not np.array_equal(first, other)
    assert np.array_equal(before, np.random.get_state()[1])


@pytest.mark.parametrize("name", ["pso", "pso_adaptive", "pso_de"])
def test_threads_change_nothing(name):
    one, four = (METHODS[name](CostEvaluator(rosenbrock, box(2), Budget(600), threads=n), 3) for n in (1, 4))
    assert np.array_equal(one.z, four.z)
    assert one.history == four.history


LOOSE = {"simulated_annealing": 0.1, "mcmc": 0.3}
ROUNDS = {"pso": 100, "pso_adaptive": 100}
"""Iterations of the swarms: the text's inertia falls over all of them."""


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("size", [1, 3])
def test_every_method_finds_the_minimum_of_a_quadratic(name, size):
    found = METHODS[name](
        CostEvaluator(quadratic, box(size), Budget(4000)), 1, iterations=ROUNDS.get(name, 1000)
    )
    np.testing.assert_allclose(found.z, SHIFT[:size], atol=LOOSE.get(name, 0.02))
    assert found.cost == quadratic(found.z)
    assert found.evaluations <= 4000 + 2 * 10 * size


@pytest.mark.parametrize("name", METHODS)
def test_every_method_finds_the_end_of_rosenbrocks_valley(name):
    found = METHODS[name](
        CostEvaluator(rosenbrock, box(2), Budget(6000)), 2, iterations=ROUNDS.get(name, 1000) * 3
    )
    np.testing.assert_allclose(found.z, [1.0, 1.0], atol=2.0 * LOOSE.get(name, 0.02))


def test_the_texts_swarm_moves_by_equations_3_1_to_3_3():
    seed, size, rounds = 4, 2, 5
    tried: list[np.ndarray] = []

    def cost(z: np.ndarray) -> float:
        tried.append(z.copy())
        return rosenbrock(z)

    reference_swarm(CostEvaluator(cost, box(size), Budget(61)), seed, iterations=rounds)
    random, count = np.random.default_rng(seed), 20
    places = random.uniform(-2.0, 2.0, (count, size))
    speeds = np.zeros((count, size))
    own = places.copy()
    for number in range(3):
        shown = np.array(tried[count * number : count * (number + 1)])
        np.testing.assert_allclose(shown, places, rtol=1e-12)
        for i in range(count):
            if rosenbrock(places[i]) < rosenbrock(own[i]):
                own[i] = places[i]
        best = own[np.argmin([rosenbrock(z) for z in own])]
        r1, r2 = random.random((count, size)), random.random((count, size))
        chi = 0.9 - (0.9 - 0.4) / rounds * number
        for i in range(count):
            towards = 2.0 * (own[i] - places[i]) * r1[i] + 2.0 * (best - places[i]) * r2[i]
            speeds[i] = chi * (speeds[i] + towards)
            places[i] = np.clip(places[i] + speeds[i], -2.0, 2.0)


@pytest.mark.parametrize("name", [name for name in METHODS if name != "mcmc"])
def test_a_search_ends_for_the_reason_that_it_names(name):
    method = METHODS[name]
    near = method(CostEvaluator(quadratic, box(2), Budget(100_000, threshold=0.1)), 1)
    assert near.stopped_because == "below the threshold"
    assert near.cost <= 0.1
    short = method(CostEvaluator(quadratic, box(2), Budget(100)), 1)
    assert short.stopped_because == "evaluations are used up"
    assert 100 <= short.evaluations < 160
    if name != "simulated_annealing":
        flat = method(CostEvaluator(lambda z: 1.0 + 0.0 * z[0], box(2), Budget(100_000, patience=3)), 1)
        assert flat.stopped_because in ("no gain in 3 rounds", "finished")
        assert flat.evaluations < 500
        sinking = Budget(100_000, threshold=-np.inf, patience=3)
        below_zero = method(CostEvaluator(lambda z: -1.0 + 0.0 * z[0], box(2), sinking), 1)
        assert below_zero.evaluations == flat.evaluations


def test_the_history_is_the_best_cost_after_each_round_and_is_told():
    told: list[str] = []
    evaluator = CostEvaluator(rosenbrock, box(2), Budget(500), told.append)
    found = METHODS["pso_de"](evaluator, 1)
    assert list(found.history) == sorted(found.history, reverse=True)
    assert found.history[-1] == found.cost
    assert len(told) == len(found.history)
    assert told[-1] == f"best cost {found.cost:.6g} after {found.evaluations} evaluations"


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("after", [0, 1, 57])
def test_an_interrupted_search_hands_on_the_best_so_far(name, after):
    problem = problem_of(Decay(), (2, 4))
    costs: list[float] = []
    honest = problem.residuals

    def residuals(point):
        if len(costs) == after:
            raise KeyboardInterrupt
        costs.append(float(honest(point) @ honest(point)))
        return honest(point)

    problem.residuals = residuals
    begin = search(problem, name, seed=1)
    assert begin.search.stopped_because == "interrupted"
    # the first evaluation only tells what the initial states could explain
    if after > 1:
        assert begin.search.cost == min(costs)
        z = begin.theta[[2, 4]] / problem.scale
        difference = honest(type(problem.start())(z, problem.start().states))
        assert difference @ difference == pytest.approx(min(costs))
    else:
        np.testing.assert_allclose(begin.theta, problem.base)


@pytest.mark.parametrize("upper", [np.inf, 1.2])
def test_linear_parameters_are_those_of_the_full_least_squares(upper):
    model = Decay(upper)
    problem = problem_of(model)
    coordinates = Coordinates.of(problem)
    assert len(coordinates.box) == 2
    for tau, f in ((0.8, 5.0), (0.3, 3.5), (2.0, 7.0)):
        vector = np.array([np.log(tau / 0.5), np.log(f / 2.0)])
        t = problem.record.t
        columns = np.column_stack([np.ones_like(t), np.exp(-t / tau), np.cos(f * t)]) / SIGMA
        bounds = ([-np.inf, 0.0, -np.inf], [np.inf, upper, np.inf])
        exact = lsq_linear(columns, problem.record.outputs[:, 0] / SIGMA, bounds, tol=1e-14)
        theta = problem.theta(coordinates.z(vector))
        np.testing.assert_allclose(theta[[0, 1, 3]], exact.x, atol=1e-5)
        np.testing.assert_allclose(theta[[2, 4]], [tau, f])
        assert coordinates.cost(vector) == pytest.approx(2.0 * exact.cost, rel=1e-6)


def test_without_projection_everything_is_searched():
    assert len(Coordinates.of(problem_of(Decay()), project=False).box) == 5


@settings(max_examples=60, deadline=None)
@given(share=st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2))
def test_every_point_of_the_box_keeps_the_models_bounds(share):
    problem = problem_of(Decay(1.2))
    coordinates = Coordinates.of(problem)
    limits = coordinates.box
    z = coordinates.z(limits.lower + np.array(share) * (limits.upper - limits.lower))
    assert np.all((z >= problem.lower) & (z <= problem.upper))
    assert np.all((coordinates.start >= limits.lower) & (coordinates.start <= limits.upper))


@pytest.mark.extended
@pytest.mark.parametrize("name", [name for name in ESTIMATORS if name not in ("nlse", "mcmc")])
def test_a_search_of_the_nonlinear_parameters_ends_near_the_truth(name):
    problem = problem_of(Decay())
    begin = search(problem, name, seed=3)
    if name == "hybrid":
        # a brief search: good enough for least squares to begin with
        assert abs(begin.theta[4] - TRUTH[4]) < 0.4
        return
    np.testing.assert_allclose(begin.theta, TRUTH, atol=0.25)
    # 200 samples in units of their noise
    assert begin.search.cost < 320.0


def test_a_chain_that_begins_near_the_truth_stays_there_and_one_from_afar_gets_nearer():
    problem = problem_of(Decay())
    coordinates = Coordinates.of(problem)
    begin = search(problem, "mcmc", seed=3)
    assert begin.search.cost < coordinates.cost(coordinates.start)
    problem.base[:] = TRUTH
    near = search(problem, "mcmc", seed=3)
    np.testing.assert_allclose(near.theta, TRUTH, atol=0.1)


@pytest.mark.parametrize(("name", "package"), [("cma_es", "cma"), ("mcmc", "emcee")])
def test_a_missing_package_is_named_with_its_extra(name, package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=rf"{name} needs the package '{package}'.*labhil\[search\]"):
        search(problem_of(Decay()), name)


def test_names_are_checked():
    assert check_estimator("hybrid") == "hybrid"
    with pytest.raises(UnknownNameError, match="did you mean 'pso_de'"):
        check_estimator("pso_dee")


def test_draws_of_a_gaussian_have_its_mean_and_covariance():
    covariance = np.array([[0.04, 0.03], [0.03, 0.09]])
    precision = np.linalg.inv(covariance)
    evaluator = CostEvaluator(lambda z: float(z @ precision @ z), box(2, 5.0), Budget(40_000))
    found = METHODS["mcmc"](evaluator, 6, np.zeros(2), iterations=2000)
    assert found.draws is not None
    # 2000 steps of 8 walkers, halved, some 30 steps of autocorrelation: about 250 draws of their own
    assert np.all(np.abs(found.draws.mean(axis=0)) < 4.0 * np.sqrt(np.diag(covariance) / 250))
    spread = np.cov(found.draws.T)
    sizes = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.all(np.abs(spread - covariance) < 4.0 * np.sqrt(2.0 / 250) * sizes)
    assert "autocorrelation times long" in found.stopped_because


def test_a_simulation_that_runs_away_costs_much_and_breaks_nothing():
    model = Decay()
    honest = model.simulate
    model.simulate = lambda theta, *rest: honest(theta, *rest) * (np.nan if theta[2] > 1.0 else 1.0)
    problem = problem_of(model)
    begin = search(problem, "pso_de", seed=2, budget=Budget(400))
    assert np.isfinite(begin.search.cost)
    assert begin.theta[2] == pytest.approx(TRUTH[2], rel=0.2)


def test_nothing_to_search_is_solved_at_once():
    problem = problem_of(Decay(), (0, 1, 3))
    begin = search(problem, "pso")
    assert begin.search.stopped_because == "nothing to search"
    np.testing.assert_allclose(begin.theta, TRUTH, atol=0.05)
