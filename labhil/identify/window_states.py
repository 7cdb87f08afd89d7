"""Estimation of the initial state of every window, with the parameters held fixed.

All windows are solved at once by Levenberg and Marquardt's method, each with its own damping, so that a
window at an end stop or a reversal does not slow down the others. Parameters are estimated in
least_squares.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.identify.problem import Point, Problem
from labhil.physics.model import Model
from labhil.physics.record import Record, Windows
from labhil.signals import BoolArray, FloatArray, IntArray

ANGLE_SUFFIX = "_angle"
"""Suffix of the names of states that are periodic in one turn."""

FIRST_SECTION_IN_HORIZONS = 0.375
"""Length of the first section of a long window on which its initial state is estimated, in scored horizons;
a heuristic."""

MAX_DAMPING = 1e4
"""Damping, relative to the diagonal of the normal equations, beyond which a step is too short to gain."""


@dataclass(frozen=True, slots=True)
class States:
    """An initial state of every window (W, S), and the residuals (N·c,) of the simulation from there."""

    states: FloatArray
    residuals: FloatArray

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(self.residuals @ self.residuals)

    def costs(self, problem: Problem) -> FloatArray:
        """Sums of squared residuals of the windows, (W,)."""
        return problem.per_window(self.residuals**2)

    def or_better(self, problem: Problem, other: States) -> States:
        """Take the other estimate in the windows where its cost is lower."""
        return self.choose(problem, other.costs(problem) < self.costs(problem), other)

    def choose(self, problem: Problem, which: np.ndarray, other: States) -> States:
        """Take the other estimate in the windows where ``which`` (W,) is true."""
        return States(
            np.where(which[:, None], other.states, self.states),
            np.where(which[problem.owner], other.residuals, self.residuals),
        )


def evaluate(problem: Problem, z: FloatArray, states: FloatArray) -> States:
    """Simulate from initial states (W, S) at the scaled parameters ``z`` (P,)."""
    return States(states, problem.residuals(Point(z, states)))


def refine(problem: Problem, z: FloatArray, first: States, second: States, *, iterations: int = 1) -> States:
    """Take the better of two estimates in every window, and improve it by a few iterations.

    Args:
        problem: the fitted problem.
        z: (P,), scaled parameters, held fixed.
        first: an estimate.
        second: another one.
        iterations: iterations of each window; one is enough after a step of the parameters.
    """
    if not problem.model.state_names:
        return first
    return _improve_states(problem, z, first.or_better(problem, second), iterations)


def search_states(
    problem: Problem,
    z: FloatArray,
    states: FloatArray,
    random: np.random.Generator,
    trials: int = 12,
    *,
    near_in_scales: float = 0.05,
    far_in_scales: float = 0.5,
) -> FloatArray:
    """Search the initial state of every window from random starts near the best one so far.

    Two thirds of the starts are near, one third far; the values are heuristics.

    Args:
        problem: the fitted problem.
        z: (P,), scaled parameters, held fixed.
        states: (W, S), states to begin with.
        random: source of the starts.
        trials: number of starts.
        near_in_scales: standard deviation of the near starts, in scales of the states.
        far_in_scales: standard deviation of the far starts, in scales of the states.

    Returns:
        The best initial states (W, S).
    """
    best = evaluate(problem, z, states)
    for k in range(trials if states.shape[1] else 0):
        centre = problem.guess if k % 2 else best.states
        spread = (far_in_scales if k % 3 == 0 else near_in_scales) * problem.model.state_scale
        begin = centre + random.standard_normal(states.shape) * spread
        best = best.or_better(problem, _improve_states(problem, z, evaluate(problem, z, begin), 4))
    return best.states


def fit_states(problem: Problem, z: FloatArray, states: FloatArray, *, iterations: int = 8) -> FloatArray:
    """Estimate the initial state of each window from a guess.

    A second estimate has zero velocities. It is taken where the Bayesian information criterion prefers it.

    Args:
        problem: the fitted problem.
        z: (P,), scaled parameters, held fixed.
        states: (W, S), states to begin with.
        iterations: iterations of Levenberg and Marquardt's method.

    Returns:
        Initial states (W, S).
    """
    if not states.shape[1]:
        return states
    free = _improve_states(problem, z, evaluate(problem, z, states), iterations)
    moving = _velocities(problem)
    resting = evaluate(problem, z, np.where(moving, 0.0, states))
    at_rest = _improve_states(problem, z, resting, iterations, ~moving)
    allowance = np.sum(moving) * np.log(_rows_of_windows(problem))
    is_resting = at_rest.costs(problem) <= free.costs(problem) + allowance
    return free.choose(problem, is_resting, at_rest).states


def grow_states(problem: Problem, z: FloatArray, shortest: float) -> FloatArray:
    """Estimate the initial state of each window on its first seconds, then on longer and longer sections.

    From a state that is guessed from a few samples a long simulation leaves the data, and the fit ends in one
    of many local minima. A state that fits a section is a good start for a section four times as long.

    Args:
        problem: the fitted problem.
        z: (P,), scaled parameters, held fixed.
        shortest: length of the first section in s.

    Returns:
        Initial states (W, S).
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
    """Whether a state is a velocity, (S,)."""
    return np.array([name.endswith("_velocity") for name in problem.model.state_names], dtype=bool)


def _rows_of_windows(problem: Problem) -> IntArray:
    """Number of residuals of each window, (W,)."""
    return np.diff(np.r_[problem.edges, len(problem.owner)])


def rescue_states(problem: Problem, z: FloatArray, estimate: States, *, outlier_ratio: float = 2.0) -> States:
    """Restart outlying windows from other velocities.

    Near an end stop the cost has several local minima in the state, and one window in a wrong one can bias
    all parameters.

    Args:
        problem: the fitted problem.
        z: (P,), scaled parameters, held fixed.
        estimate: the estimate so far.
        outlier_ratio: mean squared residual over the median of the windows, from which a window is an
            outlier.
    """
    costs = estimate.costs(problem) / _rows_of_windows(problem)
    outliers = np.flatnonzero(costs > outlier_ratio * np.median(costs))
    return _from_other_velocities(problem, z, estimate, outliers)


def _from_other_velocities(
    problem: Problem,
    z: FloatArray,
    estimate: States,
    which: IntArray,
    *,
    offsets_in_scales: tuple[float, ...] = (-0.8, -0.4, -0.2, 0.2, 0.4, 0.8),
) -> States:
    """The better, in some windows, of the estimate and those from other velocities.

    ``offsets_in_scales`` are added to the guessed velocities, in scales of the states.
    """
    moving = _velocities(problem)
    if not len(which) or not moving.any():
        return estimate
    part = problem.select_windows(which)
    best = _of_windows(problem, estimate, which)
    for offset in offsets_in_scales:
        begin = part.guess + offset * problem.model.state_scale * moving
        best = best.or_better(part, _improve_states(part, z, evaluate(part, z, begin), 6))
    return _with_windows(problem, estimate, which, best)


def _of_windows(problem: Problem, estimate: States, which: IntArray) -> States:
    """The estimate of some windows alone."""
    return States(estimate.states[which], estimate.residuals[_rows_in(problem, which)])


def _with_windows(problem: Problem, estimate: States, which: IntArray, replacement: States) -> States:
    """The estimate with that of some windows replaced."""
    states, residuals = estimate.states.copy(), estimate.residuals.copy()
    states[which], residuals[_rows_in(problem, which)] = replacement.states, replacement.residuals
    return States(states, residuals)


def _rows_in(problem: Problem, which: IntArray) -> np.ndarray:
    """Whether a residual belongs to one of the windows ``which`` (K,), (N·c,)."""
    inside = np.zeros(len(problem.edges), dtype=bool)
    inside[which] = True
    return np.asarray(inside[problem.owner])


def estimate_states_at(
    model: Model,
    theta: FloatArray,
    record: Record,
    windows: Windows,
    sigma: FloatArray,
    *,
    thorough: bool = False,
) -> States:
    """Estimate the initial states of windows for a model with known parameters.

    Args:
        model: the model.
        theta: (P,), all parameters in SI units, held fixed.
        record: the data.
        windows: W windows of the record.
        sigma: (channels,), noise of the channels.
        thorough: search further in windows whose residuals exceed the noise.

    Returns:
        Initial states and residuals.
    """
    problem = Problem(model, record, windows, np.empty(0, dtype=np.int64), theta, sigma)
    return estimate_states(problem, np.empty(0), thorough=thorough)


def estimate_states(problem: Problem, z: FloatArray, *, thorough: bool = True) -> States:
    """Estimate the initial state of every window from the problem's guess.

    Args:
        problem: the fitted problem.
        z: (P,), scaled parameters, held fixed.
        thorough: search further in windows whose residuals exceed the noise.

    Returns:
        Initial states and residuals.
    """
    estimate = _align_angles(problem, z, evaluate(problem, z, fit_states(problem, z, problem.guess)))
    estimate = rescue_states(problem, z, estimate)
    return _search_unexplained(problem, z, estimate) if thorough and problem.model.state_names else estimate


def _align_angles(problem: Problem, z: FloatArray, estimate: States, *, n_angles: int = 16) -> States:
    """Estimate one offset of the angles for each recording, from ``n_angles`` starts per turn.

    The angle at the begin of a recording may be unknown; later angles follow from it. So a window has an
    angle of its own only where the Bayesian information criterion prefers that.
    """
    angles = np.array([name.endswith(ANGLE_SUFFIX) for name in problem.model.state_names])
    if not angles.any():
        return estimate
    held = replace(estimate, states=np.where(angles, problem.guess, estimate.states))
    for turns in (np.arange(n_angles) / n_angles, np.linspace(-1.0, 1.0, n_angles + 1) / n_angles):
        begin = _shift_by_recording(problem, z, held.states, 2.0 * np.pi * turns, angles)
        held = _improve_states(problem, z, begin, 8, ~angles)
    free = estimate.or_better(problem, _improve_states(problem, z, held, 8))
    common = held.costs(problem) <= free.costs(problem) + np.log(_rows_of_windows(problem))
    return free.choose(problem, common, held)


def _shift_by_recording(
    problem: Problem, z: FloatArray, states: FloatArray, shifts: FloatArray, which: np.ndarray
) -> States:
    """Add to the states ``which`` (S,) of each recording the shift that lowers its cost most."""
    costs = [evaluate(problem, z, states + shift * which).costs(problem) for shift in shifts]
    rows = [begin.row for begin in problem.record.begins]
    recording = np.searchsorted(rows, problem.windows.first, side="right") - 1
    of_recordings = np.array([np.bincount(recording, cost, len(rows)) for cost in costs])
    best = shifts[np.argmin(of_recordings, axis=0)][recording]
    return evaluate(problem, z, states + best[:, None] * which)


def _search_unexplained(problem: Problem, z: FloatArray, estimate: States) -> States:
    """Search further in windows whose residuals exceed the noise, by several methods in turn."""
    # a bounce in the first samples misleads the guess; a few samples lead to the right state nevertheless
    fewest = (problem.guess.shape[1] + 2) * problem.record.period
    for first_section in (FIRST_SECTION_IN_HORIZONS * problem.model.horizon, fewest):
        unexplained = _unexplained_windows(problem, estimate)
        estimate = _grow_windows(problem, z, estimate, unexplained, first_section)
    estimate = _from_other_velocities(problem, z, estimate, _unexplained_windows(problem, estimate))
    unexplained = _unexplained_windows(problem, estimate)
    if not len(unexplained):
        return estimate
    part = problem.select_windows(unexplained)
    states = search_states(part, z, estimate.states[unexplained], np.random.default_rng(0))
    return _with_windows(problem, estimate, unexplained, evaluate(part, z, states))


def _grow_windows(
    problem: Problem, z: FloatArray, estimate: States, which: IntArray, first_section: float
) -> States:
    """The better, in some windows, of the estimate and one on longer and longer sections of the window.

    ``first_section`` is the length of the first one in s.
    """
    if not len(which):
        return estimate
    part = problem.select_windows(which)
    grown = evaluate(part, z, grow_states(part, z, first_section))
    best = _of_windows(problem, estimate, which).or_better(part, grown)
    return _with_windows(problem, estimate, which, best)


def reestimate(problem: Problem, z: FloatArray, estimate: States) -> States:
    """Take the better of an estimate and a new one from the problem's guess, in windows beyond the noise.

    Steps of the parameters may have led windows, even most of them, into wrong local minima. Where less than
    half of the windows still have residuals beyond the noise, these are searched further.

    Args:
        problem: the fitted problem.
        z: (P,), scaled parameters, held fixed.
        estimate: the estimate so far.
    """
    unexplained = _unexplained_windows(problem, estimate)
    if not problem.model.state_names or not len(unexplained):
        return estimate
    part = problem.select_windows(unexplained)
    anew = estimate_states(part, z, thorough=False)
    best = _of_windows(problem, estimate, unexplained).or_better(part, anew)
    estimate = _with_windows(problem, estimate, unexplained, best)
    few = 2 * len(_unexplained_windows(problem, estimate)) < len(estimate.states)
    return _search_unexplained(problem, z, estimate) if few else estimate


def _unexplained_windows(problem: Problem, estimate: States, *, max_mean_square: float = 1.44) -> IntArray:
    """Windows whose residuals exceed the noise: by 20 % in RMS, a level for a few hundred samples."""
    return np.flatnonzero(estimate.costs(problem) > max_mean_square * _rows_of_windows(problem))


def _improve_states(
    problem: Problem, z: FloatArray, begin: States, iterations: int, varied: BoolArray | None = None
) -> States:
    """Levenberg and Marquardt's method with one damping per window; states ``varied`` (S,), or all, vary.

    A window is no longer simulated once a step has gained next to nothing, or where none is short enough.
    """
    estimate = begin
    damping = np.full(len(begin.states), 1e-3)
    active = np.arange(len(begin.states))
    for _ in range(iterations):
        everywhere = len(active) == len(damping)
        part = problem if everywhere else problem.select_windows(active)
        current = estimate if everywhere else _of_windows(problem, estimate, active)
        slopes = part.state_slopes(Point(z, current.states), current.residuals, varied=varied)
        gram = part.state_gram(slopes, damping[active])
        gradient = part.products(slopes, current.residuals[:, None])
        step = np.linalg.solve(gram, gradient)[:, :, 0]
        trial = evaluate(part, z, current.states - step * problem.model.state_scale)
        cost, trial_cost = current.costs(part), trial.costs(part)
        better = trial_cost < cost
        current = current.choose(part, better, trial)
        estimate = current if everywhere else _with_windows(problem, estimate, active, current)
        damping[active] *= np.where(better, 0.1, 10.0)
        damping = np.maximum(damping, 1e-8)
        gains_nothing = np.where(
            better, cost - trial_cost <= 1e-6 * trial_cost + 1e-12, damping[active] > MAX_DAMPING
        )
        active = active[~gains_nothing]
        if not len(active):
            break
    return estimate
