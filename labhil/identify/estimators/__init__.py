"""Estimators by name: where a fit begins before least squares take it to the minimum.

``nlse`` begins at the model's own starts; the others search a box around them globally and hand their best
point on, so that every fit ends with least squares, errors and tests of the same kind. ``hybrid``, the
default, does both and keeps the better.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from labhil.ending import EndedEarly
from labhil.errors import UnknownNameError
from labhil.identify.estimators.coordinates import Coordinates
from labhil.identify.estimators.library import cma_es, differential_evolution, simulated_annealing
from labhil.identify.estimators.sampling import mcmc
from labhil.identify.estimators.search import Budget, Ledger, Progress, SearchResult
from labhil.identify.estimators.swarm import adaptive_swarm, affordable, swarm_with_evolution, text_swarm
from labhil.identify.problem import Problem
from labhil.signals import FloatArray

Method = Callable[..., SearchResult]

METHODS: Mapping[str, Method] = {
    "pso": text_swarm,
    "pso_adaptive": adaptive_swarm,
    "pso_de": swarm_with_evolution,
    "differential_evolution": differential_evolution,
    "simulated_annealing": simulated_annealing,
    "cma_es": cma_es,
    "mcmc": mcmc,
}

DEFAULT = "hybrid"
ESTIMATORS = ("nlse", DEFAULT, *METHODS)
HYBRID_METHOD = "pso_de"

EVALUATIONS = 400
"""Evaluations per searched parameter that a global search may take."""

HYBRID_EVALUATIONS = 60
PATIENCE = 40
INTERRUPTED = "interrupted"


@dataclass(frozen=True, slots=True)
class Begin:
    """Where least squares should begin: the model's vector that a global search ended at, with its result."""

    theta: FloatArray
    search: SearchResult


def estimator_named(name: str) -> str:
    """The name itself; UnknownNameError lists those that exist."""
    if name not in ESTIMATORS:
        raise UnknownNameError("estimator", name, ESTIMATORS)
    return name


def search(
    problem: Problem,
    name: str,
    *,
    seed: int = 0,
    budget: Budget | None = None,
    progress: Progress = lambda text: None,
) -> Begin:
    """Search a box around the problem's start with one of METHODS (or ``hybrid``: briefly).

    What the initial states of windows explain is projected out around the measured guess. Interrupting
    (Ctrl+C) ends the search with the best so far.
    """
    try:
        return _search_box(problem, name, seed, budget, progress)
    except (KeyboardInterrupt, EndedEarly):
        z = problem.start().z
        return Begin(problem.theta(z), SearchResult(z, float("inf"), 0, (), INTERRUPTED))


def _search_box(problem: Problem, name: str, seed: int, budget: Budget | None, progress: Progress) -> Begin:
    coordinates = Coordinates.of(problem)
    share = HYBRID_EVALUATIONS if name == DEFAULT else EVALUATIONS
    limit = budget or Budget(share * max(len(coordinates.box), 1), patience=PATIENCE)
    ledger = Ledger(coordinates.cost, coordinates.box, limit, progress)
    method = METHODS[HYBRID_METHOD if name == DEFAULT else name]
    if not len(coordinates.box):
        z = coordinates.z(coordinates.start)
        result = SearchResult(
            coordinates.start, coordinates.cost(coordinates.start), 1, (), "nothing to search"
        )
        return Begin(problem.theta(z), result)
    try:
        rounds = {"iterations": affordable(ledger)} if method is text_swarm else {}
        result = method(ledger, seed, coordinates.start, **rounds)
    except (KeyboardInterrupt, EndedEarly):
        if not ledger.evaluations:
            raise
        ledger.stopped_because = INTERRUPTED
        result = ledger.result()
    return Begin(problem.theta(coordinates.z(result.z)), result)


__all__ = [
    "DEFAULT",
    "ESTIMATORS",
    "METHODS",
    "Begin",
    "Budget",
    "Ledger",
    "SearchResult",
    "estimator_named",
    "search",
]
