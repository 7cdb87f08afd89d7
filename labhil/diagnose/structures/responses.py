"""Responses: the change of a fit's residuals by each term, taken once where the fit stands.

The fit's own added terms are among them, by their local slopes, and their part is taken out of the target: so
every structure, with or without them, is compared along one trajectory that follows the data.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from labhil.cores import side_by_side
from labhil.diagnose.judge import Data
from labhil.diagnose.structures.disturbance import Disturbance, inner_products
from labhil.diagnose.structures.marginal import Grams
from labhil.identify.extended import ExtendedModel
from labhil.identify.fitted import Fitted
from labhil.identify.least_squares import Solution
from labhil.identify.problem import Linearised, Problem
from labhil.identify.waves import starts_beside
from labhil.physics.model import index_of, terms_named
from labhil.physics.terms import Parameter
from labhil.signals import BoolArray, FloatArray

WANTED, LARGER = 1.5, 4.5
"""Noise levels of the response by which a size is stepped, and of a second step where that is not
proportional."""

PROPORTIONAL = 0.3
"""Relative difference from a proportional response from which a term counts as one with a threshold."""

SMOOTHNESS = (1e-2, 1.0, 1e2)
"""Weights of a curve's roughness in its prior, over one that lets each coefficient be what it likes."""

STANDS_FOR = 1e-6
"""Share of a response's square that is left beside the baseline's when these can stand for it: a sensor's
gain and a rig's own. Such a term cannot be seen, and a prior sized by its response would make it enormous.
Where they cannot, a few 10⁻⁴ are left at least; where they can, 10⁻⁷ and less, by rounding."""

TRIES = 5
"""Simulations that may go into finding the step of one size."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One way in which a term may act: with one set of shapes, or by steps of one size.

    ``keys`` are the parameters that the responses belong to, from place ``first`` of the Gram matrices on;
    one unit of a response is ``unit`` of its parameter. ``shape`` marks responses to a change of shape beside
    the value that it has ``at`` the fit; ``positive`` sizes that cannot be negative.
    """

    term: str
    first: int
    keys: tuple[str, ...]
    unit: tuple[float, ...]
    shape: tuple[bool, ...]
    positive: tuple[bool, ...]
    at: Mapping[str, float]

    @property
    def places(self) -> range:
        """Where its responses stand in the Gram matrices."""
        return range(self.first, self.first + len(self.keys))


@dataclass(frozen=True, slots=True)
class CurveColumns:
    """What each coefficient of a force over one coordinate changes in the residuals, (N·c, K).

    ``roughness`` (K, K) is ∫ f″² as a form of the coefficients.
    """

    name: str
    columns: FloatArray
    roughness: FloatArray


@dataclass(frozen=True, slots=True)
class Responses:
    """Responses of all terms beside a fit: their inner products, and the variants of each term by its key."""

    fitted: Fitted
    grams: Grams
    variants: Mapping[str, tuple[Variant, ...]]

    def acts(self, variant: Variant) -> BoolArray:
        """Outputs (c,) that a way of a term to act changes."""
        return np.asarray(self.grams.acts[:, variant.places].any(axis=1))

    def sizes(self, variants: Sequence[Variant], coefficients: FloatArray) -> dict[str, float]:
        """Values of parameters by key that ``coefficients`` of the variants' responses stand for."""
        values: dict[str, float] = {}
        start = 0
        parameters = {p.key: p for p in self.fitted.problem.model.parameters}
        for variant in variants:
            values |= variant.at
            for key, unit, shape in zip(variant.keys, variant.unit, variant.shape, strict=True):
                value = coefficients[start] * unit + (variant.at[key] if shape else 0.0)
                start += 1
                if key in parameters:  # coefficients of a curve are none of the model's
                    parameter = parameters[key]
                    values[key] = float(np.clip(value, parameter.lower, parameter.upper))
        return values


@dataclass(frozen=True, slots=True)
class _Column:
    key: str
    unit: float
    shape: bool
    positive: bool
    values: FloatArray


@dataclass(frozen=True, slots=True)
class _Way:
    """A variant before its place is known; ``precision`` (k, k) of its sizes, up to a factor, or None."""

    term: str
    at: Mapping[str, float]
    columns: tuple[_Column, ...]
    precision: FloatArray | None = None


def responses(
    data: Data,
    fitted: Fitted,
    baseline: Sequence[str],
    correlation: FloatArray,
    absent: Sequence[str] | None = None,
    curves: Sequence[CurveColumns] = (),
) -> Responses:
    """Take the responses of all terms where a fit stands.

    Args:
        data: the data of the search.
        fitted: a fit of the baseline with or without further terms.
        baseline: keys of the terms that every structure has.
        correlation: (c,) of the noise of neighbouring samples of each output.
        absent: keys of the terms that may be added; None for all that the model has.
        curves: forces over one coordinate each, which may be added too.
    """
    problem, solution = fitted.problem, fitted.solution
    lin = linearise_to_flatter_side(problem, solution)
    owners = [problem.model.parameters[i].term for i in problem.free]
    shared = [j for j, term in enumerate(owners) if term is None or term in baseline]
    present = [
        _present_way(problem, fitted, lin, term)
        for term in dict.fromkeys(owners)
        if term and term not in baseline
    ]
    target = solution.residuals - _explained_part(fitted, present)
    ways = [way for term in present for way in _as_curve(problem, term)]
    absent_terms = [key for key in data.model.terms if key not in fitted.terms] if absent is None else absent
    # a term that repeats along the way is tried at hundreds of orders: the others go beside it, not before it
    longest_first = sorted(absent_terms, key=lambda key: data.model.terms[key].order is None)
    each = side_by_side(partial(_absent_ways, problem, fitted, lin), longest_first)
    found = dict(zip(longest_first, each, strict=True))
    ways += [way for key in absent_terms for way in found[key]]
    for curve in curves:
        columns = tuple(_Column("", 1.0, False, False, column) for column in curve.columns.T)
        ways += _smooth(_Way(curve.name, {}, columns), curve.roughness)
    response_columns = [c.values for way in ways for c in way.columns]
    matrix = np.column_stack([target, lin.by_parameters[:, shared], *response_columns])
    placed, first = dict[str, list[Variant]](), 1
    priors = []
    for way in ways:
        fields = zip(*((c.key, c.unit, c.shape, c.positive) for c in way.columns), strict=True)
        keys, unit, shape, positive = (tuple(f) for f in fields)
        placed.setdefault(way.term, []).append(Variant(way.term, first, keys, unit, shape, positive, way.at))
        first += len(keys)
        priors.append(way.precision)
    possible = len(data.model.terms) - len(baseline)
    disturbance = (
        Disturbance.grid(possible) if data.model.state_names else Disturbance.near_estimate(possible)
    )
    plain = inner_products(problem, lin, matrix, len(shared), correlation, disturbance)
    weighted = plain.with_precisions(
        [(v.places, prior) for v, prior in zip(_in_order(placed), priors, strict=True)]
    )
    visible = {term: _visible_variants(weighted, of, term in fitted.terms) for term, of in placed.items()}
    return Responses(fitted, weighted, {term: of for term, of in visible.items() if of})


def linearise_to_flatter_side(problem: Problem, solution: Solution) -> Linearised:
    """Slopes where a fit stands, those by states to the side on which less changes."""
    lin = problem.linearise(solution.point, solution.residuals)
    return replace(lin, by_states=problem.flatter_state_slopes(solution.point, lin))


def _visible_variants(grams: Grams, variants: Sequence[Variant], present: bool) -> tuple[Variant, ...]:
    """Variants that the baseline's own parameters cannot stand for; all of a term that the fit has."""
    share = np.diag(grams.seen[0]) / np.maximum(np.diag(grams.raw), 1e-300)
    return tuple(v for v in variants if present or max(share[place] for place in v.places) > STANDS_FOR)


def _in_order(placed: Mapping[str, Sequence[Variant]]) -> list[Variant]:
    """All variants in the order of their places."""
    return sorted((v for of in placed.values() for v in of), key=lambda v: v.first)


def _as_curve(problem: Problem, way: _Way) -> list[_Way]:
    """A term as it is, or a curve with each of its smoothnesses."""
    model = problem.model
    if isinstance(model, ExtendedModel) and way.columns[0].key == model.coefficients[0].key:
        return _smooth(way, model.spline.roughness)
    return [way]


def _smooth(way: _Way, roughness: FloatArray) -> list[_Way]:
    """A curve with each of the smoothnesses that the prior holds possible."""
    count = len(way.columns)
    rough = roughness * (count / float(np.trace(roughness)))
    return [replace(way, precision=weight * rough + np.eye(count)) for weight in SMOOTHNESS]


def _explained_part(fitted: Fitted, ways: Sequence[_Way]) -> FloatArray:
    """What the added terms of a fit explain (N·c,), by their local slopes."""
    places = index_of(fitted.problem.model.parameters)
    explained = np.zeros_like(fitted.solution.residuals)
    for column in (c for way in ways for c in way.columns if not c.shape):
        explained += column.values * (fitted.theta[places[column.key]] / column.unit)
    return explained


def _present_way(problem: Problem, fitted: Fitted, lin: Linearised, term: str) -> _Way:
    """A term that the fit has, by its local slopes."""
    parameters = problem.model.parameters
    free = [(j, parameters[i]) for j, i in enumerate(problem.free) if parameters[i].term == term]
    columns = tuple(
        _Column(p.key, p.scale, p.shape, not p.shape and p.lower == 0.0, lin.by_parameters[:, j])
        for j, p in free
    )
    places = index_of(parameters)
    at = {p.key: float(fitted.theta[places[p.key]]) for _, p in free if p.shape}
    return _Way(term, at, columns)


def _absent_ways(problem: Problem, fitted: Fitted, lin: Linearised, term: str) -> list[_Way]:
    """A term that the fit lacks: at each set of its shapes, and by several steps where it has a threshold."""
    described = terms_named(problem.model, [term])[0]
    shapes = [p for p in described.parameters if p.shape]
    sizes = [p for p in described.parameters if not p.shape]
    ways: list[_Way] = []
    sets = starts_beside(fitted, [term])
    tried = set[tuple[float, ...]]()
    for values in sets:
        at = {p.key: values[p.key] for p in shapes}
        if tuple(at.values()) in tried:
            continue
        tried.add(tuple(at.values()))
        stepped = [_columns_of_size(problem, fitted, lin, at, p, _first_step(p, sets)) for p in sizes]
        for k in range(max(len(steps) for steps in stepped)):
            columns = tuple(steps[min(k, len(steps) - 1)] for steps in stepped if steps)
            if columns:
                ways.append(_Way(term, at, columns))
    return ways


def _first_step(parameter: Parameter, sets: Sequence[Mapping[str, float]]) -> float:
    """A size to begin with: a start of its own, or a little of its scale."""
    return max((abs(v[parameter.key]) for v in sets if v[parameter.key]), default=1e-2 * parameter.scale)


def _columns_of_size(
    problem: Problem,
    fitted: Fitted,
    lin: Linearised,
    at: Mapping[str, float],
    parameter: Parameter,
    step: float,
) -> list[_Column]:
    """Responses to steps of one size that change the residuals by about as much as noise does.

    One where the response is proportional to the step; else also one to a larger step. None where no step
    that is allowed changes anything.
    """
    model, residuals, states = problem.model, fitted.solution.residuals, fitted.solution.point.states
    places = index_of(model.parameters)

    def respond(size: float) -> tuple[float, FloatArray]:
        theta = fitted.theta.copy()
        for key, value in at.items():
            theta[places[key]] = value
        theta[places[parameter.key]] += size
        change = problem.residuals_at(theta, states) - residuals
        rms = float(np.sqrt(np.mean(problem.project(lin, change[:, None]) ** 2)))
        return rms, np.asarray(change * (parameter.scale / size))

    tried = _search_step(respond, min(step, 0.5 * parameter.upper), parameter.upper)
    if not tried:
        return []
    chosen = min(tried, key=lambda size: abs(np.log(tried[size][0] / WANTED)))
    sizes = [chosen]
    if not _is_proportional(tried):
        larger = min(tried, key=lambda size: abs(np.log(tried[size][0] / LARGER)))
        sizes = list(dict.fromkeys([chosen, larger]))
    positive = parameter.lower == 0.0
    return [_Column(parameter.key, parameter.scale, False, positive, tried[size][1]) for size in sizes]


def _search_step(
    respond: Callable[[float], tuple[float, FloatArray]], step: float, upper: float
) -> dict[float, tuple[float, FloatArray]]:
    """Steps that changed anything, with the RMS of the response and the response per unit."""
    tried = dict[float, tuple[float, FloatArray]]()
    below, above, size = 0.0, np.inf, step
    for _ in range(TRIES):
        rms, column = respond(size)
        if rms > 1e-6 and np.isfinite(rms):
            tried[size] = (rms, column)
        if 0.5 * WANTED <= rms <= 2.0 * WANTED:
            if _is_proportional(tried) or any(r > 0.5 * LARGER for r, _ in tried.values()):
                break
            below, size = size, size * LARGER / rms
            continue
        if rms < WANTED:
            below = max(below, size)
            size = size * min(WANTED / max(rms, 1e-3), 30.0)
        else:
            above = min(above, size)
            size = size * WANTED / rms
        if not below < size < above:
            size = np.sqrt(max(below, 1e-3 * above) * above) if np.isfinite(above) else 4.0 * below
        if size >= upper:
            break
    return tried


def _is_proportional(tried: Mapping[float, tuple[float, FloatArray]]) -> bool:
    """Whether responses of about the noise's size grow as their steps; True where only one is known."""
    per_unit = [rms / size for size, (rms, _) in tried.items() if rms < 4.0 * LARGER]
    return len(per_unit) < 2 or max(per_unit) / min(per_unit) < 1.0 + PROPORTIONAL
