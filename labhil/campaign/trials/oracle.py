"""The oracle: with the true terms and the true noise it computes how identifiable a concealed effect is.

``compose.py`` scales effects by it, ``judge.py`` decides with it which effects a diagnosis has to name.
"""

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
from labhil.physics.model import Model, terms_named
from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Refit:
    """Parameters (P,) fitted to the search data, and the log likelihood of the test data under them, nats."""

    theta: FloatArray
    likelihood: float

    def best_of(self, *nested: Refit) -> Refit:
        """Return the most likely of this refit and of refits of models nested in it.

        A model explains at least what a model nested in it explains; a search may miss that minimum.
        """
        return max([self, *nested], key=lambda refit: refit.likelihood)


@dataclass(frozen=True, slots=True)
class Oracle:
    """Refits and scores models with the true noise.

    Attributes:
        model: the model.
        search: the search recording, as the model prepares it.
        test: the test recording, as the model prepares it.
        noise: the true noise of the outputs.
        values: true values by key of the model's parameters.
        horizon: scored horizon at the true values, s; the same for all models.
        sigma: standard deviation (c,) of the noise in the prepared search recording.
        residual_noise: noise in the prepared test recording.
        window_horizons: lengths of the windows of a refit, in scored horizons. The whole recording follows
            where it is explained about as well: only the measurement is noisy, and every window's initial
            state takes information from the data. Stick-slip makes the cost of a whole recording rough,
            above all that of a plant that integrates; there windows lead to the better minimum.
        likelihood_horizons: length of the windows of a likelihood, in scored horizons: a lead-in and a scored
            stretch.
        max_state_variance: variance that an unknown initial state may add to a noise floor, in those of the
            noise, as in a score.
    """

    model: Model
    search: Record
    test: Record
    noise: TrueNoise
    values: Mapping[str, float]
    horizon: float
    sigma: FloatArray
    residual_noise: ResidualNoise
    window_horizons: tuple[float, ...] = (0.5, 1.5)
    likelihood_horizons: float = 1.5
    max_state_variance: float = 100.0

    @classmethod
    def build(
        cls, model: Model, search: Record, test: Record, noise: TrueNoise, values: Mapping[str, float]
    ) -> Oracle:
        """Build the oracle of two recordings, whose horizon is that of the true values."""
        theta = start_theta(model, values)
        prepared_search, prepared_test = model.prepare(search), model.prepare(test)
        sigma, residual_noise = noise.residual_in(prepared_search).sigma, noise.residual_in(prepared_test)
        return cls(
            model,
            prepared_search,
            prepared_test,
            noise,
            values,
            model.horizon_at(theta),
            sigma,
            residual_noise,
        )

    def refit(self, terms: Sequence[str], fresh: Sequence[str] = ()) -> Refit:
        """Fit terms to the search data, from the true values.

        Of several minima that explain the search data about as well the test data select one.

        Args:
            terms: names of the model's terms.
            fresh: those of them that are not in the truth; they begin at each of their own starts.
        """
        known = self._true_values(terms)
        minima = self._fit_windows(terms, known, fresh)
        if self._states:
            minima.append(self._fit_whole(min(minima, key=_cost), terms, known))
        allowed = MAX_RESIDUAL_GROWTH * min(fitted.noise for fitted in minima)
        refits = [
            Refit(fitted.theta, self.log_likelihood(fitted.theta))
            for fitted in minima
            if fitted.noise <= allowed
        ]
        return refits[0].best_of(*refits[1:])

    def fit_on_windows(self, terms: Sequence[str]) -> FloatArray:
        """Fit terms on windows only: near enough to measure how strong an effect is; the vector (P,)."""
        return min(self._fit_windows(terms, self._true_values(terms), ()), key=_cost).theta

    def _true_values(self, terms: Sequence[str]) -> dict[str, float]:
        """True values of these terms and of the rig's own parameters."""
        keys = {p.key for p in self.model.parameters if p.term is None}
        keys |= {p.key for term in terms_named(self.model, terms) for p in term.parameters}
        return {k: v for k, v in self.values.items() if k in keys}

    def _fit_windows(
        self, terms: Sequence[str], known: Mapping[str, float], fresh: Sequence[str]
    ) -> list[Fitted]:
        """Fit on windows from the values ``known``: by continuation from short ones, and directly."""
        model, search, sigma, begin = self.model, self.search, self.sigma, start_theta(self.model, known)
        if not self._states:
            return [
                fit_by_continuation(
                    model, search, terms, [search.longest], sigma, start=begin, new_terms=fresh
                )[-1]
            ]
        # only initial states need windows
        lengths = [share * self.horizon for share in self.window_horizons]
        continued = fit_by_continuation(model, search, terms, lengths, sigma, start=begin, new_terms=fresh)[
            -1
        ]
        states = estimate_states_at(
            model, begin, search, continued.problem.windows, sigma, thorough=True
        ).states
        direct = fit_terms(
            model, search, terms, lengths[-1], sigma, start=begin, states=states, new_terms=fresh
        )
        return [continued, direct]

    def _fit_whole(self, best: Fitted, terms: Sequence[str], known: Mapping[str, float]) -> Fitted:
        """Fit to whole recordings, from the best fit on windows or from the values ``known``."""
        starts: list[Mapping[str, float]] = [{}, known]
        longest = self.search.longest
        return fit_terms(self.model, self.search, terms, longest, self.sigma, start=best.theta, starts=starts)

    def test_score(self, theta: FloatArray) -> Score:
        """Score a vector on the test data."""
        return score(self.model, theta, self.test, self.residual_noise.sigma, self.horizon)

    def strength(self, theta: FloatArray, joint: int | None = None) -> float:
        """Return RMSE over noise floor of a vector on the test data: mean of all outputs or of a joint's."""
        test_score = self.test_score(theta)
        floors = self.noise_floors(theta, test_score)
        return float(
            np.mean(
                [
                    channel.rmse / floor
                    for channel, floor in zip(test_score.channels, floors, strict=True)
                    if joint is None or channel.joint == joint
                ]
            )
        )

    def noise_floors(self, theta: FloatArray, test_score: Score) -> FloatArray:
        """Return the RMSE of a perfect model (c,), its initial-state error under the true noise included."""
        if not self._states:
            return self.residual_noise.rms
        problem = _problem(self, theta, test_score.windows.whole)
        point = Point(np.empty(0), test_score.states)
        slopes = problem.state_slopes(point, problem.residuals(point))
        c = len(self.residual_noise.sigma)
        slopes = slopes.reshape(-1, c, slopes.shape[1])
        variances = []
        for w in range(len(test_score.windows.whole)):
            in_window = test_score.windows.whole.owner == w
            variances.append(
                self._propagated_variance(slopes[in_window], test_score.windows.scored[in_window])
            )
        return np.asarray(self.residual_noise.sigma * np.sqrt(np.concatenate(variances).mean(axis=0)))

    def _propagated_variance(self, slopes: FloatArray, scored: np.ndarray) -> FloatArray:
        """Return the variance (scored samples, c) of a perfect model in a window, in noise variances."""
        n, c, states = slopes.shape
        correlations = [self.residual_noise.correlation(j, np.arange(n)) for j in range(c)]
        lead = slopes[~scored].reshape(-1, states)
        gram = lead.T @ lead
        damped = gram + (1e-9 * np.diag(gram).max(initial=0.0) + 1e-12) * np.eye(states)
        gains = np.linalg.solve(damped, lead.T).reshape(states, -1, c)
        spread = sum(
            gains[:, :, j] @ correlations[j][np.ix_(~scored, ~scored)] @ gains[:, :, j].T for j in range(c)
        )
        out = np.empty((int(scored.sum()), c))
        for j in range(c):
            slope = slopes[scored, j]
            common = gains[:, :, j] @ correlations[j][np.ix_(~scored, scored)]
            excess = np.einsum("ns,st,nt->n", slope, spread, slope) - 2.0 * np.einsum(
                "ns,sn->n", slope, common
            )
            out[:, j] = 1.0 + np.minimum(excess, self.max_state_variance)
        return out

    def log_likelihood(self, theta: FloatArray) -> float:
        """Return the log likelihood of the test data, maximal over the windows' initial states.

        It is in nats, up to a constant.
        """
        problem, whiten = self._test_problem(theta)
        return -0.5 * float(np.sum(_maximise_over_states(problem, whiten)[0] ** 2))

    def log_likelihood_of_truth(self, theta: FloatArray, silent: Record) -> float:
        """Return the log likelihood of the plant itself.

        The share of the noise that initial states could explain is projected out, so that the plant has as
        many initial states as a model.

        Args:
            theta: parameters (P,) at which the slopes over initial states are taken.
            silent: the test recording with outputs without noise.
        """
        problem, whiten = self._test_problem(theta)
        _, point = _maximise_over_states(problem, whiten)
        rows = problem.windows.rows
        noiseless = self.model.prepare(silent).outputs
        noise = ((self.test.outputs[rows] - noiseless[rows]) / self.residual_noise.sigma).ravel()
        slopes = problem.state_slopes(point, problem.residuals(point))
        return -0.5 * float(np.sum(problem.project_out_states(whiten(slopes), whiten(noise[:, None])) ** 2))

    def _test_problem(self, theta: FloatArray) -> tuple[Problem, Whiten]:
        windows = (
            fit_windows(self.test, self.likelihood_horizons * self.horizon)
            if self._states
            else whole_recordings(self.test).whole
        )
        return _problem(self, theta, windows), _whitening_map(windows, self.residual_noise)

    @property
    def _states(self) -> bool:
        """Whether windows of this model have initial states."""
        return bool(self.model.state_names)


def _cost(fitted: Fitted) -> float:
    return fitted.solution.cost


Whiten = Callable[[FloatArray], FloatArray]


def _problem(oracle: Oracle, theta: FloatArray, windows: Windows) -> Problem:
    no_parameters = np.empty(0, dtype=np.int64)
    return Problem(oracle.model, oracle.test, windows, no_parameters, theta, oracle.residual_noise.sigma)


def _whitening_map(windows: Windows, noise: ResidualNoise) -> Whiten:
    """Return a map that whitens rows (N·c, k), window after window; rows that are not judged become zero."""
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


def _maximise_over_states(problem: Problem, whiten: Whiten, max_steps: int = 12) -> tuple[FloatArray, Point]:
    """Maximise each window's likelihood over its initial state (Gauss-Newton); whitened residuals (N·c,)."""
    no_parameters = np.empty(0)
    estimate = estimate_states(problem, no_parameters)
    point, residuals = Point(no_parameters, estimate.states), estimate.residuals
    white = whiten(residuals[:, None])[:, 0]
    if not problem.model.state_names:
        return white, point
    step_size = np.ones(len(point.states))
    for _ in range(max_steps):
        slopes = whiten(problem.state_slopes(point, residuals))
        step = np.linalg.solve(problem.state_gram(slopes), problem.products(slopes, white[:, None]))[:, :, 0]
        candidate = Point(no_parameters, point.states - step_size[:, None] * step * problem.model.state_scale)
        after = problem.residuals(candidate)
        white_after = whiten(after[:, None])[:, 0]
        gained = problem.per_window(white**2) - problem.per_window(white_after**2)
        better = gained > 0.0
        step_size = np.where(better, 1.0, 0.3 * step_size)
        rows = better[problem.owner]
        point = Point(no_parameters, np.where(better[:, None], candidate.states, point.states))
        residuals, white = np.where(rows, after, residuals), np.where(rows, white_after, white)
        if float(gained[better].sum()) < 1e-3 and step_size.min() < 0.1:
            break
    return white, point
