"""Sample the posterior distribution of the parameters by Markov chains (emcee)."""

from __future__ import annotations

import numpy as np

from labhil.extras import load_optional
from labhil.identify.estimators.search import CostEvaluator, SearchResult
from labhil.signals import FloatArray


def mcmc(
    evaluator: CostEvaluator,
    seed: int,
    start: FloatArray | None = None,
    iterations: int = 1000,
    *,
    walkers_per_dimension: int = 4,
    min_autocorrelation_times: float = 50.0,
    round_steps: int = 20,
) -> SearchResult:
    """Sample exp(−cost/2) inside the box by affine-invariant walkers (Goodman and Weare 2010; emcee).

    Args:
        evaluator: Evaluates the cost, which must be a sum of squares in units of noise.
        seed: Of the random draws.
        start: (P,) near which the walkers start; by default they start anywhere in the box.
        iterations: Largest number of steps.
        walkers_per_dimension: Number of walkers over the number of dimensions.
        min_autocorrelation_times: Length of the chain at which sampling stops (the rule of emcee's authors).
        round_steps: Steps between two checks of the budget, and a fifth of the steps between two checks of
            the chain's length.

    Returns:
        ``draws`` is the second half of the chain; ``stopped_because`` states its length in autocorrelation
        times.
    """
    emcee = load_optional("emcee", "the estimator mcmc")
    box, begin = evaluator.box, _walkers(evaluator, seed, start, walkers_per_dimension)

    def log_posterior(z: FloatArray) -> float:
        if np.any(z < box.lower) or np.any(z > box.upper):
            return -np.inf
        return -0.5 * evaluator.evaluate(z)

    sampler = emcee.EnsembleSampler(*begin.shape, log_posterior)
    sampler.random_state = np.random.RandomState(seed).get_state()
    steps = min(iterations, max(evaluator.budget.evaluations // len(begin), 2))
    for k, _ in enumerate(sampler.sample(begin, iterations=steps)):
        if k % round_steps == 0 and evaluator.end_round():
            break
        if k % (5 * round_steps) != 0:
            continue
        if k > _autocorrelation_time(sampler.get_chain()) * min_autocorrelation_times > 0.0:
            break
    chain = sampler.get_chain()
    time = _autocorrelation_time(chain)
    length = f"is {len(chain) / time:.0f} autocorrelation times long" if time > 0.0 else "is too short"
    evaluator.stopped_because = f"chain of {len(chain)} steps {length}"
    return evaluator.result(draws=chain[len(chain) // 2 :].reshape(-1, chain.shape[2]))


def _walkers(evaluator: CostEvaluator, seed: int, start: FloatArray | None, per_dimension: int) -> FloatArray:
    """Starting points of the walkers, (walkers, P)."""
    box, random = evaluator.box, np.random.default_rng(seed)
    begin = box.draw(random, per_dimension * len(box))
    if start is None:
        return begin
    near = 1e-3 * (box.upper - box.lower)
    # walkers that all lie on a bound would never leave it: they start beside it
    inside = np.clip(start, box.lower + 3.0 * near, box.upper - 3.0 * near)
    return box.clip(inside + near * random.standard_normal(begin.shape))


def _autocorrelation_time(chain: FloatArray) -> float:
    """Longest integrated autocorrelation time of a chain (steps, walkers, P), in steps; 0 if it has none."""
    from emcee.autocorr import integrated_time

    # a walker that never moved has no autocorrelation
    with np.errstate(invalid="ignore", divide="ignore"):
        time = float(np.max(integrated_time(chain, quiet=True, tol=0)))
    return time if time > 0.0 and np.isfinite(time) else 0.0
