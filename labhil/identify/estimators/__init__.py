"""Estimators by name: global searches for the point at which nonlinear least squares start.

``nlse`` starts at the model's start values; the others search a box around them globally and pass on their
best point, so that every fit ends with least squares and has errors and tests of the same kind. ``hybrid``,
the default, does both and keeps the better fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from labhil.ending import EndedEarly
from labhil.errors import UnknownNameError
from labhil.identify.estimators.coordinates import Coordinates
from labhil.identify.estimators.library import cma_es, differential_evolution, simulated_annealing
from labhil.identify.estimators.sampling import mcmc
from labhil.identify.estimators.search import Budget, CostEvaluator, Progress, SearchResult
from labhil.identify.estimators.swarm import (
    adaptive_swarm,
    affordable_iterations,
    reference_swarm,
    swarm_with_evolution,
)
from labhil.identify.problem import Problem
from labhil.signals import FloatArray

Method = Callable[..., SearchResult]

METHODS: Mapping[str, Method] = {
    "pso": reference_swarm,
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
INTERRUPTED = "interrupted"


@dataclass(frozen=True, slots=True)
class StartingPoint:
    """Where least squares should start.

    Attributes:
        theta: The model's parameter vector that a global search ended at.
        search: Result of the search.
    """

    theta: FloatArray
    search: SearchResult


def check_estimator(name: str) -> str:
    """Return the name of an estimator unchanged.

    Raises:
        UnknownNameError: There is no such estimator; the message lists those that exist.
    """
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
) -> StartingPoint:
    """Search a box around the problem's start values globally.

    The initial states of windows are projected out around their measured guess. Interrupting (Ctrl+C) ends
    the search with the best point so far.

    Args:
        problem: What is estimated.
        name: One of METHODS, or ``hybrid`` for a short search.
        seed: Of the random draws.
        budget: When to stop; by default :func:`default_budget`.
        progress: Called with a line of text after each round.
    """
    try:
        return _search_box(problem, name, seed, budget, progress)
    except (KeyboardInterrupt, EndedEarly):
        z = problem.start().z
        return StartingPoint(problem.theta(z), SearchResult(z, float("inf"), 0, (), INTERRUPTED))


def default_budget(
    name: str,
    n_parameters: int,
    *,
    evaluations_per_parameter: int = 400,
    hybrid_evaluations_per_parameter: int = 60,
    patience: int = 40,
) -> Budget:
    """The budget of a global search unless another one is given.

    Args:
        name: Of the estimator.
        n_parameters: Number of parameters that are searched.
        evaluations_per_parameter: Cost evaluations per parameter.
        hybrid_evaluations_per_parameter: The same of ``hybrid``.
        patience: Rounds without a gain after which the search stops.
    """
    per_parameter = hybrid_evaluations_per_parameter if name == DEFAULT else evaluations_per_parameter
    return Budget(per_parameter * max(n_parameters, 1), patience=patience)


def _search_box(
    problem: Problem, name: str, seed: int, budget: Budget | None, progress: Progress
) -> StartingPoint:
    """Search the box; an interruption before the first evaluation is raised."""
    coordinates = Coordinates.of(problem)
    limit = budget or default_budget(name, len(coordinates.box))
    evaluator = CostEvaluator(coordinates.cost, coordinates.box, limit, progress)
    method = METHODS[HYBRID_METHOD if name == DEFAULT else name]
    if not len(coordinates.box):
        z = coordinates.z(coordinates.start)
        result = SearchResult(
            coordinates.start, coordinates.cost(coordinates.start), 1, (), "nothing to search"
        )
        return StartingPoint(problem.theta(z), result)
    try:
        rounds = {"iterations": affordable_iterations(evaluator)} if method is reference_swarm else {}
        result = method(evaluator, seed, coordinates.start, **rounds)
    except (KeyboardInterrupt, EndedEarly):
        if not evaluator.evaluations:
            raise
        evaluator.stopped_because = INTERRUPTED
        result = evaluator.result()
    return StartingPoint(problem.theta(coordinates.z(result.z)), result)


__all__ = [
    "DEFAULT",
    "ESTIMATORS",
    "METHODS",
    "Budget",
    "CostEvaluator",
    "SearchResult",
    "StartingPoint",
    "check_estimator",
    "default_budget",
    "search",
]
