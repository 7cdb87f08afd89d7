"""``labhil optimise solenoid``: Appendix A of the reference text from beginning to end, in our own model."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labhil.optimise.circuit import force_curves
from labhil.optimise.database import Database, InterpolationError, apart, as_shares, interpolation_error
from labhil.optimise.field import skfem
from labhil.optimise.field_check import FieldCheck, check_by_field
from labhil.optimise.geometry import LOWER, ORIGINAL, TEXT_OPTIMUM, UPPER
from labhil.optimise.objectives import Objectives, largest_force, mean_slope, not_dominated, rms_slope
from labhil.optimise.runs import Runs, design_runs
from labhil.optimise.sensitivity import (
    GlobalSensitivity,
    LocalSensitivity,
    global_sensitivity,
    local_sensitivity,
)
from labhil.optimise.swarm import Flight, maximise
from labhil.signals import FloatArray

Progress = Callable[[str], None]

WEIGHTS = (1.0, 1.0)
"""k1 and k2 of eq. A.1."""
CORNER = (-0.3, -0.3)
"""Of CF1 and CF2: worse than any design on the Pareto front in both."""
NEAR, RIVALS = 0.2, 4
"""How near to the best known designs (of the ranges) others are tried in the first round, and of how many."""
RIVALS_APART = 0.3
"""Of the ranges: best known designs that are this far apart count as rivals."""
SIMPLEX = 0.15
"""Of the ranges: how large the last step's simplex is at first."""
APART_ON_FRONT = 0.01
"""In CF1 and CF2 together: designs nearer than this are one point of the front."""

ORIGINAL_NAME, TEXT_NAME = "original", "text's optimum"
INTERPOLATED_NAME, REFINED_NAME = "ours, 55 runs", "ours, refined"


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is computed; smaller numbers for tests."""

    held_out: int = 200
    """Designs that the interpolation is judged on."""
    swarms: int = 5
    iterations: int = 40
    best_known: int = 40
    """Of the designs run for other ends, how many join the database that is refined."""
    rounds: int = 12
    """Of runs added where the swarms end."""
    settling: int = 150
    """Runs of the circuit at most for the last step, from the best of those to the top of the hill."""
    angles: int = 9
    """Directions of the Pareto front that swarms fly for in each round."""
    sobol: int = 128
    """Power of two; 7 times as many designs."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One design with its figures by the circuit."""

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
    """Everything that the study found."""

    seed: int
    runs: Runs
    database: Database
    objectives: Objectives
    interpolation: InterpolationError
    candidates: tuple[Candidate, ...]
    """The original, the text's optimum, ours by interpolation of the 55 runs, ours after more runs."""
    promised: float
    """CF that the interpolated database gives to its own optimum; the candidate's own is the circuit's."""
    agreeing: int
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

    def no_weaker(self, candidate: Candidate) -> int:
        """The row of ``evaluated`` with the smallest slope of all with at least the candidate's force."""
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


class Bench:
    """The circuit, with a log of every design that it was run on."""

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
    effort: Effort | None = None,
) -> Optimisation:
    """Run the whole study; MissingExtraError when ``field`` is True and scikit-fem is not installed.

    The same seed gives the same result, but for ``seconds``.
    """
    begin = time.perf_counter()
    effort, rng, bench = effort or Effort(), np.random.default_rng(seed), Bench()
    if field:
        skfem()
    progress("magnetic circuit: the 55 runs of the database")
    runs = design_runs()
    database = Database(runs.designs, bench.curves(runs.designs))
    objectives = Objectives.of(database.curves)
    unseen = LOWER + rng.random((effort.held_out, len(LOWER))) * (UPPER - LOWER)
    interpolation = interpolation_error(database, unseen, bench.curves(unseen))
    progress("particle swarms on the interpolated database")
    flights = [_fly(database, objectives, _sum, effort, rng) for _ in range(effort.swarms)]
    best = max(flights, key=lambda flight: flight.value)
    progress("sensitivities over the whole box")
    overall = global_sensitivity(bench.curves, effort.sobol, rng)
    progress("more runs of the circuit where the swarms end")
    designs = {ORIGINAL_NAME: ORIGINAL, TEXT_NAME: TEXT_OPTIMUM, INTERPOLATED_NAME: best.best}
    designs[REFINED_NAME] = _refine(database, bench, objectives, effort, rng)
    local = {name: local_sensitivity(designs[name]) for name in (ORIGINAL_NAME, REFINED_NAME)}
    field_check = check_by_field(designs, progress) if field else None
    scores = objectives(bench.all_curves())
    return Optimisation(
        seed=seed,
        runs=runs,
        database=database,
        objectives=objectives,
        interpolation=interpolation,
        candidates=tuple(_candidate(name, design, objectives) for name, design in designs.items()),
        promised=best.value,
        agreeing=sum(flight.value > best.value - 0.01 * abs(best.value) for flight in flights),
        swarms=len(flights),
        evaluated=bench.designs(),
        scores=scores,
        front=not_dominated(scores, APART_ON_FRONT),
        local=local,
        overall=overall,
        field=field_check,
        seconds=time.perf_counter() - begin,
    )


def _sum(scores: FloatArray) -> FloatArray:
    """(n,) CF of eq. A.1, of scores (n, 2)."""
    return np.asarray(scores @ WEIGHTS)


def _towards(angle: float) -> Callable[[FloatArray], FloatArray]:
    """A wish whose best design lies on the Pareto front in this direction from ``CORNER``.

    A weighted sum never leads to the hollow parts of a front; the smaller of two ratios does.
    """
    direction = np.maximum([np.cos(angle), np.sin(angle)], 0.02)
    return lambda scores: np.asarray(np.min((scores - CORNER) / direction, axis=1))


def _fly(
    database: Database,
    objectives: Objectives,
    wish: Callable[[FloatArray], FloatArray],
    effort: Effort,
    rng: np.random.Generator,
) -> Flight:
    """One swarm on the interpolated database; ``wish`` turns CF1 and CF2 (n, 2) into what is maximised."""
    return maximise(
        lambda X: wish(objectives(database.interpolate(X))),
        LOWER,
        UPPER,
        int(rng.integers(2**31)),
        effort.iterations,
    )


def _refine(
    database: Database, bench: Bench, objectives: Objectives, effort: Effort, rng: np.random.Generator
) -> FloatArray:
    """The best design (5,) after the circuit has been run, round by round, wherever swarms ended.

    It begins with the 55 runs and the best of all other designs that the circuit has been run on. Each
    round's swarms fly for CF and in directions all along the Pareto front, and their ends enter the
    database that the next round interpolates: a promise that the circuit does not keep is not made twice.
    Designs close to the best ones, closer with every round, join them; a simplex settles the rest.
    """
    known = bench.designs()[np.argsort(-(_sum(objectives(bench.all_curves()))))[: effort.best_known]]
    known = apart(known, database.designs)
    database = database.extend(known, bench.curves(known))
    angles = np.linspace(0.0, np.pi / 2, effort.angles)
    wishes = [_sum] * effort.swarms + [_towards(float(angle)) for angle in angles]
    for rounds_left in range(effort.rounds, 0, -1):
        ends = [_fly(database, objectives, wish, effort, rng).best for wish in wishes]
        near = _nearby(database, objectives, NEAR * rounds_left / effort.rounds, rng)
        new = apart(np.vstack([ends, near]), database.designs)
        if len(new):
            database = database.extend(new, bench.curves(new))
    best = database.designs[np.argmax(_sum(objectives(database.curves)))]
    return _settle(best, bench, objectives, effort)


def _settle(best: FloatArray, bench: Bench, objectives: Objectives, effort: Effort) -> FloatArray:
    """The design (5,) at the top of the hill that ``best`` stands on, by simplex on the circuit itself."""
    from scipy.optimize import minimize

    def cost(shares: FloatArray) -> float:
        return -float(_sum(objectives(bench.curves(LOWER + shares[None, :] * (UPPER - LOWER))))[0])

    start = as_shares(best)
    corners = np.vstack([start, start + np.where(start > 0.5, -SIMPLEX, SIMPLEX) * np.eye(len(start))])
    options = {"initial_simplex": corners, "maxfev": effort.settling, "xatol": 1e-3, "fatol": 1e-4}
    optimum = minimize(cost, start, method="Nelder-Mead", bounds=[(0.0, 1.0)] * len(start), options=options)
    return np.asarray(LOWER + optimum.x * (UPPER - LOWER))


def _nearby(database: Database, objectives: Objectives, reach: float, rng: np.random.Generator) -> FloatArray:
    """Designs (n, 5) at random within ``reach`` (of the ranges) of the best ones.

    Half of them are near the best of all; of the others the first is near that too, the next near the best
    that is far from it, and so on, so that rival optima are followed up.
    """
    order = np.argsort(-_sum(objectives(database.curves)))
    far = apart(database.designs[order], np.empty((0, len(LOWER))), RIVALS_APART)[:RIVALS]
    far = np.vstack([far, np.tile(far[0], (len(far), 1))])
    moves = reach * rng.uniform(-1.0, 1.0, far.shape) * (UPPER - LOWER)
    return np.asarray(np.clip(far + moves, LOWER, UPPER))


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
