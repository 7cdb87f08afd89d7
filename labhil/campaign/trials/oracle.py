"""The oracle: it knows the true terms and the true noise, and says how much of an effect data can tell."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from labhil.campaign.trials.noise import TrueNoise
from labhil.identify.fitted import climb, start_theta
from labhil.identify.problem import Point, Problem
from labhil.identify.score import Score, score
from labhil.identify.window_states import fit_states
from labhil.identify.windows import fit_windows
from labhil.physics.model import Model, Record
from labhil.signals import FloatArray

RUNGS = (0.5, 1.5)
"""Lengths of the windows of a refit, in scored horizons; the last as long as those of a likelihood.

Where nothing but the measurement is noisy, shorter windows would throw away what the data know.
"""
JUDGED = 1.5
"""Length of the windows of a likelihood, in scored horizons: a lead-in and a scored stretch."""
STEPS = 12
MOST_CARRIED = 100.0
"""Variance that an unseen initial state may carry into a floor, in those of the noise (as in a score)."""


@dataclass(frozen=True, slots=True)
class Refit:
    """A model's vector fitted to the search data, and the sum of its squared residuals there."""

    theta: FloatArray
    cost: float


@dataclass(frozen=True, slots=True)
class Oracle:
    """Refits and judges with the true noise; ``values`` are the truth by key of the model's parameters.

    ``horizon`` (s) is that of the truth, the same for all models that are compared.
    """

    model: Model
    search: Record
    test: Record
    noise: TrueNoise
    values: Mapping[str, float]
    horizon: float

    @classmethod
    def of(
        cls, model: Model, search: Record, test: Record, noise: TrueNoise, values: Mapping[str, float]
    ) -> Oracle:
        """An oracle whose horizon is that of the true values."""
        theta = start_theta(model, values)
        return cls(model, model.prepare(search), model.prepare(test), noise, values, model.horizon_at(theta))

    def refit(self, terms: Sequence[str], fresh: Sequence[str] = ()) -> Refit:
        """These terms fitted to the search data from the truth on.

        Terms in ``fresh``, which are not in the truth, begin at each of their own starts.
        """
        known = {k: v for k, v in self.values.items() if _term_of(k) in ("", *terms)}
        lengths = [share * self.horizon for share in RUNGS]
        rungs = climb(
            self.model, self.search, terms, lengths, self.noise.sigma,
            start=start_theta(self.model, known), fresh=fresh,
        )  # fmt: skip
        return Refit(rungs[-1].theta, rungs[-1].solution.cost)

    def strength(self, theta: FloatArray) -> float:
        """RMSE of a vector on the test data over the noise floor, the mean of all outputs'."""
        marks = score(self.model, theta, self.test, self.noise.sigma, self.horizon)
        floors = self.floors(theta, marks)
        return float(np.mean([c.rmse / floor for c, floor in zip(marks.channels, floors, strict=True)]))

    def floors(self, theta: FloatArray, marks: Score) -> FloatArray:
        """RMSE of a perfect model (c,), initial-state error under the true noise included."""
        problem = _problem(self, theta, marks.windows.whole)
        point = Point(np.empty(0), marks.states)
        slopes = problem.state_slopes(point, problem.residuals(point))
        c = len(self.noise.sigma)
        slopes = slopes.reshape(-1, c, slopes.shape[1])
        carried = []
        for w in range(len(marks.windows.whole)):
            inside = marks.windows.whole.owner == w
            carried.append(self._carried(slopes[inside], marks.windows.scored[inside]))
        return np.asarray(self.noise.sigma * np.sqrt(np.concatenate(carried).mean(axis=0)))

    def _carried(self, slopes: FloatArray, scored: np.ndarray) -> FloatArray:
        """Variance (scored samples, c) of a perfect model's errors in one window, in those of the noise."""
        n, c, states = slopes.shape
        every = self.noise.correlations(n)
        lead = slopes[~scored].reshape(-1, states)
        gram = lead.T @ lead
        damped = gram + (1e-9 * np.diag(gram).max(initial=0.0) + 1e-12) * np.eye(states)
        gains = np.linalg.solve(damped, lead.T).reshape(states, -1, c)
        spread = sum(gains[:, :, j] @ every[j][np.ix_(~scored, ~scored)] @ gains[:, :, j].T for j in range(c))
        out = np.empty((int(scored.sum()), c))
        for j in range(c):
            a = slopes[scored, j]
            common = gains[:, :, j] @ every[j][np.ix_(~scored, scored)]
            grown = np.einsum("ns,st,nt->n", a, spread, a) - 2.0 * np.einsum("ns,sn->n", a, common)
            out[:, j] = 1.0 + np.minimum(grown, MOST_CARRIED)
        return out

    def log_likelihood(self, theta: FloatArray) -> float:
        """That of the test data, in windows whose initial states maximise it; nats, up to a constant."""
        problem, whiten = self._whitened(theta)
        return -0.5 * float(np.sum(_settled(problem, whiten)[0] ** 2))

    def log_likelihood_of_truth(self, theta: FloatArray, true: FloatArray) -> float:
        """The same of the plant itself, whose outputs without noise are ``true`` (n, c).

        What initial states could explain of the noise, with slopes taken along ``theta``, is taken out:
        the plant then has as many of them as a model has.
        """
        problem, whiten = self._whitened(theta)
        _, point = _settled(problem, whiten)
        rows = problem.windows.rows
        noise = ((self.test.outputs[rows] - true[rows]) / self.noise.sigma).ravel()
        slopes = problem.state_slopes(point, problem.residuals(point))
        return -0.5 * float(np.sum(_left(problem, whiten(noise[:, None])[:, 0], whiten(slopes)) ** 2))

    def _whitened(self, theta: FloatArray) -> tuple[Problem, Whiten]:
        windows = fit_windows(self.test, JUDGED * self.horizon)
        return _problem(self, theta, windows), _whitening(windows.last - windows.first, self.noise)


Whiten = Callable[[FloatArray], FloatArray]


def _problem(oracle: Oracle, theta: FloatArray, windows: object) -> Problem:
    nothing = np.empty(0, dtype=np.int64)
    return Problem(oracle.model, oracle.test, windows, nothing, theta, oracle.noise.sigma)  # type: ignore[arg-type]


def _whitening(lengths: np.ndarray, noise: TrueNoise) -> Whiten:
    """A map that makes rows (N·c, k), window after window, as independent as white noise of variance 1."""
    c = len(noise.sigma)
    factors = {
        int(n): [cholesky(matrix, lower=True) for matrix in noise.correlations(int(n))]
        for n in np.unique(lengths)
    }
    ends = np.cumsum(lengths)

    def whiten(rows: FloatArray) -> FloatArray:
        shaped = rows.reshape(-1, c, rows.shape[1])
        out = np.empty_like(shaped)
        for first, last in zip(ends - lengths, ends, strict=True):
            for j, factor in enumerate(factors[int(last - first)]):
                out[first:last, j] = solve_triangular(factor, shaped[first:last, j], lower=True)
        return out.reshape(rows.shape)

    return whiten


def _settled(problem: Problem, whiten: Whiten) -> tuple[FloatArray, Point]:
    """White residuals (N·c,) with each window's state where its likelihood is highest (Gauss-Newton)."""
    none = np.empty(0)
    point = Point(none, fit_states(problem, none, problem.guess))
    residuals = problem.residuals(point)
    white = whiten(residuals[:, None])[:, 0]
    share = np.ones(len(point.states))
    for _ in range(STEPS):
        slopes = whiten(problem.state_slopes(point, residuals))
        step = np.linalg.solve(
            problem.state_gram(slopes), problem.per_window(slopes * white[:, None])[:, :, None]
        )[:, :, 0]
        tried = Point(none, point.states - share[:, None] * step * problem.model.state_scale)
        after = problem.residuals(tried)
        white_after = whiten(after[:, None])[:, 0]
        gained = problem.per_window(white**2) - problem.per_window(white_after**2)
        better = gained > 0.0
        share = np.where(better, 1.0, 0.3 * share)
        rows = better[problem.owner]
        point = Point(none, np.where(better[:, None], tried.states, point.states))
        residuals, white = np.where(rows, after, residuals), np.where(rows, white_after, white)
        if float(gained[better].sum()) < 1e-3 and share.min() < 0.1:
            break
    return white, point


def _left(problem: Problem, white: FloatArray, slopes: FloatArray) -> FloatArray:
    """What each window's own states leave of white rows (N·c,)."""
    mixed = problem.per_window(slopes * white[:, None])[:, :, None]
    share = np.linalg.solve(problem.state_gram(slopes), mixed)[:, :, 0]
    return np.asarray(white - np.einsum("ns,ns->n", slopes, share[problem.owner]))


def _term_of(key: str) -> str:
    """The term that a parameter's key belongs to; empty for a rig's own."""
    name, dot, _ = key.partition(".")
    return name if dot else ""
