"""Effects that show, but explain so little that an imperfect law of a larger one may, too."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.judge import Data
from labhil.diagnose.refit import refit, without
from labhil.diagnose.search_result import Minor, SearchResult
from labhil.identify.fitted import Fitted
from labhil.signals import BoolArray, FloatArray

LEAST_SHARE = 0.01
"""Of the mismatch's mean square: laws of friction or inertia that are wrong by a tenth leave as much."""


@dataclass(frozen=True, slots=True)
class Explained:
    """What a term explains: its ``share`` of what all do, and the mean square of that in noise levels."""

    share: float
    mean_square: float

    @property
    def counts(self) -> bool:
        """Whether its share is too large for an imperfect law of a larger effect, or it exceeds the noise."""
        return self.share >= LEAST_SHARE or self.mean_square >= 1.0


def without_minor(data: Data, result: SearchResult) -> SearchResult:
    """The result but for terms that explain less than the noise and too little, the least one first.

    Only where by the evidence something lasts beside the named terms: laws that leave nothing but noise are
    no imperfect ones.

    Args:
        data: the searched data.
        result: the terms that the evidence and held-out data support; a curve was weighed beside all of them.
    """
    if result.curve is not None or not result.complete or not result.disturbed:
        return result
    fit = result.final
    data = replace(data, model=fit.problem.model, window=fit.window, sigma=fit.problem.sigma, held=fit.held)
    minor: list[Minor] = []
    while len(result.missing) > 1:
        small = {term: part.share for term, part in _explained_by_terms(result).items() if not part.counts}
        if not small:
            break
        least = min(small, key=lambda term: small[term])
        minor.append(Minor(least, small[least]))
        final = refit(data, result.final, without(data.model, result.final.terms, least), ())
        result = result.with_steps(
            final, tuple(step for step in result.missing if step.terms[0] in final.terms)
        )
    return replace(result, minor=(*result.minor, *minor))


def _explained_by_terms(result: SearchResult) -> dict[str, Explained]:
    """What each term explains of the outputs that it acts on: the others take its part as slopes allow."""
    final, problem = result.final, result.final.problem
    lin = problem.linearise(final.solution.point, final.solution.residuals)
    terms = [problem.model.parameters[i].term for i in problem.free]
    outputs = len(problem.sigma)
    slopes = problem.project(lin, lin.by_parameters).reshape(-1, outputs, len(terms)).transpose(1, 0, 2)
    residuals = final.solution.residuals.reshape(-1, outputs).T
    pulls = np.einsum("cnp,cn->cp", slopes, residuals)
    products = slopes.transpose(0, 2, 1) @ slopes
    acts = np.any(lin.by_parameters.reshape(-1, outputs, len(terms)) != 0.0, axis=0)
    rows = final.dof / outputs
    by_all = (result.baseline.mean_squares - final.mean_squares) * rows
    explained = dict[str, Explained]()
    for key in (step.terms[0] for step in result.missing):
        gone = without(problem.model, final.terms, key)
        of_term = np.array([term is not None and term not in gone for term in terms])
        step = _removal_step(final, of_term, products.sum(axis=0))
        more = np.einsum("p,cpq,q->c", step, products, step) - 2.0 * pulls @ step
        on = acts[:, of_term].any(axis=1)
        if not on.any():  # a hold changes nothing until it lets go: its slope does not say what it explains
            continue
        own_part = float(more[on].sum())
        share = own_part / max(float(by_all[on].sum()), 1e-300)
        explained[key] = Explained(share, own_part / max(rows * int(on.sum()), 1.0))
    return explained


def _removal_step(fitted: Fitted, of_term: BoolArray, products: FloatArray) -> FloatArray:
    """Change (P,), taken off, of parameters where the sizes of a term go and all others make up for it."""
    parameters = [fitted.problem.model.parameters[i] for i in fitted.problem.free]
    step = np.array(
        [
            fitted.theta[place] / p.scale if gone and not p.shape else 0.0
            for place, p, gone in zip(fitted.problem.free, parameters, of_term, strict=True)
        ]
    )
    others = ~of_term
    step[others] = -np.linalg.pinv(products[np.ix_(others, others)], hermitian=True) @ (
        products[np.ix_(others, of_term)] @ step[of_term]
    )
    return step
