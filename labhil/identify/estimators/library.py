"""Global searches of kept libraries, behind the same door: scipy's, CMA-ES by pycma, MCMC by emcee."""

from __future__ import annotations

import math

import numpy as np

from labhil.errors import MissingExtraError
from labhil.identify.estimators.search import Found, Ledger
from labhil.signals import FloatArray


def differential_evolution(
    ledger: Ledger, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> Found:
    """Storn and Price's differential evolution (scipy: best/1/bin), without its polish."""
    from scipy import optimize

    optimize.differential_evolution(
        ledger.one,
        list(zip(ledger.box.lower, ledger.box.upper, strict=True)),
        maxiter=iterations,
        popsize=10,
        tol=0.0,
        rng=np.random.default_rng(seed),
        polish=False,
        x0=None if start is None else ledger.box.clip(start),
        callback=lambda *_: ledger.enough(),
    )
    return ledger.found()


def simulated_annealing(
    ledger: Ledger, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> Found:
    """Generalised simulated annealing (scipy's dual_annealing, without its local search)."""
    from scipy import optimize

    optimize.dual_annealing(
        ledger.one,
        list(zip(ledger.box.lower, ledger.box.upper, strict=True)),
        maxiter=iterations,
        maxfun=ledger.budget.evaluations,
        no_local_search=True,
        rng=np.random.default_rng(seed),
        x0=None if start is None else ledger.box.clip(start),
        callback=lambda *_: ledger.enough(),
    )
    ledger.enough()
    return ledger.found()


def cma_es(ledger: Ledger, seed: int, start: FloatArray | None = None, iterations: int = 1000) -> Found:
    """Covariance matrix adaptation (Hansen), by pycma; from the middle of the box where no start is given."""
    try:
        import cma
    except ImportError as error:
        raise MissingExtraError("cma", "search", "the estimator cma_es") from error
    box = ledger.box
    # draws of its own: nobody else's are begun anew by them
    random = np.random.default_rng(seed)
    span = box.upper - box.lower
    begin = 0.5 * np.ones(len(box)) if start is None else (box.clip(start) - box.lower) / span
    evolution = cma.CMAEvolutionStrategy(
        begin,
        0.25,
        {
            "bounds": [0.0, 1.0],
            "seed": math.nan,
            "randn": lambda *shape: random.standard_normal(shape),
            "maxiter": iterations,
            "verbose": -9,
        },
    )
    while not evolution.stop():
        asked = evolution.ask()
        costs = ledger.many(box.lower + np.asarray(asked) * span)
        # only ranks count; a logarithm of either sign keeps its stopping rules apt for costs of any size
        evolution.tell(asked, np.arcsinh(1e12 * costs).tolist())
        if ledger.enough():
            break
    return ledger.found()


def mcmc(ledger: Ledger, seed: int, start: FloatArray | None = None, iterations: int = 1000) -> Found:
    """Sample exp(−cost/2) inside the box by emcee's affine-invariant walkers; ``draws`` is its second half.

    The cost must be a sum of squares in units of noise. Walkers begin close to ``start``, or anywhere.
    ``stopped_because`` tells whether the chain is long against its autocorrelation time.
    """
    try:
        import emcee
    except ImportError as error:
        raise MissingExtraError("emcee", "search", "the estimator mcmc") from error
    box, walkers = ledger.box, 4 * len(ledger.box)
    random = np.random.default_rng(seed)
    begin = box.draw(random, walkers)
    if start is not None:
        near = 1e-3 * (box.upper - box.lower)
        # walkers that share a bound would never leave it: they begin beside it
        inside = np.clip(start, box.lower + 3.0 * near, box.upper - 3.0 * near)
        begin = box.clip(inside + near * random.standard_normal(begin.shape))

    def log_posterior(z: FloatArray) -> float:
        if np.any(z < box.lower) or np.any(z > box.upper):
            return -np.inf
        return -0.5 * ledger.one(z)

    sampler = emcee.EnsembleSampler(walkers, len(box), log_posterior)
    sampler.random_state = np.random.RandomState(seed).get_state()
    steps = min(iterations, max(ledger.budget.evaluations // walkers, 2))
    for k, _ in enumerate(sampler.sample(begin, iterations=steps)):
        if k % 20 == 0 and ledger.enough():
            break
    chain = sampler.get_chain(discard=sampler.iteration // 2, flat=True)
    # a walker that never moved has no autocorrelation
    with np.errstate(invalid="ignore", divide="ignore"):
        time = float(np.max(sampler.get_autocorr_time(quiet=True, tol=0)))
    told = f"is {sampler.iteration / time:.0f} autocorrelation times long" if time > 0.0 else "is too short"
    ledger.stopped_because = f"chain of {sampler.iteration} steps {told}"
    return ledger.found(draws=np.asarray(chain))
