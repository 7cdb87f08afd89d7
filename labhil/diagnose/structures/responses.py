"""Responses of a fit's residuals to every term of the model, from simulations with small steps at the fit.

The terms that the fit has are among them, by their local slopes, and their contribution is subtracted from
the target. Every structure, with or without these terms, is then compared along the same trajectory, which
follows the data. The comparison itself is in enumerate.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from labhil.diagnose.judge import Data
from labhil.diagnose.structures.disturbance import Disturbance, compute_gram_matrices
from labhil.diagnose.structures.marginal import GramMatrices
from labhil.identify.extended import ExtendedModel
from labhil.identify.fitted import Fitted
from labhil.identify.least_squares import Solution
from labhil.identify.problem import Linearised, Problem
from labhil.identify.waves import starts_for_added_terms
from labhil.physics.model import index_of, terms_named
from labhil.physics.terms import Parameter
from labhil.signals import BoolArray, FloatArray

REPRODUCIBLE_SHARE = 1e-6
"""Fraction of a response's square up to which the baseline's parameters can reproduce it, as the gain
of the rig reproduces that of a sensor. The data cannot show such a term, and a prior scaled by its response
would make it enormous. Rounding leaves 1e-7 and less; of other responses a few 1e-4 remain at least."""


@dataclass(frozen=True, slots=True)
class ResponseOptions:
    """Options of the finite differences and of the curves' priors; the values are heuristics.

    Attributes:
        target_rms_in_noise: RMS of the response that a step aims at, in noise levels.
        larger_rms_in_noise: the same of a second step, where the response is not proportional to the first
            one.
        proportional_tolerance: relative spread of responses per step up to which they count as proportional;
            a term with a threshold exceeds it.
        max_simulations: largest number of simulations for the steps of one parameter.
        smoothness_weights: weights of a curve's roughness in its prior, relative to a prior that treats all
            coefficients as independent.
    """

    target_rms_in_noise: float = 1.5
    larger_rms_in_noise: float = 4.5
    proportional_tolerance: float = 0.3
    max_simulations: int = 5
    smoothness_weights: tuple[float, ...] = (1e-2, 1.0, 1e2)


@dataclass(frozen=True, slots=True)
class Variant:
    """One linearisation of a term: with one set of shape parameters, or by steps of one size.

    Attributes:
        term: key of the term.
        first: column of its first response in the Gram matrices.
        keys: keys of the parameters that the responses belong to.
        unit: change of the parameter, in SI units, for one unit of a response.
        shape: whether a response is to a change of a shape parameter from its value in ``at``.
        positive: whether a parameter cannot be negative.
        at: values of the shape parameters by key.
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
        """Columns of its responses in the Gram matrices."""
        return range(self.first, self.first + len(self.keys))


@dataclass(frozen=True, slots=True)
class CurveResponse:
    """Responses of the residuals to a force over one coordinate.

    Attributes:
        name: name of the force, which serves as the key of its term.
        columns: (N·c, K), responses to the K coefficients of its spline.
        roughness: (K, K), the quadratic form ∫ f″² of the coefficients.
    """

    name: str
    columns: FloatArray
    roughness: FloatArray


@dataclass(frozen=True, slots=True)
class Responses:
    """Responses of all terms at a fit: their inner products, and the variants of each term by its key."""

    fitted: Fitted
    grams: GramMatrices
    variants: Mapping[str, tuple[Variant, ...]]

    def affected_outputs(self, variant: Variant) -> BoolArray:
        """Whether a variant of a term changes an output, (c,)."""
        return np.asarray(self.grams.affects[:, variant.places].any(axis=1))

    def sizes(self, variants: Sequence[Variant], coefficients: FloatArray) -> dict[str, float]:
        """Convert coefficients of responses to parameter values.

        Args:
            variants: the variants of a structure.
            coefficients: (k,), coefficients of their responses.

        Returns:
            Values by key in SI units, clipped to the parameters' bounds.
        """
        values: dict[str, float] = {}
        start = 0
        parameters = {p.key: p for p in self.fitted.problem.model.parameters}
        for variant in variants:
            values |= variant.at
            for key, unit, shape in zip(variant.keys, variant.unit, variant.shape, strict=True):
                value = coefficients[start] * unit + (variant.at[key] if shape else 0.0)
                start += 1
                if key in parameters:  # the model has no parameters for the coefficients of a curve
                    parameter = parameters[key]
                    values[key] = float(np.clip(value, parameter.lower, parameter.upper))
        return values


@dataclass(frozen=True, slots=True)
class _Response:
    key: str
    unit: float
    shape: bool
    positive: bool
    values: FloatArray


@dataclass(frozen=True, slots=True)
class _UnplacedVariant:
    """A variant without columns in the Gram matrices; ``precision`` (k, k) is its prior up to a factor."""

    term: str
    at: Mapping[str, float]
    columns: tuple[_Response, ...]
    precision: FloatArray | None = None


def compute_responses(
    data: Data,
    fitted: Fitted,
    baseline: Sequence[str],
    correlation: FloatArray,
    absent: Sequence[str] | None = None,
    curves: Sequence[CurveResponse] = (),
    *,
    options: ResponseOptions | None = None,
) -> Responses:
    """Simulate the responses of all terms at a fit, and take their inner products.

    Args:
        data: the data of the search.
        fitted: a fit of the baseline with or without further terms.
        baseline: keys of the terms that every structure has.
        correlation: (c,), first-order autocorrelation of the noise of each output.
        absent: keys of the terms that may be added; None for all that the model has.
        curves: forces over one coordinate each, which may be added too.
        options: options of the finite differences; None for the defaults.

    Returns:
        The responses of all terms that the data can show.
    """
    options = options or ResponseOptions()
    problem, solution = fitted.problem, fitted.solution
    lin = linearise_to_flatter_side(problem, solution)
    owners = [problem.model.parameters[i].term for i in problem.free]
    shared = [j for j, term in enumerate(owners) if term is None or term in baseline]
    present = [
        _present_variant(problem, fitted, lin, term)
        for term in dict.fromkeys(owners)
        if term and term not in baseline
    ]
    target = solution.residuals - _explained_part(fitted, present)
    unplaced = [variant for local in present for variant in _with_smoothness(problem, local, options)]
    absent_terms = [key for key in data.model.terms if key not in fitted.terms] if absent is None else absent
    unplaced += _all_absent_variants(fitted, lin, absent_terms, options)
    for curve in curves:
        columns = tuple(_Response("", 1.0, False, False, column) for column in curve.columns.T)
        unplaced += _curve_variants(_UnplacedVariant(curve.name, {}, columns), curve.roughness, options)
    response_columns = [c.values for variant in unplaced for c in variant.columns]
    matrix = np.column_stack([target, lin.by_parameters[:, shared], *response_columns])
    possible = len(data.model.terms) - len(baseline)
    disturbance = (
        Disturbance.grid(possible) if data.model.state_names else Disturbance.near_estimate(possible)
    )
    plain = compute_gram_matrices(problem, lin, matrix, len(shared), correlation, disturbance)
    placed = _place(unplaced)
    weighted = plain.with_precisions(
        [(v.places, variant.precision) for v, variant in zip(_in_order(placed), unplaced, strict=True)]
    )
    visible = {
        term: _visible_variants(weighted, variants, term in fitted.terms) for term, variants in placed.items()
    }
    return Responses(fitted, weighted, {term: variants for term, variants in visible.items() if variants})


def _all_absent_variants(
    fitted: Fitted, lin: Linearised, absent: Sequence[str], options: ResponseOptions
) -> list[_UnplacedVariant]:
    """All variants of the terms that the fit lacks, in the order of the terms."""
    of_terms = fitted.problem.side_by_side(partial(_absent_variants, fitted, lin, options), absent)
    return [variant for variants in of_terms for variant in variants]


def _place(unplaced: Sequence[_UnplacedVariant]) -> dict[str, list[Variant]]:
    """Variants by term, with consecutive columns of the Gram matrices from 1 on."""
    placed, first = dict[str, list[Variant]](), 1
    for variant in unplaced:
        fields = zip(*((c.key, c.unit, c.shape, c.positive) for c in variant.columns), strict=True)
        keys, unit, shape, positive = (tuple(f) for f in fields)
        placed.setdefault(variant.term, []).append(
            Variant(variant.term, first, keys, unit, shape, positive, variant.at)
        )
        first += len(keys)
    return placed


def linearise_to_flatter_side(problem: Problem, solution: Solution) -> Linearised:
    """Linearise a fit, with one-sided slopes by the states to the side on which residuals change less."""
    lin = problem.linearise(solution.point, solution.residuals)
    return replace(lin, by_states=problem.flatter_state_slopes(solution.point, lin))


def _visible_variants(grams: GramMatrices, variants: Sequence[Variant], present: bool) -> tuple[Variant, ...]:
    """Variants that the baseline's parameters cannot reproduce; all variants of a term that the fit has."""
    share = np.diag(grams.projected[0]) / np.maximum(np.diag(grams.raw), 1e-300)
    return tuple(
        v for v in variants if present or max(share[place] for place in v.places) > REPRODUCIBLE_SHARE
    )


def _in_order(placed: Mapping[str, Sequence[Variant]]) -> list[Variant]:
    """All variants in the order of their columns."""
    return sorted((v for variants in placed.values() for v in variants), key=lambda v: v.first)


def _with_smoothness(
    problem: Problem, variant: _UnplacedVariant, options: ResponseOptions
) -> list[_UnplacedVariant]:
    """The variant of a named term as it is, that of a curve once for each smoothness."""
    model = problem.model
    if isinstance(model, ExtendedModel) and variant.columns[0].key == model.coefficients[0].key:
        return _curve_variants(variant, model.spline.roughness, options)
    return [variant]


def _curve_variants(
    variant: _UnplacedVariant, roughness: FloatArray, options: ResponseOptions
) -> list[_UnplacedVariant]:
    """A variant of a curve for each smoothness of the prior."""
    count = len(variant.columns)
    rough = roughness * (count / float(np.trace(roughness)))
    return [
        replace(variant, precision=weight * rough + np.eye(count)) for weight in options.smoothness_weights
    ]


def _explained_part(fitted: Fitted, unplaced: Sequence[_UnplacedVariant]) -> FloatArray:
    """Contribution (N·c,) of a fit's added terms to the residuals, by their local slopes."""
    places = index_of(fitted.problem.model.parameters)
    explained = np.zeros_like(fitted.solution.residuals)
    for column in (c for variant in unplaced for c in variant.columns if not c.shape):
        explained += column.values * (fitted.theta[places[column.key]] / column.unit)
    return explained


def _present_variant(problem: Problem, fitted: Fitted, lin: Linearised, term: str) -> _UnplacedVariant:
    """The variant of a term that the fit has, by its local slopes."""
    parameters = problem.model.parameters
    free = [(j, parameters[i]) for j, i in enumerate(problem.free) if parameters[i].term == term]
    columns = tuple(
        _Response(p.key, p.scale, p.shape, not p.shape and p.lower >= 0.0, lin.by_parameters[:, j])
        for j, p in free
    )
    places = index_of(parameters)
    at = {p.key: float(fitted.theta[places[p.key]]) for _, p in free if p.shape}
    return _UnplacedVariant(term, at, columns)


def _absent_variants(
    fitted: Fitted, lin: Linearised, options: ResponseOptions, term: str
) -> list[_UnplacedVariant]:
    """Variants of a term that the fit lacks: one for each set of its shapes, two where it has a threshold."""
    described = terms_named(fitted.problem.model, [term])[0]
    shapes = [p for p in described.parameters if p.shape]
    sizes = [p for p in described.parameters if not p.shape]
    unplaced: list[_UnplacedVariant] = []
    sets = starts_for_added_terms(fitted, [term])
    tried = set[tuple[float, ...]]()
    for values in sets:
        at = {p.key: values[p.key] for p in shapes}
        if tuple(at.values()) in tried:
            continue
        tried.add(tuple(at.values()))
        stepped = [_columns_of_size(fitted, lin, at, p, _initial_step(p, sets), options) for p in sizes]
        for k in range(max(len(steps) for steps in stepped)):
            columns = tuple(steps[min(k, len(steps) - 1)] for steps in stepped if steps)
            if columns:
                unplaced.append(_UnplacedVariant(term, at, columns))
    return unplaced


def _initial_step(parameter: Parameter, sets: Sequence[Mapping[str, float]]) -> float:
    """Size of the first step: the largest start of the parameter, else one per cent of its scale."""
    return max((abs(v[parameter.key]) for v in sets if v[parameter.key]), default=1e-2 * parameter.scale)


def _columns_of_size(
    fitted: Fitted,
    lin: Linearised,
    at: Mapping[str, float],
    parameter: Parameter,
    step: float,
    options: ResponseOptions,
) -> list[_Response]:
    """Responses to steps of one parameter that change the residuals by about the noise level.

    One response where it is proportional to the step, else a second one to a larger step. Empty where no step
    within the bounds changes the residuals.
    """
    problem = fitted.problem
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

    tried = _search_step(respond, min(step, 0.5 * parameter.upper), parameter.upper, options)
    if not tried:
        return []
    chosen = min(tried, key=lambda size: abs(np.log(tried[size][0] / options.target_rms_in_noise)))
    sizes = [chosen]
    if not _is_proportional(tried, options):
        larger = min(tried, key=lambda size: abs(np.log(tried[size][0] / options.larger_rms_in_noise)))
        sizes = list(dict.fromkeys([chosen, larger]))
    positive = parameter.lower >= 0.0
    return [_Response(parameter.key, parameter.scale, False, positive, tried[size][1]) for size in sizes]


def _search_step(
    respond: Callable[[float], tuple[float, FloatArray]], step: float, upper: float, options: ResponseOptions
) -> dict[float, tuple[float, FloatArray]]:
    """Steps that changed the residuals, with the RMS of the response and the response per unit."""
    target, larger = options.target_rms_in_noise, options.larger_rms_in_noise
    tried = dict[float, tuple[float, FloatArray]]()
    below, above, size = 0.0, np.inf, step
    for _ in range(options.max_simulations):
        rms, column = respond(size)
        if rms > 1e-6 and np.isfinite(rms):
            tried[size] = (rms, column)
        if 0.5 * target <= rms <= 2.0 * target:
            if _is_proportional(tried, options) or any(r > 0.5 * larger for r, _ in tried.values()):
                break
            below, size = size, size * larger / rms
            continue
        if rms < target:
            below = max(below, size)
            size = size * min(target / max(rms, 1e-3), 30.0)
        else:
            above = min(above, size)
            size = size * target / rms
        if not below < size < above:
            size = np.sqrt(max(below, 1e-3 * above) * above) if np.isfinite(above) else 4.0 * below
        if size >= upper:
            break
    return tried


def _is_proportional(tried: Mapping[float, tuple[float, FloatArray]], options: ResponseOptions) -> bool:
    """Whether responses near the noise level are proportional to their steps; True for a single one."""
    per_unit = [rms / size for size, (rms, _) in tried.items() if rms < 4.0 * options.larger_rms_in_noise]
    return len(per_unit) < 2 or max(per_unit) / min(per_unit) < 1.0 + options.proportional_tolerance
