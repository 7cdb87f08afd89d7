"""One simulated recording of a case, fitted as a user would, and its numbers beside the truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from labhil.identify.fit import Fit, Options, fit
from labhil.identify.fitted import free_parameter_indices, start_theta
from labhil.identify.intervals import cramer_rao_bounds
from labhil.identify.problem import Point, Problem
from labhil.identify.score import score
from labhil.identify.window_states import fit_states
from labhil.identify.windows import fit_windows
from labhil.physics.model import Model, index_of
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.rig import parse_rig
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class Simulated:
    """Two recordings of one plant, to fit and to test, and the noise (channels,) that was added to both."""

    record: Record
    test: Record
    noise: FloatArray


@dataclass(frozen=True, slots=True)
class Case:
    """What is simulated and fitted.

    ``terms`` are in the plant and in the model, ``absent`` in the model only, one at a time by turns;
    ``truth`` maps parameter keys of the model to the plant's values. ``simulate`` takes a seed and
    whether the noise is coloured. ``unknown`` are parameters that no such recording can know.
    """

    name: str
    rig: str
    terms: tuple[str, ...]
    absent: tuple[str, ...]
    truth: Mapping[str, float]
    simulate: Callable[[int, bool], Simulated]
    unknown: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Row:
    """One parameter of one trial; ``bound`` is the Cramér-Rao bound at the truth under white noise."""

    key: str
    truth: float
    value: float
    std_error: float
    low: float
    high: float
    bound: float
    significant: bool
    identifiable: bool


@dataclass(frozen=True, slots=True)
class Trial:
    """What one recording gave; ``r2`` of the fit on the test recording and ``r2_truth`` of the truth."""

    case: str
    seed: int
    coloured: bool
    absent: str
    rows: tuple[Row, ...]
    r2: float
    r2_truth: float
    residual: float
    seconds: float


def run_trial(case: Case, seed: int, coloured: bool) -> Trial:
    """Simulate, fit and compare; everything follows from the seed."""
    rig = parse_rig(case.rig, Path(f"{case.name}.toml"))
    simulated = case.simulate(seed, coloured)
    model = model_for(rig, simulated.record)
    record, test = model.prepare(simulated.record), model.prepare(simulated.test)
    absent = case.absent[seed % len(case.absent)] if case.absent else ""
    terms = (*case.terms, absent) if absent else case.terms
    began = time.perf_counter()
    result = fit(model, record, terms, test=test, options=Options())
    seconds = time.perf_counter() - began
    theta = truth_of(model, case)
    bounds = _bounds(model, record, terms, theta, result.window, simulated.noise)
    at_truth = score(model, theta, test, result.sigma, result.test.horizon if result.test else None)
    return Trial(
        case.name, seed, coloured, absent, _rows(result, case, bounds),
        result.test.r2 if result.test else float("nan"), at_truth.r2, result.by_window[-1].residual, seconds,
    )  # fmt: skip


def truth_of(model: Model, case: Case) -> FloatArray:
    """The model's vector with the plant's values."""
    theta = start_theta(model)
    places = index_of(model.parameters)
    for key, value in case.truth.items():
        if key in places:
            theta[places[key]] = value
    return theta


def _bounds(
    model: Model, record: Record, terms: tuple[str, ...], theta: FloatArray, window: float, noise: FloatArray
) -> Mapping[str, float]:
    problem = Problem(
        model, record, fit_windows(record, window), free_parameter_indices(model, terms), theta, noise
    )
    z = theta[problem.free] / problem.scale
    states = problem.guess
    if states.shape[1]:
        states = fit_states(problem, z, states)
    bounds = cramer_rao_bounds(problem, Point(z, states))
    keys = [model.parameters[i].key for i in problem.free]
    return dict(zip(keys, bounds.tolist(), strict=True))


def _rows(result: Fit, case: Case, bounds: Mapping[str, float]) -> tuple[Row, ...]:
    rows = []
    for row in result.estimates:
        key = row.name if row.joint is None else f"{row.name}[{row.joint}]"
        truth = case.truth.get(key, 0.0)
        rows.append(
            Row(
                key, truth, row.value, row.std_error, row.ci99[0], row.ci99[1], bounds[key],
                row.significant, row.identifiable,
            )
        )  # fmt: skip
    return tuple(rows)
