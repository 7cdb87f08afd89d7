"""The oracle: it knows the true terms and the true noise, and computes how identifiable an effect is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from labhil.campaign.trials.noise import ResidualNoise, TrueNoise
from labhil.identify.fitted import MAX_RESIDUAL_GROWTH, Fitted, fit_by_continuation, fit_terms, start_theta
from labhil.identify.problem import Point, Problem
from labhil.identify.score import Score, score
from labhil.identify.window_states import estimate_states, estimate_states_at
from labhil.identify.windows import fit_windows, whole_recordings
from labhil.physics.model import Model, Record, Windows, terms_named
from labhil.signals import FloatArray, IntArray

RUNGS = (0.5, 1.5)
"""Lengths of the windows of a refit, in scored horizons; the last as long as those of a likelihood.

After them comes the whole recording, if it is explained about as well: nothing but the measurement is noisy,
and every window's own initial state takes away of what the data know. A part that sticks and slips makes a
rough cost, above all of a whole recording of a plant that integrates: there windows lead to the better
minimum.
"""
JUDGED = 1.5
"""Length of the windows of a likelihood, in scored horizons: a lead-in and a scored stretch."""
STEPS = 12
MOST_CARRIED = 100.0
"""Variance that an unseen initial state may carry into a floor, in those of the noise (as in a score)."""


@dataclass(frozen=True, slots=True)
class Refit:
    """A vector fitted to the search data, and the logarithm of the test data's likelihood under it, nats."""

    theta: FloatArray
    likelihood: float

    def or_better(self, *within: Refit) -> Refit:
        """The best of this and of models within it.

        What is within a model can never explain less than the model; a search may miss that.
        """
        return max([self, *within], key=lambda refit: refit.likelihood)


@dataclass(frozen=True, slots=True)
class Oracle:
    """Refits and judges with the true noise; ``values`` are the truth by key of the model's parameters.

    ``search`` and ``test`` are prepared by the model; ``sigma`` (c,) is what that leaves of the noise in the
    search, ``residual_noise`` in the test. ``horizon`` (s) is that of the truth, the same for all models.
    """

    model: Model
    search: Record
    test: Record
    noise: TrueNoise
    values: Mapping[str, float]
    horizon: float
    sigma: FloatArray
    residual_noise: ResidualNoise

    @classmethod
    def of(
        cls, model: Model, search: Record, test: Record, noise: TrueNoise, values: Mapping[str, float]
    ) -> Oracle:
        """An oracle whose horizon is that of the true values."""
        theta = start_theta(model, values)
        learnt, judged = model.prepare(search), model.prepare(test)
        sigma, residual_noise = noise.residual_in(learnt).sigma, noise.residual_in(judged)
        return cls(model, learnt, judged, noise, values, model.horizon_at(theta), sigma, residual_noise)

    def refit(self, terms: Sequence[str], fresh: Sequence[str] = ()) -> Refit:
        """These terms fitted to the search data from the truth on.

        Terms in ``fresh``, which are not in the truth, begin at each of their own starts. Of several minima
        that explain the search data about as well the test data select the right one.
        """
        known = self._true_values(terms)
        minima = self._minima(terms, known, fresh)
        if self._states:
            minima.append(self._fit_whole(min(minima, key=_cost), terms, known))
        allowed = MAX_RESIDUAL_GROWTH * min(fitted.noise for fitted in minima)
        refits = [
            Refit(fitted.theta, self.log_likelihood(fitted.theta))
            for fitted in minima
            if fitted.noise <= allowed
        ]
        return refits[0].or_better(*refits[1:])

    def rough(self, terms: Sequence[str]) -> FloatArray:
        """The vector (P,) of a refit on windows only: near enough to measure how strong an effect is."""
        return min(self._minima(terms, self._true_values(terms), ()), key=_cost).theta

    def _true_values(self, terms: Sequence[str]) -> dict[str, float]:
        """The true values of these terms, and of the rig's own sizes."""
        keys = {p.key for p in self.model.parameters if p.term is None}
        keys |= {p.key for term in terms_named(self.model, terms) for p in term.parameters}
        return {k: v for k, v in self.values.items() if k in keys}

    def _minima(self, terms: Sequence[str], known: Mapping[str, float], fresh: Sequence[str]) -> list[Fitted]:
        """Where fits from the values ``known`` end on windows: by way of short ones, and at once."""
        model, search, sigma, begin = self.model, self.search, self.sigma, start_theta(self.model, known)
        if not self._states:
            return [
                fit_by_continuation(
                    model, search, terms, [search.longest], sigma, start=begin, new_terms=fresh
                )[-1]
            ]
        # windows are there for the sake of their initial states
        lengths = [share * self.horizon for share in RUNGS]
        climbed = fit_by_continuation(model, search, terms, lengths, sigma, start=begin, new_terms=fresh)[-1]
        states = estimate_states_at(
            model, begin, search, climbed.problem.windows, sigma, thorough=True
        ).states
        at_once = fit_terms(
            model, search, terms, lengths[-1], sigma, start=begin, states=states, new_terms=fresh
        )
        return [climbed, at_once]

    def _fit_whole(self, best: Fitted, terms: Sequence[str], known: Mapping[str, float]) -> Fitted:
        """The fit to whole recordings, from the best on windows or from the values ``known``."""
        starts: list[Mapping[str, float]] = [{}, known]
        longest = self.search.longest
        return fit_terms(self.model, self.search, terms, longest, self.sigma, start=best.theta, starts=starts)

    def marks(self, theta: FloatArray) -> Score:
        """A vector's score on the test data."""
        return score(self.model, theta, self.test, self.residual_noise.sigma, self.horizon)

    def strength(self, theta: FloatArray, joint: int | None = None) -> float:
        """RMSE of a vector on the test data over the noise floor, of all outputs, or a joint's own."""
        marks = self.marks(theta)
        floors = self.floors(theta, marks)
        return float(
            np.mean(
                [
                    channel.rmse / floor
                    for channel, floor in zip(marks.channels, floors, strict=True)
                    if joint is None or channel.joint == joint
                ]
            )
        )

    def floors(self, theta: FloatArray, marks: Score) -> FloatArray:
        """RMSE of a perfect model (c,), initial-state error under the true noise included."""
        if not self._states:
            return self.residual_noise.rms
        problem = _problem(self, theta, marks.windows.whole)
        point = Point(np.empty(0), marks.states)
        slopes = problem.state_slopes(point, problem.residuals(point))
        c = len(self.residual_noise.sigma)
        slopes = slopes.reshape(-1, c, slopes.shape[1])
        carried = []
        for w in range(len(marks.windows.whole)):
            inside = marks.windows.whole.owner == w
            carried.append(self._carried_variance(slopes[inside], marks.windows.scored[inside]))
        return np.asarray(self.residual_noise.sigma * np.sqrt(np.concatenate(carried).mean(axis=0)))

    def _carried_variance(self, slopes: FloatArray, scored: np.ndarray) -> FloatArray:
        """Variance (scored samples, c) of a perfect model's errors in one window, in those of the noise."""
        n, c, states = slopes.shape
        every = [self.residual_noise.correlation(j, np.arange(n)) for j in range(c)]
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
        """Of the test data, in windows whose initial states maximise it; nats, up to a constant."""
        problem, whiten = self._test_problem(theta)
        return -0.5 * float(np.sum(_settle_states(problem, whiten)[0] ** 2))

    def log_likelihood_of_truth(self, theta: FloatArray, silent: Record) -> float:
        """The log likelihood of the plant itself; its outputs without noise are those of ``silent``.

        What initial states could explain of the noise, with slopes taken along ``theta``, is taken out:
        the plant then has as many of them as a model has.
        """
        problem, whiten = self._test_problem(theta)
        _, point = _settle_states(problem, whiten)
        rows = problem.windows.rows
        true = self.model.prepare(silent).outputs
        noise = ((self.test.outputs[rows] - true[rows]) / self.residual_noise.sigma).ravel()
        slopes = problem.state_slopes(point, problem.residuals(point))
        return -0.5 * float(np.sum(problem.project_out_states(whiten(slopes), whiten(noise[:, None])) ** 2))

    def _test_problem(self, theta: FloatArray) -> tuple[Problem, Whiten]:
        windows = (
            fit_windows(self.test, JUDGED * self.horizon)
            if self._states
            else whole_recordings(self.test).whole
        )
        return _problem(self, theta, windows), _whitening(windows, self.residual_noise)

    @property
    def _states(self) -> bool:
        """Whether windows of this model begin in states of their own."""
        return bool(self.model.state_names)


def _cost(fitted: Fitted) -> float:
    return fitted.solution.cost


Whiten = Callable[[FloatArray], FloatArray]


def _problem(oracle: Oracle, theta: FloatArray, windows: Windows) -> Problem:
    nothing = np.empty(0, dtype=np.int64)
    return Problem(oracle.model, oracle.test, windows, nothing, theta, oracle.residual_noise.sigma)


def _whitening(windows: Windows, noise: ResidualNoise) -> Whiten:
    """A map that makes rows (N·c, k), window after window, as independent as white noise of variance 1.

    Rows that are not judged, which have no noise, become zero.
    """
    c = len(noise.sigma)
    factors: dict[bytes, FloatArray] = {}
    parts: list[tuple[int, IntArray, FloatArray]] = []
    before = 0
    for first, last in zip(windows.first, windows.last, strict=True):
        for j in range(c):
            rows = np.arange(first, last)[noise.judged[first:last, j]]
            apart = noise.places[rows] - noise.places[rows[:1]]
            key = apart.tobytes() + bytes([j])
            if key not in factors:
                factors[key] = cholesky(noise.correlation(j, rows), lower=True)
            parts.append((j, before + rows - first, factors[key]))
        before += int(last - first)

    def whiten(rows: FloatArray) -> FloatArray:
        shaped = rows.reshape(before, c, rows.shape[1])
        out = np.zeros_like(shaped)
        for j, at, factor in parts:
            out[at, j] = solve_triangular(factor, shaped[at, j], lower=True)
        return out.reshape(rows.shape)

    return whiten


def _settle_states(problem: Problem, whiten: Whiten) -> tuple[FloatArray, Point]:
    """White residuals (N·c,) with each window's state where its likelihood is highest (Gauss-Newton)."""
    none = np.empty(0)
    estimate = estimate_states(problem, none)
    point, residuals = Point(none, estimate.states), estimate.residuals
    white = whiten(residuals[:, None])[:, 0]
    if not problem.model.state_names:
        return white, point
    share = np.ones(len(point.states))
    for _ in range(STEPS):
        slopes = whiten(problem.state_slopes(point, residuals))
        step = np.linalg.solve(problem.state_gram(slopes), problem.products(slopes, white[:, None]))[:, :, 0]
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
