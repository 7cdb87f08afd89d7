"""The parts of a study, each computed by itself: limits, the three ways of estimating, linear models."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from labhil.identify.estimators import Budget, CostEvaluator
from labhil.identify.estimators.search import Box
from labhil.identify.estimators.swarm import reference_swarm
from labhil.identify.fit import Fit, Options, fit
from labhil.identify.identifiability import weak_parameters
from labhil.identify.intervals import Intervals
from labhil.identify.least_squares import least_squares
from labhil.identify.linear import Orders, linear_study
from labhil.identify.problem import Point, Problem
from labhil.identify.sensitivities import sensitivities
from labhil.identify.statistics import inverse_information
from labhil.identify.window_states import fit_states
from labhil.physics.model import index_of
from labhil.physics.terms import keyed
from labhil.signals import FloatArray
from labhil_benchmarks.reference.result import Belief, Estimated, Limits, LinearModels, Way
from labhil_benchmarks.reference.study import Bench, Study

Progress = Callable[[str], None]
Bounds = tuple[float | None, ...]

TEXT_REACH = 2.58
"""The text's quantile of its 99 % intervals, eq. 3.19."""

QUANTILE = float(stats.norm.ppf(0.995))

REACHED = 10.0
"""Squares of noise by which a cost may exceed the lowest that is known, and count as the same minimum."""

MOST_STEPS = 400
"""As MATLAB's optimisation toolbox allows, which the text uses."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is spent: ``share`` of the text's iterations of the swarm, so many rough ``starts``."""

    share: float
    starts: int

    def iterations(self, study: Study) -> int:
        """Iterations of the swarm."""
        return max(2, round(self.share * study.swarm.iterations))


FULL, QUICK = Effort(1.0, 20), Effort(0.05, 4)


def limits(bench: Bench, seed: int, effort: Effort, progress: Progress) -> Limits:
    """Cramér-Rao bounds at the truth, the truth's own errors, and those of the text's printed values."""
    study = bench.study
    problem = bench.whole_run(bench.record)
    bounds, combined = bounds_of(study, problem, problem.start())
    levels, rows = study.levels, study.parameters.rows
    truth, pso, nlse = (
        tuple(bench.judged(bench.theta(levels.to_ours(values))))
        for values in (study.truth, [row.pso for row in rows], [row.nlse for row in rows])
    )
    return Limits(bounds, combined, truth, pso, nlse, len(bench.record))


def swarm(bench: Bench, seed: int, effort: Effort, progress: Progress) -> Estimated:
    """The text's swarm on the text's cost (eq. 3.1 to 3.4): the mean square of a whole run's errors.

    Several outputs count in units of their noise. Joints, which share no parameter, are searched one by one.
    """
    study, began, evaluations = bench.study, time.perf_counter(), 0
    ours: dict[str, float] = {}
    joints = dict.fromkeys(row.joint for row in study.parameters.rows)
    for joint in joints:
        problem = bench.whole_run(bench.record, boxed=True, joint=joint)
        rows = slice(None) if joint is None else slice(joint, None, len(bench.sigma))
        box = Box(problem.lower, problem.upper)
        evaluator = CostEvaluator(_mean_square(problem, rows), box, Budget(10**9), _reporter(progress, joint))
        best = reference_swarm(evaluator, seed, None, effort.iterations(study))
        keys = [problem.model.parameters[i].key for i in problem.free]
        ours |= dict(zip(keys, (best.z * problem.scale).tolist(), strict=True))
        evaluations += best.evaluations
    return _estimate(bench, ours, evaluations, began)


def _reporter(progress: Progress, joint: int | None) -> Progress:
    if joint is None:
        return progress
    return lambda text: progress(f"joint {joint}: {text}")


def _mean_square(problem: Problem, rows: slice) -> Callable[[FloatArray], float]:
    nothing = problem.start().states

    def cost(z: FloatArray) -> float:
        return float(np.mean(problem.residuals(Point(z, nothing))[rows] ** 2))

    return cost


def rough(bench: Bench, seed: int, effort: Effort, progress: Progress) -> Estimated:
    """One Levenberg-Marquardt of a whole run from a rough start, and how many other such starts come home."""
    began, random = time.perf_counter(), np.random.default_rng([seed, 1])
    first: Estimated | None = None
    best = _descend(bench, bench.study.levels.to_ours(bench.study.truth))[1]
    costs = []
    for k in range(effort.starts):
        progress(f"rough start {k + 1} of {effort.starts}")
        ours, cost, evaluations = _descend(bench, bench.study.rough(random))
        costs.append(cost)
        if first is None:
            first = _estimate(bench, ours, evaluations, began)
    assert first is not None
    lowest = min(best, *costs)
    reached = sum(cost < lowest + REACHED for cost in costs)
    return replace(first, starts=effort.starts, reached=reached)


def _descend(bench: Bench, begin: Mapping[str, float]) -> tuple[dict[str, float], float, int]:
    """Where least squares end that begin at these values by key, at what cost, after how many evaluations."""
    problem = bench.whole_run(bench.record)
    z = bench.theta(begin)[problem.free] / problem.scale
    start = Point(z, problem.start().states)
    solution = least_squares(problem, start, iterations=MOST_STEPS, settled=True, thorough=False)
    keys = [problem.model.parameters[i].key for i in problem.free]
    ours = dict(zip(keys, (solution.point.z * problem.scale).tolist(), strict=True))
    return ours, solution.cost, problem.evaluations


def default(bench: Bench, seed: int, effort: Effort, progress: Progress) -> Estimated:
    """The project's own fit without truth, box or initial state, with the errors that it states."""
    began = time.perf_counter()
    # profiles along what the data do not know are long, and their ends would not be shown
    method = Intervals.WALD if bench.study.held else Intervals.AUTO
    options = Options(seed=seed, intervals=method, progress=progress)
    result = fit(bench.model, bench.record, bench.study.terms, options=options)
    keys = bench.study.levels.keys
    places = index_of(bench.model.parameters)
    ours = {key: float(result.theta[places[key]]) for key in keys}
    estimated = _estimate(bench, ours, result.evaluations, began)
    return replace(estimated, belief=_belief(bench, result, np.array(estimated.values)))


def _belief(bench: Bench, result: Fit, values: FloatArray) -> Belief:
    """Errors, intervals and bounds of the rows, the covariance of sums included."""
    levels, problem = bench.study.levels, result.fitted.problem
    keys = [bench.model.parameters[i].key for i in problem.free]
    robust, classical, _ = result.fitted.covariances
    errors, text = (
        np.sqrt(np.maximum(np.diag(levels.covariance(c, keys)), 0.0)) for c in (robust, classical)
    )
    truth = bench.theta(levels.to_ours(bench.study.truth))
    at_truth = Problem(bench.model, bench.record, problem.windows, problem.free, truth, bench.sigma)
    z = truth[problem.free] / problem.scale
    states = fit_states(at_truth, z, at_truth.guess) if at_truth.guess.shape[1] else at_truth.guess
    stated = {keyed(row.name, row.joint): row.ci99 for row in result.estimates}
    ends = [
        stated[row.keys[0]] if len(row.keys) == 1 else (v - QUANTILE * e, v + QUANTILE * e)
        for row, v, e in zip(bench.study.parameters.rows, values.tolist(), errors.tolist(), strict=True)
    ]
    return Belief(
        std_errors=tuple(errors.tolist()),
        low=tuple(low for low, _ in ends),
        high=tuple(high for _, high in ends),
        text_reach=tuple((TEXT_REACH * text / np.sqrt(len(bench.record))).tolist()),
        bounds=bounds_of(bench.study, at_truth, Point(z, states))[0],
        window=result.window,
    )


def linear(bench: Bench, seed: int, effort: Effort, progress: Progress) -> LinearModels:
    """Transfer function and state space of second order, as in the text's case one."""
    orders = Orders(poles=2, inputs=2)
    rows = linear_study(bench.record, bench.test, ("transfer_function", "state_space"), orders, progress)
    return LinearModels(
        tuple(row.model.name.replace("_", " ") for row in rows),
        tuple(row.model.describe() for row in rows),
        tuple(row.test for row in rows),
    )


def bounds_of(study: Study, problem: Problem, truth: Point) -> tuple[Bounds, Bounds]:
    """Cramér-Rao bounds of the rows and of the study's combinations of them; None where there is none.

    As ``identify.intervals.cramer_rao_bounds``, for sums of parameters. Where the data leave a scale open one
    row is held: what does not depend on that scale is then known as well as with it free.
    """
    keys = [problem.model.parameters[i].key for i in problem.free]
    slopes = sensitivities(problem, truth, problem.residuals(truth), 1.0) / problem.scale
    by_row = study.levels.jacobian(slopes, keys)
    if study.held:
        return _with_one_held(study, by_row)
    chosen = [problem.model.parameters[i] for i in problem.free]
    weak = weak_parameters(chosen, problem.base[problem.free], slopes, 1.0)
    unknown = {key for key, lost in zip(keys, weak, strict=True) if lost}
    pairs = zip(study.parameters.rows, np.sqrt(np.diag(_covariance(by_row))).tolist(), strict=True)
    return tuple(None if unknown & set(row.keys) else error for row, error in pairs), ()


def _with_one_held(study: Study, by_row: FloatArray) -> tuple[Bounds, Bounds]:
    free = [i for i, label in enumerate(study.labels) if label != study.held]
    covariance = np.zeros((len(study.labels), len(study.labels)))
    covariance[np.ix_(free, free)] = _covariance(by_row[:, free])
    rows = tuple(
        float(np.sqrt(covariance[i, i])) if label in study.invariant else None
        for i, label in enumerate(study.labels)
    )
    truth = np.array(study.truth)
    slopes = np.empty((len(study.combinations), len(truth)))
    for i, size in enumerate(study.typical):
        step = np.zeros(len(truth))
        step[i] = 1e-6 * abs(size)
        above, below = (np.array(study.combined((truth + side * step).tolist())) for side in (1.0, -1.0))
        slopes[:, i] = (above - below) / (2.0 * step[i])
    return rows, tuple(np.sqrt(np.diag(slopes @ covariance @ slopes.T)).tolist())


def _covariance(jacobian: FloatArray) -> FloatArray:
    unit = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    return np.asarray(inverse_information(jacobian / unit) / np.outer(unit, unit))


def _estimate(bench: Bench, ours: Mapping[str, float], evaluations: int, began: float) -> Estimated:
    """Values, residual of the training run and errors of the test run of these values by key."""
    theta = bench.theta(ours)
    problem = bench.whole_run(bench.record)
    residuals = problem.residuals(Point(theta[problem.free] / problem.scale, problem.start().states))
    return Estimated(
        values=tuple(bench.study.levels.to_text(ours).tolist()),
        residual=float(np.sqrt(np.mean(residuals**2))),
        scores=tuple(bench.judged(theta)),
        evaluations=evaluations,
        seconds=time.perf_counter() - began,
    )


Part = Limits | Estimated | LinearModels
Compute = Callable[[Bench, int, Effort, Progress], Part]

PARTS: Mapping[str, Compute] = {
    "limits": limits,
    Way.DEFAULT: default,
    Way.ROUGH: rough,
    Way.SWARM: swarm,
    "linear": linear,
}
"""By name, the short ones first."""


def parts_of(study: Study) -> tuple[str, ...]:
    """Names of the parts that a study has."""
    return tuple(str(name) for name in PARTS if name != "linear" or study.linear is not None)
