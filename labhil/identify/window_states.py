"""The states that windows begin with, found for each window by itself while the parameters are held.

Each window has a damping of its own, so that one at a stop or a reversal does not hold back all the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.identify.problem import Point, Problem
from labhil.physics.model import Model, Record, Windows
from labhil.signals import FloatArray, IntArray

POLISH = 1
"""Steps that each window takes by itself after a step of the parameters."""

OUTLYING = 2.0
"""Windows that cost this many times the median are looked at again."""

MORE_THAN_NOISE = 1.44
"""Squared residuals, in those of noise, from which a window of a few hundred samples leaves more."""

OTHER_VELOCITIES = (-0.8, -0.4, -0.2, 0.2, 0.4, 0.8)
"""Where they begin anew, in scales of the state beside the measured velocity."""

ANGLE, ANGLES = "_angle", 16
"""How the name of a state ends that repeats after a turn, and where it begins anew, evenly over that."""

TRIALS = 12
"""States that are tried anew in every window when a fit settles."""

FIRST_GROWN = 0.375
"""Scored horizons of a long window on which its initial state is found first."""

NEAR, FAR = 0.05, 0.5
"""How far from the best so far they begin, in scales of the state: two thirds near, one third far."""


@dataclass(frozen=True, slots=True)
class States:
    """A state of every window, (W, S), with the residuals (N·c,) that it leaves; parameters held."""

    states: FloatArray
    residuals: FloatArray

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.residuals @ self.residuals)

    def costs(self, problem: Problem) -> FloatArray:
        """Sums of squares, (W,)."""
        return problem.per_window(self.residuals**2)

    def or_better(self, problem: Problem, other: States) -> States:
        """The other where it costs less, window by window."""
        return self.choose(problem, other.costs(problem) < self.costs(problem), other)

    def choose(self, problem: Problem, which: np.ndarray, other: States) -> States:
        """The other in the windows ``which`` (W,)."""
        return States(
            np.where(which[:, None], other.states, self.states),
            np.where(which[problem.owner], other.residuals, self.residuals),
        )


def evaluate(problem: Problem, z: FloatArray, states: FloatArray) -> States:
    """These states with what they leave."""
    return States(states, problem.residuals(Point(z, states)))


def refine(problem: Problem, z: FloatArray, first: States, second: States) -> States:
    """Begin each window at the better of both states, and improve it by itself."""
    if not problem.model.state_names:
        return first
    return _improve_states(problem, z, first.or_better(problem, second), POLISH)


def search_states(
    problem: Problem, z: FloatArray, states: FloatArray, random: np.random.Generator, trials: int = TRIALS
) -> FloatArray:
    """Every window's best initial state among many local minima near it, (W, S); parameters held."""
    best = evaluate(problem, z, states)
    for k in range(trials if states.shape[1] else 0):
        centre = problem.guess if k % 2 else best.states
        reach = (FAR if k % 3 == 0 else NEAR) * problem.model.state_scale
        begin = centre + random.standard_normal(states.shape) * reach
        best = best.or_better(problem, _improve_states(problem, z, evaluate(problem, z, begin), 4))
    return best.states


def fit_states(problem: Problem, z: FloatArray, states: FloatArray, *, iterations: int = 8) -> FloatArray:
    """Find each window's initial state by itself with the parameters held at ``z``, (W, S).

    Rest is one hypothesis: where a window is explained about as well by a body that is not moving,
    its velocity is zero.
    """
    if not states.shape[1]:
        return states
    free = _improve_states(problem, z, evaluate(problem, z, states), iterations)
    moving = _velocities(problem)
    resting = evaluate(problem, z, np.where(moving, 0.0, states))
    at_rest = _improve_states(problem, z, resting, iterations, ~moving)
    allowance = np.sum(moving) * np.log(_rows_of_windows(problem))
    rest = at_rest.costs(problem) <= free.costs(problem) + allowance
    return free.choose(problem, rest, at_rest).states


def grow_states(problem: Problem, z: FloatArray, shortest: float) -> FloatArray:
    """Find each window's initial state on its begin, then on more and more of it, (W, S).

    A state that is guessed from a few samples leads a long simulation far from the data, into one of many
    local minima; one that fits the first ``shortest`` seconds is near enough for four times as many.
    """
    windows, record = problem.windows, problem.record
    rows = _rows_of_windows(problem) // record.outputs.shape[1]
    states, length = problem.guess, max(int(shortest / record.period), 1)
    while length < rows.max():
        ends = np.minimum(windows.first + length, windows.last)
        spans = list(zip(windows.first.tolist(), ends.tolist(), strict=True))
        begins = problem.with_windows(Windows.of(spans))
        states = fit_states(begins, z, states)
        length *= 4
    return fit_states(problem, z, states)


def _velocities(problem: Problem) -> np.ndarray:
    return np.array([name.endswith("_velocity") for name in problem.model.state_names], dtype=bool)


def _rows_of_windows(problem: Problem) -> IntArray:
    return np.diff(np.r_[problem.edges, len(problem.owner)])


def rescue_states(problem: Problem, z: FloatArray, estimate: States) -> States:
    """Give windows that fit far worse than most a fresh start from other velocities.

    Near a stop the state has several local minima, and one window in a wrong one can bend all
    parameters.
    """
    costs = estimate.costs(problem) / _rows_of_windows(problem)
    return _from_other_velocities(problem, z, estimate, np.flatnonzero(costs > OUTLYING * np.median(costs)))


def _from_other_velocities(problem: Problem, z: FloatArray, estimate: States, which: IntArray) -> States:
    """The better, in some windows, of the estimate and what other velocities lead to."""
    moving = _velocities(problem)
    if not len(which) or not moving.any():
        return estimate
    part = problem.select_windows(which)
    best = _of_windows(problem, estimate, which)
    for offset in OTHER_VELOCITIES:
        begin = part.guess + offset * problem.model.state_scale * moving
        best = best.or_better(part, _improve_states(part, z, evaluate(part, z, begin), 6))
    return _with_windows(problem, estimate, which, best)


def _of_windows(problem: Problem, estimate: States, which: IntArray) -> States:
    """The estimate of some windows alone."""
    return States(estimate.states[which], estimate.residuals[np.isin(problem.owner, which)])


def _with_windows(problem: Problem, estimate: States, which: IntArray, replacement: States) -> States:
    """The estimate with that of some windows replaced."""
    states, residuals = estimate.states.copy(), estimate.residuals.copy()
    states[which], residuals[np.isin(problem.owner, which)] = replacement.states, replacement.residuals
    return States(states, residuals)


def estimate_states_at(
    model: Model,
    theta: FloatArray,
    record: Record,
    windows: Windows,
    sigma: FloatArray,
    *,
    thorough: bool = False,
) -> States:
    """A model held at ``theta`` on windows of a record, each beginning in the state that fits it best.

    A ``thorough`` search looks again at windows that leave more than noise, all of them if need be.
    """
    problem = Problem(model, record, windows, np.empty(0, dtype=np.int64), theta, sigma)
    return estimate_states(problem, np.empty(0), thorough=thorough)


def estimate_states(problem: Problem, z: FloatArray, *, thorough: bool = True) -> States:
    """Every window's best initial state from its guess on, with the parameters held.

    ``thorough`` as in :func:`estimate_states_at`.
    """
    estimate = _align_angles(problem, z, evaluate(problem, z, fit_states(problem, z, problem.guess)))
    estimate = rescue_states(problem, z, estimate)
    return _search_noisy(problem, z, estimate) if thorough and problem.model.state_names else estimate


def _align_angles(problem: Problem, z: FloatArray, estimate: States) -> States:
    """The estimate from the angle at which each recording as a whole is explained best.

    Where a shaft stood when a recording began may be unknown; from there on its angle is guessed well, so a
    window has one of its own only where that explains clearly more.
    """
    angles = np.array([name.endswith(ANGLE) for name in problem.model.state_names])
    if not angles.any():
        return estimate
    held = replace(estimate, states=np.where(angles, problem.guess, estimate.states))
    for turn in (np.arange(ANGLES) / ANGLES, np.linspace(-1.0, 1.0, ANGLES + 1) / ANGLES):
        begin = _shift_by_recording(problem, z, held.states, 2.0 * np.pi * turn, angles)
        held = _improve_states(problem, z, begin, 8, ~angles)
    free = estimate.or_better(problem, _improve_states(problem, z, held, 8))
    common = held.costs(problem) <= free.costs(problem) + np.log(_rows_of_windows(problem))
    return free.choose(problem, common, held)


def _shift_by_recording(
    problem: Problem, z: FloatArray, states: FloatArray, shifts: FloatArray, which: np.ndarray
) -> States:
    """States (W, S) with ``which`` (S,) of them further by the shift that is best for its recording."""
    costs = [evaluate(problem, z, states + shift * which).costs(problem) for shift in shifts]
    rows = [begin.row for begin in problem.record.begins]
    recording = np.searchsorted(rows, problem.windows.first, side="right") - 1
    of_recordings = np.array([np.bincount(recording, cost, len(rows)) for cost in costs])
    best = shifts[np.argmin(of_recordings, axis=0)][recording]
    return evaluate(problem, z, states + best[:, None] * which)


def _search_noisy(problem: Problem, z: FloatArray, estimate: States) -> States:
    """Other states of the windows that leave more than noise: grown, from other velocities, from anywhere."""
    estimate = _grow_windows(problem, z, estimate, _noisy_windows(problem, estimate))
    estimate = _from_other_velocities(problem, z, estimate, _noisy_windows(problem, estimate))
    bad = _noisy_windows(problem, estimate)
    if not len(bad):
        return estimate
    part = problem.select_windows(bad)
    states = search_states(part, z, estimate.states[bad], np.random.default_rng(0))
    return _with_windows(problem, estimate, bad, evaluate(part, z, states))


def _grow_windows(problem: Problem, z: FloatArray, estimate: States, which: IntArray) -> States:
    """The better, in some windows, of the estimate and one on more and more of each window."""
    if not len(which):
        return estimate
    part = problem.select_windows(which)
    grown = evaluate(part, z, grow_states(part, z, FIRST_GROWN * problem.model.horizon))
    best = _of_windows(problem, estimate, which).or_better(part, grown)
    return _with_windows(problem, estimate, which, best)


def reestimate(problem: Problem, z: FloatArray, estimate: States) -> States:
    """The better of the estimate and a new one from the windows' guess, the parameters held.

    Steps of the parameters may have led windows into wrong valleys, even most of them. The few that still
    leave more than noise begin from anywhere.
    """
    if not problem.model.state_names:
        return estimate
    estimate = estimate.or_better(problem, estimate_states(problem, z, thorough=False))
    few = 2 * len(_noisy_windows(problem, estimate)) < len(estimate.states)
    return _search_noisy(problem, z, estimate) if few else estimate


def _noisy_windows(problem: Problem, estimate: States) -> IntArray:
    """Windows that leave more than noise."""
    return np.flatnonzero(estimate.costs(problem) > MORE_THAN_NOISE * _rows_of_windows(problem))


def _improve_states(
    problem: Problem, z: FloatArray, begin: States, iterations: int, which: np.ndarray | bool = True
) -> States:
    """Levenberg-Marquardt of all windows at once, each with its own damping; ``which`` (S,) states move."""
    estimate = begin
    damping = np.full(len(begin.states), 1e-3)
    cost = begin.costs(problem)
    for _ in range(iterations):
        slopes = problem.state_slopes(Point(z, estimate.states), estimate.residuals) * which
        gram = problem.state_gram(slopes, damping)
        pull = problem.products(slopes, estimate.residuals[:, None])
        step = np.linalg.solve(gram, pull)[:, :, 0] * which
        trial = evaluate(problem, z, estimate.states - step * problem.model.state_scale)
        trial_cost = trial.costs(problem)
        better = trial_cost < cost
        estimate = estimate.choose(problem, better, trial)
        damping = np.where(better, np.maximum(0.1 * damping, 1e-8), 10.0 * damping)
        gained = np.where(better, cost - trial_cost, 0.0)
        cost = np.where(better, trial_cost, cost)
        if np.all(gained <= 1e-6 * cost + 1e-12) and np.all(better | (damping > 1.0)):
            break
    return estimate
