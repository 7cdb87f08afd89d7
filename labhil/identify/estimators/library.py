"""Global searches of other libraries with the interface of ``search``: scipy's, and CMA-ES by pycma."""

from __future__ import annotations

import math

import numpy as np

from labhil.extras import load_optional
from labhil.identify.estimators.search import CostEvaluator, SearchResult
from labhil.signals import FloatArray


def differential_evolution(
    evaluator: CostEvaluator, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
    """Differential evolution (Storn and Price 1997; scipy, best/1/bin), without a local search at its end."""
    from scipy import optimize

    # scipy rounds a start on the edge of its box to beyond it
    edge = 1e-9 * (evaluator.box.upper - evaluator.box.lower)
    optimize.differential_evolution(
        evaluator.evaluate,
        list(zip(evaluator.box.lower, evaluator.box.upper, strict=True)),
        maxiter=iterations,
        popsize=10,
        tol=0.0,
        rng=np.random.default_rng(seed),
        polish=False,
        x0=None if start is None else np.clip(start, evaluator.box.lower + edge, evaluator.box.upper - edge),
        callback=lambda *_: evaluator.end_round(),
    )
    return evaluator.result()


def simulated_annealing(
    evaluator: CostEvaluator, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
    """Generalised simulated annealing (scipy's ``dual_annealing``), without its local search."""
    from scipy import optimize

    optimize.dual_annealing(
        evaluator.evaluate,
        list(zip(evaluator.box.lower, evaluator.box.upper, strict=True)),
        maxiter=iterations,
        maxfun=evaluator.budget.evaluations,
        no_local_search=True,
        rng=np.random.default_rng(seed),
        x0=None if start is None else evaluator.box.clip(start),
        callback=lambda *_: evaluator.end_round(),
    )
    evaluator.end_round()
    return evaluator.result()


def cma_es(
    evaluator: CostEvaluator, seed: int, start: FloatArray | None = None, iterations: int = 1000
) -> SearchResult:
    """Covariance matrix adaptation (CMA-ES, Hansen; pycma), from the middle of the box without a start."""
    cma = load_optional("cma", "the estimator cma_es")
    box = evaluator.box
    # a generator of its own leaves the state of numpy's global one alone
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
        costs = evaluator.evaluate_all(box.lower + np.asarray(candidates) * span)
        # only ranks count; this signed logarithm makes its stopping rules work for costs of any size
        evolution.tell(candidates, np.arcsinh(1e12 * costs).tolist())
        if evaluator.end_round():
            break
    return evaluator.result()
