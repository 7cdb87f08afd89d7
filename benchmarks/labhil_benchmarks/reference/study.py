"""What a case of the text's chapter 5 is made of: its tables, a plant with its parameters, our model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labhil.identify.fitted import free_parameter_indices, start_theta
from labhil.identify.linear import Figures, figures_of
from labhil.identify.problem import Problem
from labhil.physics.model import Metric, Model
from labhil.physics.record import Record, Windows
from labhil.physics.rigs import model_for
from labhil.physics.terms import keyed
from labhil.rig import parse_rig
from labhil.signals import FloatArray
from labhil_benchmarks.reference.known_start import KnownStart
from labhil_benchmarks.reference.levels import Levels
from labhil_benchmarks.reference.published import ParameterTable, QualityTable

BOX = 5.0
"""The swarm searches from zero to so many times the true value (a Stribeck level also as far below zero)."""

SMALLEST = 1e-3
"""From where it searches sizes that cannot be zero, in true values."""

ROUGH = 3.0
"""A rough start has every parameter off by a factor between one over this and this."""


@dataclass(frozen=True, slots=True)
class Data:
    """A recording to fit and one to test, the noise (channels,) on both, and the state both begin in."""

    record: Record
    test: Record
    sigma: FloatArray
    start: FloatArray


@dataclass(frozen=True, slots=True)
class Swarm:
    """The text's swarm: ``particles``, ``iterations``, and where these numbers stand."""

    particles: int
    iterations: int
    source: str


@dataclass(frozen=True, slots=True)
class Combination:
    """A function ``of`` the rows' values by label that the data know where they do not know each value."""

    label: str
    unit: str
    of: Callable[[Mapping[str, float]], float]


@dataclass(frozen=True, slots=True)
class Study:
    """One case.

    ``truth`` are the plant's values (rows,) in the order of the table; ``sizes`` (rows,) stand in for true
    values of zero where a box or a rough start is made. ``setup`` says how the data come about and
    what of that the text leaves open. ``linear`` is the table of linear models, where the case has one.
    A recording may leave the scale of some rows open, whatever its length: then bounds are taken with the
    row ``held`` in place, the rows ``invariant`` have one, the others none, and ``combinations`` say what
    is known of those. ``torque_constant`` (channels,) N·m/A turns currents into
    the torques that the text's table of errors is about.
    """

    name: str
    variant: str
    parameters: ParameterTable
    quality: QualityTable
    rig: str
    terms: tuple[str, ...]
    truth: tuple[float, ...]
    sizes: tuple[float, ...]
    swarm: Swarm
    setup: str
    simulate: Callable[[int], Data]
    linear: QualityTable | None = None
    held: str = ""
    invariant: tuple[str, ...] = ()
    combinations: tuple[Combination, ...] = ()
    torque_constant: tuple[float, ...] = ()

    @property
    def levels(self) -> Levels:
        """Between the table's rows and our parameters."""
        return Levels(self.parameters.rows)

    @property
    def labels(self) -> tuple[str, ...]:
        """Symbols of the rows, with the joint in brackets where there are several."""
        return tuple(keyed(row.symbol, row.joint) for row in self.parameters.rows)

    def combined(self, values: Sequence[float]) -> tuple[float, ...]:
        """Values of the combinations from the rows' (rows,)."""
        by_label = dict(zip(self.labels, values, strict=True))
        return tuple(combination.of(by_label) for combination in self.combinations)

    @property
    def numbers(self) -> tuple[str, ...]:
        """Numbers of the text's tables that this case fills."""
        linear = (self.linear.number,) if self.linear is not None else ()
        return (*linear, self.parameters.number, self.quality.number)

    @property
    def typical(self) -> FloatArray:
        """True values (rows,), stand-ins where they are zero."""
        truth = np.array(self.truth)
        return np.where(truth == 0.0, np.array(self.sizes), truth)

    def model(self, record: Record) -> Model:
        """The white-box model of this case's rig."""
        return model_for(parse_rig(self.rig, Path(f"{self.name}.toml")), record)

    def box(self) -> dict[str, tuple[float, float]]:
        """Bounds of the swarm by key of our parameters."""
        typical = self.levels.to_ours(self.typical)
        return {key: _bounds(key, abs(size)) for key, size in typical.items()}

    def rough(self, random: np.random.Generator) -> dict[str, float]:
        """Our values by key where every parameter of the text is off by a factor of its own."""
        factors = ROUGH ** random.uniform(-1.0, 1.0, len(self.truth))
        return self.levels.to_ours(self.typical * factors)


def _bounds(key: str, size: float) -> tuple[float, float]:
    """Bounds of a parameter of this typical size; what a model divides by stays above zero."""
    if key.startswith("stribeck_friction.level"):
        return -BOX * size, BOX * size
    divides = "." not in key or key.startswith("stribeck_friction.velocity")
    return SMALLEST * size if divides else 0.0, BOX * size


@dataclass(frozen=True, slots=True)
class Bench:
    """A study's data, ready for its model: prepared records, noise (channels,), known state at the start."""

    study: Study
    model: Model
    record: Record
    test: Record
    sigma: FloatArray
    start: FloatArray

    @classmethod
    def of(cls, study: Study, seed: int) -> Bench:
        """Simulate the plant and prepare what it gave.

        Where recordings are filtered before they are fitted, the noise is what is left at the truth.
        """
        data = study.simulate(seed)
        model = study.model(data.record)
        record, test = model.prepare(data.record), model.prepare(data.test)
        bench = cls(study, model, record, test, data.sigma, data.start)
        if model.metric is Metric.WINDOWED_SIMULATION:
            return bench
        problem = bench.whole_run(record)
        left = problem.residuals(problem.start()).reshape(-1, len(data.sigma)) * data.sigma
        return replace(bench, sigma=np.sqrt(np.mean(left**2, axis=0)))

    def whole_run(self, record: Record, *, boxed: bool = False, joint: int | None = None) -> Problem:
        """One run over ``record`` from the known state, at the truth; free are the text's parameters.

        ``boxed``: within the swarm's bounds; ``joint``: those of one joint only.
        """
        known = KnownStart(self.model, self.start, self.study.box() if boxed else None)
        theta = start_theta(known, self.study.levels.to_ours(self.study.truth))
        windows = Windows.of([(0, len(record))])
        free = free_parameter_indices(known, self.study.terms)
        if joint is not None:
            free = np.array([i for i in free if known.parameters[i].joint == joint], dtype=np.int64)
        return Problem(known, record, windows, free, theta, self.sigma)

    def theta(self, ours: Mapping[str, float]) -> FloatArray:
        """The model's vector with these values by key, every other term neutral."""
        return start_theta(self.model, ours)

    def judged(self, theta: FloatArray) -> list[Figures]:
        """Errors on the test recording of each channel, by the text's measure: one run from the known state.

        Torques for the arm, the output's own unit for all others.
        """
        known = KnownStart(self.model, self.start)
        windows = Windows.of([(0, len(self.test))])
        simulated = known.simulate(theta, self.test, windows, np.empty((1, 0)))
        scale = self.study.torque_constant or (1.0,) * simulated.shape[1]
        return [
            figures_of(k * measured, k * column)
            for k, measured, column in zip(scale, self.test.outputs.T, simulated.T, strict=True)
        ]
