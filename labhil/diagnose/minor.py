"""Effects that were seen, but explain so little that an imperfect law of a larger one may, too."""

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
        """Whether an imperfect law of a larger effect is no excuse for it: not in the noise it shows in."""
        return self.share >= LEAST_SHARE or self.mean_square >= 1.0


def without_minor(data: Data, found: SearchResult) -> SearchResult:
    """What was found but for terms that explain less than the noise and too little, the least one first.

    Only where by the evidence something lasts beside what was found: laws that leave nothing but noise are no
    imperfect ones.

    Args:
        data: what was searched.
        found: what the evidence and held-out data speak for; a curve has been weighed beside all of it.
    """
    if found.curve is not None or not found.complete or not found.disturbed:
        return found
    fit = found.final
    data = replace(data, model=fit.problem.model, window=fit.window, sigma=fit.problem.sigma, held=fit.held)
    minor: list[Minor] = []
    while len(found.missing) > 1:
        small = {term: part.share for term, part in _explained(found).items() if not part.counts}
        if not small:
            break
        least = min(small, key=lambda term: small[term])
        minor.append(Minor(least, small[least]))
        final = refit(data, found.final, without(data.model, found.final.terms, least), ())
        found = found.ending(final, tuple(step for step in found.missing if step.terms[0] in final.terms))
    return replace(found, minor=(*found.minor, *minor))


def _explained(found: SearchResult) -> dict[str, Explained]:
    """What each term explains of the outputs that it acts on: the others take its part as slopes allow."""
    final, problem = found.final, found.final.problem
    lin = problem.linearise(final.solution.point, final.solution.residuals)
    terms = [problem.model.parameters[i].term for i in problem.free]
    outputs = len(problem.sigma)
    slopes = problem.project(lin, lin.by_parameters).reshape(-1, outputs, len(terms)).transpose(1, 0, 2)
    residuals = final.solution.residuals.reshape(-1, outputs).T
    pulls = np.einsum("cnp,cn->cp", slopes, residuals)
    products = slopes.transpose(0, 2, 1) @ slopes
    acts = np.any(lin.by_parameters.reshape(-1, outputs, len(terms)) != 0.0, axis=0)
    rows = final.dof / outputs
    by_all = (found.baseline.mean_squares - final.mean_squares) * rows
    explained = dict[str, Explained]()
    for key in (step.terms[0] for step in found.missing):
        gone = without(problem.model, final.terms, key)
        own = np.array([term is not None and term not in gone for term in terms])
        step = _taken_away(final, own, products.sum(axis=0))
        more = np.einsum("p,cpq,q->c", step, products, step) - 2.0 * pulls @ step
        on = acts[:, own].any(axis=1)
        if not on.any():  # a hold changes nothing until it lets go: its slope does not say what it explains
            continue
        own_part = float(more[on].sum())
        share = own_part / max(float(by_all[on].sum()), 1e-300)
        explained[key] = Explained(share, own_part / max(rows * int(on.sum()), 1.0))
    return explained


def _taken_away(fitted: Fitted, own: BoolArray, products: FloatArray) -> FloatArray:
    """Change (P,), taken off, of parameters where the sizes of a term go and all others make up for it."""
    parameters = [fitted.problem.model.parameters[i] for i in fitted.problem.free]
    step = np.array(
        [
            fitted.theta[place] / p.scale if gone and not p.shape else 0.0
            for place, p, gone in zip(fitted.problem.free, parameters, own, strict=True)
        ]
    )
    others = ~own
    step[others] = -np.linalg.pinv(products[np.ix_(others, others)], hermitian=True) @ (
        products[np.ix_(others, own)] @ step[own]
    )
    return step
