"""Effects that were seen, but explain so little that an imperfect law of a larger one may, too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labhil.diagnose.found import Found, Minor
from labhil.diagnose.judge import Data
from labhil.diagnose.refit import refit, without
from labhil.identify.fitted import Fitted
from labhil.signals import BoolArray, FloatArray

LEAST_SHARE = 0.01
"""Of the mismatch's mean square: laws of friction or inertia that are wrong by a tenth leave as much."""


def without_minor(data: Data, found: Found) -> Found:
    """What was found but for terms that explain too little of the mismatch, the least one first.

    Args:
        data: what was searched.
        found: what the evidence and held-out data speak for; a curve has been weighed beside all of it.
    """
    if found.curve is not None or not found.complete:
        return found
    fit = found.final
    data = replace(data, model=fit.problem.model, window=fit.window, sigma=fit.problem.sigma, held=fit.held)
    minor: list[Minor] = []
    while len(found.missing) > 1:
        shares = _shares(found)
        least = min(shares, key=lambda term: shares[term])
        if shares[least] >= LEAST_SHARE:
            break
        minor.append(Minor(least, shares[least]))
        final = refit(data, found.final, without(data.model, found.final.terms, least), ())
        found = found.ending(final, tuple(step for step in found.missing if step.terms[0] in final.terms))
    return replace(found, minor=(*found.minor, *minor))


def _shares(found: Found) -> dict[str, float]:
    """What each term explains over what all do, of the mean squares of the outputs that it acts on.

    Without a term the others take its part as far as their slopes allow.
    """
    final, problem = found.final, found.final.problem
    lin = problem.linearise(final.solution.point, final.solution.residuals)
    terms = [problem.model.parameters[i].term for i in problem.free]
    outputs = len(problem.sigma)
    slopes = problem.project(lin, lin.by_parameters).reshape(-1, outputs, len(terms)).transpose(1, 0, 2)
    residuals = final.solution.residuals.reshape(-1, outputs).T
    pulls = np.einsum("cnp,cn->cp", slopes, residuals)
    products = slopes.transpose(0, 2, 1) @ slopes
    acts = np.any(lin.by_parameters.reshape(-1, outputs, len(terms)) != 0.0, axis=0)
    explained = (found.baseline.mean_squares - final.mean_squares) * final.dof / outputs
    shares = dict[str, float]()
    for key in (step.terms[0] for step in found.missing):
        gone = without(problem.model, final.terms, key)
        own = np.array([term is not None and term not in gone for term in terms])
        step = _taken_away(final, own, products.sum(axis=0))
        more = np.einsum("p,cpq,q->c", step, products, step) - 2.0 * pulls @ step
        on = acts[:, own].any(axis=1)
        shares[key] = float(more[on].sum() / max(explained[on].sum(), 1e-300)) if on.any() else 0.0
    return shares


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
