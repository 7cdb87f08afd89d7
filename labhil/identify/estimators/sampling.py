"""Draws of a posterior by Markov chains (emcee), and how long they are against their memory."""

from __future__ import annotations

import numpy as np

from labhil.extras import load_optional
from labhil.identify.estimators.search import Ledger, SearchResult
from labhil.signals import FloatArray

WALKERS = 4
"""Per dimension."""

LONG_ENOUGH = 50.0
"""Autocorrelation times that a chain must last before its draws show the posterior (emcee's own rule)."""

ROUND = 20
"""Steps between two looks at the budget, and a fifth of those between two looks at the memory."""


def mcmc(ledger: Ledger, seed: int, start: FloatArray | None = None, iterations: int = 1000) -> SearchResult:
    """Sample exp(−cost/2) inside the box by affine-invariant walkers (Goodman and Weare 2010; emcee).

    The cost must be a sum of squares in units of noise. Walkers begin close to ``start``, or anywhere, and
    stop once the chain is 50 autocorrelation times long; ``draws`` is its second half, and
    ``stopped_because`` states its length in these.
    """
    emcee = load_optional("emcee", "the estimator mcmc")
    box, begin = ledger.box, _walkers(ledger, seed, start)

    def log_posterior(z: FloatArray) -> float:
        if np.any(z < box.lower) or np.any(z > box.upper):
            return -np.inf
        return -0.5 * ledger.one(z)

    sampler = emcee.EnsembleSampler(*begin.shape, log_posterior)
    sampler.random_state = np.random.RandomState(seed).get_state()
    steps = min(iterations, max(ledger.budget.evaluations // len(begin), 2))
    for k, _ in enumerate(sampler.sample(begin, iterations=steps)):
        if k % ROUND == 0 and ledger.enough():
            break
        if k % (5 * ROUND) == 0 and k > _memory(sampler.get_chain()) * LONG_ENOUGH > 0.0:
            break
    chain = sampler.get_chain()
    time = _memory(chain)
    length = f"is {len(chain) / time:.0f} autocorrelation times long" if time > 0.0 else "is too short"
    ledger.stopped_because = f"chain of {len(chain)} steps {length}"
    return ledger.result(draws=chain[len(chain) // 2 :].reshape(-1, chain.shape[2]))


def _walkers(ledger: Ledger, seed: int, start: FloatArray | None) -> FloatArray:
    """Where the walkers begin (walkers, P)."""
    box, random = ledger.box, np.random.default_rng(seed)
    begin = box.draw(random, WALKERS * len(box))
    if start is None:
        return begin
    near = 1e-3 * (box.upper - box.lower)
    # walkers that share a bound would never leave it: they begin beside it
    inside = np.clip(start, box.lower + 3.0 * near, box.upper - 3.0 * near)
    return box.clip(inside + near * random.standard_normal(begin.shape))


def _memory(chain: FloatArray) -> float:
    """Longest integrated autocorrelation time of a chain (steps, walkers, P), in steps; 0 if it has none."""
    from emcee.autocorr import integrated_time

    # a walker that never moved has no autocorrelation
    with np.errstate(invalid="ignore", divide="ignore"):
        time = float(np.max(integrated_time(chain, quiet=True, tol=0)))
    return time if time > 0.0 and np.isfinite(time) else 0.0
