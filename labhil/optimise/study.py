"""Run the study of ``labhil optimise solenoid``: Appendix A of the reference text with our own model.

Read :mod:`labhil.optimise.geometry` for the design, ``circuit`` for the forces, ``database`` for the
interpolation, and ``show`` and ``plot`` for the output.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labhil.optimise.circuit import force_curves
from labhil.optimise.database import (
    Database,
    InterpolationError,
    interpolation_error,
    select_distinct,
    to_unit_box,
)
from labhil.optimise.field import load_skfem
from labhil.optimise.field_check import FieldCheck, check_by_field
from labhil.optimise.geometry import LOWER, ORIGINAL, TEXT_OPTIMUM, UPPER
from labhil.optimise.objectives import Objectives, largest_force, mean_slope, pareto_front, rms_slope
from labhil.optimise.runs import Runs, design_runs
from labhil.optimise.sensitivity import (
    GlobalSensitivity,
    LocalSensitivity,
    global_sensitivity,
    local_sensitivity,
)
from labhil.optimise.swarm import SwarmResult, maximise
from labhil.signals import FloatArray

Progress = Callable[[str], None]

WEIGHTS = (1.0, 1.0)
"""k1 and k2 of eq. A.1."""
ORIGINAL_NAME, TEXT_NAME = "original", "text's optimum"
INTERPOLATED_NAME, REFINED_NAME = "ours, 55 runs", "ours, refined"


@dataclass(frozen=True, slots=True)
class StudyOptions:
    """Amount of computation and parameters of the search; tests use smaller numbers.

    Lengths and distances without a unit are shares of the ranges of Table A.2.

    Attributes:
        held_out: Designs on which the interpolation is evaluated.
        swarms: Swarms that maximise CF.
        iterations: Iterations of a swarm.
        best_known: Further designs of the circuit that join the refined database.
        rounds: Rounds of the refinement.
        local_evaluations: Most runs of the circuit in the final simplex search.
        n_directions: Directions of the Pareto front that have a swarm of their own in each round.
        sobol: Samples of the global sensitivities, a power of two; 7 times as many designs are evaluated.
        near_radius: Distance of random designs from the best ones in the first round.
        n_rivals: Number of best designs that have such neighbours.
        min_rival_distance: Distance between two of them, at least.
        simplex_size: Size of the first simplex.
        min_front_distance: Distance in CF1 and CF2 below which designs are one point of the front.
        reference_point: CF1 and CF2 below those of every design on the Pareto front.
    """

    held_out: int = 200
    swarms: int = 5
    iterations: int = 40
    best_known: int = 40
    rounds: int = 12
    local_evaluations: int = 150
    n_directions: int = 9
    sobol: int = 128
    near_radius: float = 0.2
    n_rivals: int = 4
    min_rival_distance: float = 0.3
    simplex_size: float = 0.15
    min_front_distance: float = 0.01
    reference_point: tuple[float, float] = (-0.3, -0.3)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A design with its forces from the circuit."""

    name: str
    design: FloatArray
    """(5,) m and rad."""
    curve: FloatArray
    """(m,) N at :func:`labhil.optimise.circuit.positions`."""
    largest_force: float
    """N."""
    rms_slope: float
    """N/m."""
    mean_slope: float
    """N/m, of the straight line, with its sign."""
    scores: FloatArray
    """(2,): CF1 and CF2 of eq. A.2 and A.3."""

    @property
    def cost(self) -> float:
        """CF of eq. A.1."""
        return float(self.scores @ WEIGHTS)


@dataclass(frozen=True, slots=True)
class Optimisation:
    """Result of the study."""

    seed: int
    runs: Runs
    database: Database
    objectives: Objectives
    interpolation: InterpolationError
    candidates: tuple[Candidate, ...]
    """The original, the text's optimum, ours by interpolation of the 55 runs, ours after more runs."""
    predicted_cost: float
    """CF of the database's optimum by interpolation; the candidate has that by the circuit."""
    n_agreeing: int
    """How many of ``swarms`` swarms on the database ended within 1 % of the best one's CF."""
    swarms: int
    evaluated: FloatArray
    """(n, 5): every design that the circuit was run on."""
    scores: FloatArray
    """(n, 2): their CF1 and CF2."""
    front: NDArray[np.intp]
    """(p,) rows of ``evaluated`` that no other dominates, by falling force."""
    local: dict[str, LocalSensitivity]
    """At the original and at our optimum."""
    overall: GlobalSensitivity
    field: FieldCheck | None
    seconds: float

    def candidate(self, name: str) -> Candidate:
        """The candidate of this name."""
        return next(candidate for candidate in self.candidates if candidate.name == name)

    def flattest_with_force_of(self, candidate: Candidate) -> int:
        """Return the row of ``evaluated`` with the least slope among those with the candidate's force."""
        strong = self.scores[:, 0] >= candidate.scores[0] - 1e-9
        return int(np.argmax(np.where(strong, self.scores[:, 1], -np.inf)))

    def slope_of(self, row: int) -> float:
        """Root-mean-square slope in N/m of a row of ``evaluated``."""
        low, high = self.objectives.inverse_slope_range
        return float(1.0 / (low + self.scores[row, 1] * (high - low)))

    def to_json(self) -> dict[str, Any]:
        """The result as plain data, SI units, NaN as None (schema ``labhil.optimise/1``)."""
        from labhil.optimise.result import optimisation_json

        return optimisation_json(self)


class CircuitLog:
    """The magnetic circuit, with a log of all designs and their forces."""

    def __init__(self) -> None:
        self._designs: list[FloatArray] = []
        self._curves: list[FloatArray] = []

    def curves(self, designs: FloatArray) -> FloatArray:
        """Force curves (n, m) in N of designs (n, 5) in m and rad."""
        curves = force_curves(designs)
        self._designs.append(np.array(designs))
        self._curves.append(curves)
        return curves

    def designs(self) -> FloatArray:
        """(n, 5): all designs so far."""
        return np.concatenate(self._designs)

    def all_curves(self) -> FloatArray:
        """(n, m) N: their force curves."""
        return np.concatenate(self._curves)


def run(
    seed: int = 0,
    progress: Progress = lambda text: None,
    *,
    field: bool = False,
    options: StudyOptions | None = None,
) -> Optimisation:
    """Run the whole study.

    Args:
        seed: Seed of all random numbers; the result is reproducible except for ``seconds``.
        progress: Called with a line of text before each stage.
        field: Whether the field solver checks the forces.
        options: Amount of computation.

    Returns:
        The result.

    Raises:
        MissingExtraError: ``field`` is True and scikit-fem is not installed.
    """
    start_time = time.perf_counter()
    options, rng, circuit = options or StudyOptions(), np.random.default_rng(seed), CircuitLog()
    if field:
        load_skfem()
    progress("magnetic circuit: the 55 runs of the database")
    runs = design_runs()
    database = Database(runs.designs, circuit.curves(runs.designs))
    objectives = Objectives.of(database.curves)
    held_out = LOWER + rng.random((options.held_out, len(LOWER))) * (UPPER - LOWER)
    interpolation = interpolation_error(database, held_out, circuit.curves(held_out))
    progress("particle swarms on the interpolated database")
    results = [_run_swarm(database, objectives, _cost, options, rng) for _ in range(options.swarms)]
    best = max(results, key=lambda result: result.value)
    progress("sensitivities over the whole box")
    overall = global_sensitivity(circuit.curves, options.sobol, rng)
    progress("more runs of the circuit where the swarms end")
    designs = {ORIGINAL_NAME: ORIGINAL, TEXT_NAME: TEXT_OPTIMUM, INTERPOLATED_NAME: best.best}
    designs[REFINED_NAME] = _refine(database, circuit, objectives, options, rng)
    local = {name: local_sensitivity(designs[name]) for name in (ORIGINAL_NAME, REFINED_NAME)}
    field_check = check_by_field(designs, progress) if field else None
    scores = objectives(circuit.all_curves())
    return Optimisation(
        seed=seed,
        runs=runs,
        database=database,
        objectives=objectives,
        interpolation=interpolation,
        candidates=tuple(_candidate(name, design, objectives) for name, design in designs.items()),
        predicted_cost=best.value,
        n_agreeing=sum(result.value > best.value - 0.01 * abs(best.value) for result in results),
        swarms=len(results),
        evaluated=circuit.designs(),
        scores=scores,
        front=pareto_front(scores, options.min_front_distance),
        local=local,
        overall=overall,
        field=field_check,
        seconds=time.perf_counter() - start_time,
    )


def _cost(scores: FloatArray) -> FloatArray:
    """(n,) CF of eq. A.1, of scores (n, 2)."""
    return np.asarray(scores @ WEIGHTS)


def _front_criterion(angle: float, reference: tuple[float, float]) -> Callable[[FloatArray], FloatArray]:
    """Make a criterion whose maximum is on the Pareto front in this direction from the reference point.

    It is the smaller of two ratios: a weighted sum has no maximum on the concave parts of a front.
    """
    direction = np.maximum([np.cos(angle), np.sin(angle)], 0.02)
    return lambda scores: np.asarray(np.min((scores - reference) / direction, axis=1))


def _run_swarm(
    database: Database,
    objectives: Objectives,
    criterion: Callable[[FloatArray], FloatArray],
    options: StudyOptions,
    rng: np.random.Generator,
) -> SwarmResult:
    """Maximise a criterion of CF1 and CF2 (n, 2) on the interpolated database by a swarm."""
    return maximise(
        lambda X: criterion(objectives(database.interpolate(X))),
        LOWER,
        UPPER,
        int(rng.integers(2**31)),
        options.iterations,
    )


def _refine(
    database: Database,
    circuit: CircuitLog,
    objectives: Objectives,
    options: StudyOptions,
    rng: np.random.Generator,
) -> FloatArray:
    """Search the best design (5,) with runs of the circuit wherever swarms on the database end.

    The database starts with the 55 runs and the best other designs of the circuit. In each round swarms
    maximise CF and criteria along the Pareto front. Their optima and random designs near the best ones,
    nearer with every round, are run and enter the database, which corrects the errors of the interpolation
    there. A simplex search on the circuit ends the search.
    """
    best_known = circuit.designs()[
        np.argsort(-(_cost(objectives(circuit.all_curves()))))[: options.best_known]
    ]
    best_known = select_distinct(best_known, database.designs)
    database = database.extend(best_known, circuit.curves(best_known))
    angles = np.linspace(0.0, np.pi / 2, options.n_directions)
    criteria = [_cost] * options.swarms + [
        _front_criterion(float(angle), options.reference_point) for angle in angles
    ]
    for rounds_left in range(options.rounds, 0, -1):
        swarm_optima = [
            _run_swarm(database, objectives, criterion, options, rng).best for criterion in criteria
        ]
        nearby = _sample_near_best(database, objectives, rounds_left, options, rng)
        new = select_distinct(np.vstack([swarm_optima, nearby]), database.designs)
        if len(new):
            database = database.extend(new, circuit.curves(new))
    best = database.designs[np.argmax(_cost(objectives(database.curves)))]
    return _refine_locally(best, circuit, objectives, options)


def _refine_locally(
    best: FloatArray, circuit: CircuitLog, objectives: Objectives, options: StudyOptions
) -> FloatArray:
    """Find the local optimum (5,) from ``best`` by a simplex search on the circuit."""
    from scipy.optimize import minimize

    def cost(shares: FloatArray) -> float:
        return -float(_cost(objectives(circuit.curves(LOWER + shares[None, :] * (UPPER - LOWER))))[0])

    start, size = to_unit_box(best), options.simplex_size
    corners = np.vstack([start, start + np.where(start > 0.5, -size, size) * np.eye(len(start))])
    settings = {"initial_simplex": corners, "maxfev": options.local_evaluations, "xatol": 1e-3, "fatol": 1e-4}
    optimum = minimize(cost, start, method="Nelder-Mead", bounds=[(0.0, 1.0)] * len(start), options=settings)
    return np.asarray(LOWER + optimum.x * (UPPER - LOWER))


def _sample_near_best(
    database: Database,
    objectives: Objectives,
    rounds_left: int,
    options: StudyOptions,
    rng: np.random.Generator,
) -> FloatArray:
    """Draw designs (n, 5) near the best ones, nearer with every round.

    Half of them are near the best design, the others near rivals that are far from it and from each other.
    """
    order = np.argsort(-_cost(objectives(database.curves)))
    best = database.designs[order]
    rivals = select_distinct(best, np.empty((0, len(LOWER))), options.min_rival_distance)[: options.n_rivals]
    rivals = np.vstack([rivals, np.tile(rivals[0], (len(rivals), 1))])
    radius = options.near_radius * rounds_left / options.rounds
    steps = radius * rng.uniform(-1.0, 1.0, rivals.shape) * (UPPER - LOWER)
    return np.asarray(np.clip(rivals + steps, LOWER, UPPER))


def _candidate(name: str, design: FloatArray, objectives: Objectives) -> Candidate:
    curves = force_curves(design)
    return Candidate(
        name,
        design,
        curves[0],
        float(largest_force(curves)[0]),
        float(rms_slope(curves)[0]),
        float(mean_slope(curves)[0]),
        objectives(curves)[0],
    )
