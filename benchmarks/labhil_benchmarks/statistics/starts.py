"""One recording fitted from random starts: how often does the default estimator reach the optimum?"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from labhil.campaign.proportion import Proportion
from labhil.identify.estimators.coordinates import Coordinates
from labhil.identify.fit import Options, fit
from labhil.identify.fitted import free_parameter_indices, start_theta
from labhil.identify.least_squares import least_squares
from labhil.identify.problem import Problem
from labhil.identify.windows import fit_windows
from labhil.physics.model import Model
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.rig import parse_rig
from labhil.signals import FloatArray
from labhil_benchmarks.statistics.trial import Case, truth_of

SEED = 0
"""The recording; white noise."""

SAME = 10.0
"""Squares of noise by which a cost may exceed the lowest that is known, and count as the same minimum."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """Where a fit from start ``number`` ended (0: from the truth).

    ``begun`` is the start's cost and ``cost`` the fit's, both the sum of squares on windows as long as the
    model's, in squares of noise.
    """

    case: str
    number: int
    begun: float
    cost: float
    seconds: float


@dataclass(frozen=True, slots=True)
class Arrivals:
    """All fits of one recording."""

    case: str
    arrivals: tuple[Arrival, ...]

    @property
    def lowest(self) -> float:
        """The lowest cost that any fit reached, that from the truth included."""
        return min(each.cost for each in self.arrivals)

    @property
    def reached(self) -> Proportion:
        """How many of the random starts ended there."""
        costs = [each.cost for each in self.arrivals if each.number]
        return Proportion(sum(cost <= self.lowest + SAME for cost in costs), len(costs))

    def to_json(self) -> dict[str, Any]:
        """As plain JSON data."""
        return {**asdict(self), "lowest": self.lowest, "reached": self.reached.to_json()}


def arrive(case: Case, number: int) -> Arrival:
    """Fit the case's recording from one start; everything follows from ``number``."""
    simulated = case.simulate(SEED, False)
    model = model_for(parse_rig(case.rig, Path(f"{case.name}.toml")), simulated.record)
    record = model.prepare(simulated.record)
    problem = Problem(
        model, record, fit_windows(record, model.horizon), free_parameter_indices(model, case.terms),
        start_theta(model), simulated.noise,
    )  # fmt: skip
    begin = _draw(problem, number) if number else truth_of(model, case)
    began = time.perf_counter()
    result = fit(model, record, case.terms, start=_by_key(model, begin), options=Options(seed=number))
    seconds = time.perf_counter() - began
    costs = [_cost(problem, record, theta) for theta in (begin, result.theta)]
    return Arrival(case.name, number, costs[0], costs[1], seconds)


def _draw(problem: Problem, number: int) -> FloatArray:
    """A vector drawn uniformly from the bounds, sizes that cannot be zero by their logarithm.

    Where a bound is infinite, or so far away that it says nothing, the box of a global search ends the range.
    """
    random = np.random.default_rng([SEED, number])
    coordinates = Coordinates.of(problem, project=False)
    return problem.theta(coordinates.z(coordinates.box.draw(random, 1)[0]))


def _by_key(model: Model, theta: FloatArray) -> dict[str, float]:
    return {p.key: float(value) for p, value in zip(model.parameters, theta, strict=True)}


def _cost(problem: Problem, record: Record, theta: FloatArray) -> float:
    """The sum of squares at ``theta``, states of all windows fitted."""
    held = Problem(
        problem.model, record, problem.windows, np.empty(0, dtype=np.int64), theta, problem.sigma
    )  # fmt: skip
    return least_squares(held, held.start()).cost


def show(arrivals: Arrivals) -> RenderableType:
    """A few lines."""
    random = [arrival for arrival in arrivals.arrivals if arrival.number]
    begun = np.array([arrival.begun for arrival in random])
    lines = [
        f"{arrivals.case}: at the lowest known cost ({arrivals.lowest:.1f}) from {arrivals.reached}",
        f"  random starts cost {begun.min():.3g} to {begun.max():.3g} (median {np.median(begun):.3g})",
        f"  a fit takes {np.median([arrival.seconds for arrival in random]):.1f} s (median)",
    ]
    worse = sorted(
        arrival.cost - arrivals.lowest for arrival in random if arrival.cost > arrivals.lowest + SAME
    )
    if worse:
        lines.append("  the others end above it by " + ", ".join(f"{cost:.3g}" for cost in worse))
    return Group(*(Text(line) for line in lines), Text(""))
