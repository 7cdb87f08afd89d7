"""How likely held-out data are under a fit whose parameters are known as well as the searched data know them.

A fit held where it is has to foretell with the errors of its parameters, and of two that explain the searched
data alike these can make either the better one by hundreds of nats. So parameters move as far as the held-out
data ask for and the searched ones, in second order, allow: Laplace's approximation to the likelihood of the
held-out data given the searched ones. Beforehand each is known to its scale.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from labhil.diagnose.evidence import (
    Evidence,
    Left,
    best_heldout_gain,
    bic,
    effective_samples,
    independent,
    search_p_value,
    unlikelier,
)
from labhil.diagnose.judge import ALPHA, NEEDED_BIC, Data
from labhil.identify.fitted import Fitted, climb
from labhil.identify.problem import Point, Problem
from labhil.identify.score import Score
from labhil.identify.window_states import States, fit_states, held_at, tried
from labhil.signals import FloatArray

CAUTION = 2.0
"""What a logarithm of a likelihood ratio is divided by for a p value.

Of no effect a ratio of k or more has a probability of at most 1/k; but what a model lacks lasts longer than
noise, so that it is worth less than it is counted.
"""

STEPS, OF_STATES = 3, 4
"""Steps of the parameters, and of the windows' states after each of them."""


def compare(
    data: Data, before: Fitted, after: Fitted, scores_before: Sequence[Score], looks: int
) -> tuple[Evidence, float]:
    """Evidence for ``after`` over ``before``, and the search data's corrected p value.

    Where the scores of a fit that is held are better, but not for sure, the likelihood that the searched data
    allow may tell; a term that makes up for another's form is likelier there, too, but foretells nothing.
    """
    effective = effective_samples(after)
    gain, p_value = best_heldout_gain(scores_before, data.judge(after.theta))
    delta = bic(after, effective) - bic(before, effective)
    if delta < NEEDED_BIC and p_value >= ALPHA and data.model.state_names:
        others = _likelier(data, before, after, gain, looks)
        gain, p_value = min([(gain, p_value), *others], key=itemgetter(1))
    return Evidence(delta, p_value, gain), search_p_value(before, after, effective, looks)


def _likelier(
    data: Data, before: Fitted, after: Fitted, gain: float, looks: int
) -> Iterator[tuple[float, float]]:
    """Nats and p values by likelihoods that the searched data allow: of held-out data for which scores speak.

    And of the whole test that a wider search took half of, by fits to what was searched before: a baseline
    that is refitted to that half may leave nothing to be seen in the other one. With that half all candidates
    were looked at, so that p value is corrected for their number.
    """
    if gain > 0.0:
        likelier = -0.5 * unlikelier(foretold(data, before), foretold(data, after))
        yield likelier, float(np.exp(-likelier / CAUTION))
    if data.first is not None:
        first = replace(data.first, window=min(after.window, data.first.search.longest))
        likelier = -0.5 * unlikelier(*(foretold(first, _alone(first, fitted)) for fitted in (before, after)))
        yield likelier, looks * float(np.exp(min(-likelier / CAUTION, 0.0)))


def _alone(first: Data, fitted: Fitted) -> Fitted:
    """The same terms fitted to what was searched first."""
    return climb(
        first.model, first.search, fitted.terms, [first.window], first.sigma,
        start=fitted.theta, fresh=(), held=first.held,
    )[-1]  # fmt: skip


def foretold(data: Data, fitted: Fitted, penalty: FloatArray | None = None) -> Left:
    """What a fit leaves of the held-out data, on windows as long as the search's, and at what price.

    A ``penalty`` (P, P) of the fit, of curves, says beforehand what its parameters may be, too.
    """
    model, windows, solved = fitted.problem.model, data.held_out_windows, fitted.solution
    held = held_at(model, fitted.theta, data.test, windows, data.test_sigma, thorough=True)
    problem = Problem(model, data.test, windows, fitted.problem.free, fitted.theta, data.test_sigma)
    seen = _Slopes.of(fitted.problem, solved.point.z, States(solved.point.states, solved.residuals))
    begin = problem.start().z
    known, slopes = np.eye(len(begin)) + seen.information, _Slopes.of(problem, begin, held)
    known = known if penalty is None else known + seen.worth * penalty
    spread = np.linalg.slogdet(known + slopes.information)[1] - np.linalg.slogdet(known)[1]
    best = _left(problem, held, spread)
    z = begin
    for _ in range(STEPS):
        pull = slopes.gradient + known @ (z - begin)
        z = np.clip(z - np.linalg.solve(known + slopes.information, pull), problem.lower, problem.upper)
        held = tried(problem, z, fit_states(problem, z, held.states, iterations=OF_STATES))
        left = _left(problem, held, spread + (z - begin) @ known @ (z - begin))
        if left.unlikely >= best.unlikely:
            break
        best, slopes = left, _Slopes.of(problem, z, held)
    return best


@dataclass(frozen=True, slots=True)
class _Slopes:
    """Half the slopes (P,) and curvatures (P, P) of −2 log likelihood by the parameters in their scales.

    ``worth`` is what of it a square in units of the noise counts.
    """

    gradient: FloatArray
    information: FloatArray
    worth: float

    @classmethod
    def of(cls, problem: Problem, z: FloatArray, held: States) -> _Slopes:
        """Those where the parameters are ``z``, the windows' states fitted."""
        lin = problem.linearise(Point(z, held.states), held.residuals)
        slopes = problem.project(lin, lin.by_parameters)
        rows = held.residuals.reshape(-1, len(problem.sigma))
        worth = independent(rows, problem.begins, float(problem.telling.mean())) / max(held.cost, 1e-300)
        return cls(worth * slopes.T @ held.residuals, worth * slopes.T @ slopes, worth)


def _left(problem: Problem, held: States, price: float) -> Left:
    rows = held.residuals.reshape(-1, len(problem.sigma))
    return Left(rows, problem.begins, float(problem.telling.mean()), float(price))
