"""Global searches of kept libraries, behind the same door: scipy's, and CMA-ES by pycma."""

from __future__ import annotations

import math

import numpy as np

from labhil.extras import load_optional
from labhil.identify.estimators.search import Ledger, SearchResult
from labhil.signals import FloatArray


def differential_evolution(
    ledger: Ledger, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
    """Storn and Price's differential evolution (scipy: best/1/bin), without its polish."""
    from scipy import optimize

    # scipy rounds a start on the very edge of its box to beyond it
    edge = 1e-9 * (ledger.box.upper - ledger.box.lower)
    optimize.differential_evolution(
        ledger.one,
        list(zip(ledger.box.lower, ledger.box.upper, strict=True)),
        maxiter=iterations,
        popsize=10,
        tol=0.0,
        rng=np.random.default_rng(seed),
        polish=False,
        x0=None if start is None else np.clip(start, ledger.box.lower + edge, ledger.box.upper - edge),
        callback=lambda *_: ledger.enough(),
    )
    return ledger.result()


def simulated_annealing(
    ledger: Ledger, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
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
    return ledger.result()


def cma_es(
    ledger: Ledger, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
    """Covariance matrix adaptation (Hansen), by pycma; from the middle of the box where no start is given."""
    cma = load_optional("cma", "the estimator cma_es")
    box = ledger.box
    # its own generator: numpy's global one keeps its state
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
        candidates = evolution.ask()
        costs = ledger.many(box.lower + np.asarray(candidates) * span)
        # only ranks count; a logarithm of either sign keeps its stopping rules apt for costs of any size
        evolution.tell(candidates, np.arcsinh(1e12 * costs).tolist())
        if ledger.enough():
            break
    return ledger.result()
