"""Terms that are significant but explain so little that an imperfect law of a larger term may stand for them.

:func:`drop_minor_terms` takes them out of the result of a search.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.judge import Data
from labhil.diagnose.refit import refit, without
from labhil.diagnose.search_result import Minor, SearchResult
from labhil.identify.fitted import Fitted
from labhil.signals import BoolArray, FloatArray

MIN_EXPLAINED_SHARE = 0.01
"""Share of the mean square that all terms explain, from which a term is named.

A law of friction or inertia that is wrong by a tenth leaves residuals of a tenth, 1 % of the mean square.
"""


@dataclass(frozen=True, slots=True)
class ExplainedPart:
    """The part of the residuals that a term explains.

    Attributes:
        share: its share of the mean square that all terms explain.
        mean_square: its mean square over that of the noise.
    """

    share: float
    mean_square: float

    @property
    def is_major(self) -> bool:
        """Whether it exceeds the noise, or what an imperfect law of a larger term leaves."""
        return self.share >= MIN_EXPLAINED_SHARE or self.mean_square >= 1.0


def drop_minor_terms(data: Data, result: SearchResult) -> SearchResult:
    """Drop the terms that explain less than the noise and next to nothing beside the others.

    The term that explains least is dropped first, and the others are refitted. Terms are only dropped where
    the evidence shows a disturbance beside the named ones: laws that leave nothing but noise are not
    imperfect.

    Args:
        data: the searched data.
        result: the terms that evidence and held-out data support, compared with curves beside all of them.

    Returns:
        The result with the dropped terms in ``minor``.
    """
    if result.curve is not None or not result.complete or not result.disturbed:
        return result
    fit = result.final
    data = replace(data, model=fit.problem.model, window=fit.window, sigma=fit.problem.sigma, held=fit.held)
    minor: list[Minor] = []
    while len(result.missing) > 1:
        shares = {term: part.share for term, part in _explained_by_terms(result).items() if not part.is_major}
        if not shares:
            break
        least = min(shares, key=lambda term: shares[term])
        minor.append(Minor(least, shares[least]))
        final = refit(data, result.final, without(data.model, result.final.terms, least), ())
        result = result.with_steps(
            final, tuple(step for step in result.missing if step.terms[0] in final.terms)
        )
    return replace(result, minor=(*result.minor, *minor))


def _explained_by_terms(result: SearchResult) -> dict[str, ExplainedPart]:
    """The part that each term explains of the outputs that it acts on.

    It is the increase of the mean square where the term is removed and the other parameters, by their slopes,
    compensate for it.
    """
    final, problem = result.final, result.final.problem
    lin = problem.linearise(final.solution.point, final.solution.residuals)
    terms = [problem.model.parameters[i].term for i in problem.free]
    n_outputs = len(problem.sigma)
    slopes = problem.project(lin, lin.by_parameters).reshape(-1, n_outputs, len(terms)).transpose(1, 0, 2)
    residuals = final.solution.residuals.reshape(-1, n_outputs).T
    gradients = np.einsum("cnp,cn->cp", slopes, residuals)
    products = slopes.transpose(0, 2, 1) @ slopes
    acts = np.any(lin.by_parameters.reshape(-1, n_outputs, len(terms)) != 0.0, axis=0)
    n_rows = final.dof / n_outputs
    by_all = (result.baseline.mean_squares - final.mean_squares) * n_rows
    explained = dict[str, ExplainedPart]()
    for key in (step.terms[0] for step in result.missing):
        kept = without(problem.model, final.terms, key)
        of_term = np.array([term is not None and term not in kept for term in terms])
        step = _removal_step(final, of_term, products.sum(axis=0))
        increase = np.einsum("p,cpq,q->c", step, products, step) - 2.0 * gradients @ step
        acts_on = acts[:, of_term].any(axis=1)
        if not acts_on.any():  # a hold changes nothing until it lets go: its slope shows no part of it
            continue
        by_term = float(increase[acts_on].sum())
        share = by_term / max(float(by_all[acts_on].sum()), 1e-300)
        explained[key] = ExplainedPart(share, by_term / max(n_rows * int(acts_on.sum()), 1.0))
    return explained


def _removal_step(fitted: Fitted, of_term: BoolArray, products: FloatArray) -> FloatArray:
    """Step (P,), to be subtracted, that sets the sizes of a term to zero while all others compensate."""
    parameters = [fitted.problem.model.parameters[i] for i in fitted.problem.free]
    step = np.array(
        [
            fitted.theta[place] / p.scale if is_removed and not p.shape else 0.0
            for place, p, is_removed in zip(fitted.problem.free, parameters, of_term, strict=True)
        ]
    )
    others = ~of_term
    step[others] = -np.linalg.pinv(products[np.ix_(others, others)], hermitian=True) @ (
        products[np.ix_(others, of_term)] @ step[of_term]
    )
    return step
