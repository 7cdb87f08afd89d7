"""The table of a fit: a row per parameter, with error, interval and test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.identify import statistics
from labhil.identify.fitted import Fitted, covariances
from labhil.identify.identifiability import lost_directions, weak_parameters
from labhil.identify.intervals import (
    Intervals,
    bootstrap_intervals,
    profile_interval,
    quantile,
    simultaneous_quantile,
)
from labhil.identify.problem import Point
from labhil.identify.shapes import POORLY_KNOWN_RELATIVE_ERROR
from labhil.identify.statistics import inverse_information
from labhil.physics.terms import Parameter
from labhil.signals import FloatArray

Interval = tuple[float, float]

ORDERS = 100.0
"""A size of the rig whose interval reaches this many times as far up as down is not determined."""

FLAT = 10.0
"""Nor is a value whose profile is this many times as wide as curvature says: it is flat.

Practical non-identifiability: Raue and others, Bioinformatics 25, 2009.
"""

NARROW = 0.7
"""A profile less than this times as wide as its curvature says ends at the edge of a rough valley."""

TIED = 0.99
"""Nor is one whose error goes with that of such a value, by this correlation."""


@dataclass(frozen=True, slots=True)
class ParameterTable:
    """Rows with the robust ``covariance`` (P, P, SI) and the projected ``jacobian`` (N, P) behind them."""

    rows: list[statistics.Estimate]
    covariance: FloatArray
    jacobian: FloatArray


def table_of(
    fitted: Fitted, method: Intervals = Intervals.WALD, simultaneous: bool = False
) -> ParameterTable:
    """The table of a fitted model; ``simultaneous`` intervals hold for all parameters together."""
    robust, classical, jacobian = covariances(fitted)
    chosen = [fitted.problem.model.parameters[i] for i in fitted.problem.free]
    values = fitted.theta[fitted.problem.free]
    n = len(fitted.solution.residuals)
    unknown = weak_parameters(chosen, values, jacobian, fitted.noise)
    reach = simultaneous_quantile(robust) if simultaneous else quantile()
    ends = _intervals(fitted, method, robust, classical, jacobian, reach)
    rows = statistics.estimates(chosen, values, robust, classical, n, unknown, ends)
    if method is not Intervals.WALD:
        rows = _mark_undetermined(rows, chosen, robust, reach)
    return ParameterTable(rows, robust, jacobian)


def widen(
    table: ParameterTable,
    parameters: Sequence[Parameter],
    values: Sequence[Mapping[str, float]],
    errors: Sequence[Mapping[str, float]],
    moved: FloatArray,
) -> ParameterTable:
    """The table of a model that does not explain its data, with how far its estimates move in the errors.

    ``values`` and ``errors`` are those of fits on windows of other lengths, ``moved`` (P,) what the input
    between samples may do. A complete model gives the same
    values on all of them, up to its errors; the variance beyond these is the part of the bias that the data
    show, and is added. What all lengths have in common stays unseen.
    """
    spread = np.array([_spread(row, values, errors) for row in table.rows])
    old = np.array([row.std_error for row in table.rows])
    new = np.sqrt(old**2 + spread**2 + moved**2)
    known = np.isfinite(new) & (old > 0.0)
    factor = np.where(known, new, 1.0) / np.where(known, old, 1.0)
    rows = [
        statistics.with_wider_error(row, float(error), (parameter.lower, parameter.upper))
        for row, error, parameter in zip(table.rows, new, parameters, strict=True)
    ]
    covariance = table.covariance * np.outer(factor, factor)
    return ParameterTable(rows, covariance, table.jacobian)


def _spread(
    row: statistics.Estimate, values: Sequence[Mapping[str, float]], errors: Sequence[Mapping[str, float]]
) -> float:
    """RMS distance of other estimates of a parameter, less what their own errors explain."""
    excess = [
        max((value[row.key] - row.value) ** 2 - error[row.key] ** 2, 0.0)
        for value, error in zip(values, errors, strict=True)
        if np.isfinite(error[row.key])
    ]
    return float(np.sqrt(np.mean(excess))) if excess else 0.0


def _mark_undetermined(
    rows: list[statistics.Estimate], parameters: list[Parameter], covariance: FloatArray, reach: float
) -> list[statistics.Estimate]:
    """The rows, not identifiable where an interval is open, nor where an error is tied to such a value's."""
    open_ended = np.array([_is_open(row, p, reach) for row, p in zip(rows, parameters, strict=True)])
    errors = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    seen = np.isfinite(errors)
    tied = np.zeros((len(rows), len(rows)), dtype=bool)
    both = np.ix_(seen, seen)
    tied[both] = np.abs(covariance[both] / np.outer(errors[seen], errors[seen])) > TIED
    lost = open_ended | (tied & open_ended).any(axis=1)
    return [
        replace(row, identifiable=False, significant=False) if gone else row
        for row, gone in zip(rows, lost, strict=True)
    ]


def _is_open(row: statistics.Estimate, parameter: Parameter, reach: float) -> bool:
    """Whether the interval spans orders of magnitude, or far more than curvature says."""
    low, high = row.ci99
    size = parameter.term is None and parameter.lower > 0.0
    flat = not parameter.in_steps and high - low > FLAT * 2.0 * reach * row.std_error
    return (size and high > ORDERS * low) or flat


def _intervals(
    fitted: Fitted,
    method: Intervals,
    robust: FloatArray,
    classical: FloatArray,
    jacobian: FloatArray,
    reach: float,
) -> list[Interval]:
    """Intervals of all parameters (SI), ``reach`` normal standard errors wide, rivals included."""
    problem, solution = fitted.problem, fitted.solution
    values, errors = fitted.theta[problem.free], np.sqrt(np.maximum(np.diag(robust), 0.0))
    seen = np.isfinite(np.diag(robust))
    inflation = np.ones(len(values))
    inflation[seen] = np.diag(robust)[seen] / np.maximum(np.diag(classical)[seen], 1e-300)
    ends = [(float(v - reach * e), float(v + reach * e)) for v, e in zip(values, errors, strict=True)]
    if method is Intervals.BOOTSTRAP:
        begins = [row * len(problem.sigma) for row in problem.begins]
        ends = bootstrap_intervals(
            jacobian, solution.residuals, values, fitted.dof, reach, begins=tuple(begins)
        )
    followed = np.isfinite(errors) & _needs_profile(fitted, errors, method)
    if np.any(followed):
        profiles = _profiles(fitted, followed, jacobian, inflation, reach)
        parameters = [problem.model.parameters[i] for i in problem.free]
        ends = [
            wald if profile is None else _wide_enough(profile, wald, parameter)
            for profile, wald, parameter in zip(profiles, ends, parameters, strict=True)
        ]
    for rival in fitted.rivals:
        ends = [_hull(*both) for both in zip(ends, _of_rival(rival, fitted, inflation, reach), strict=True)]
    return ends


def _profiles(
    fitted: Fitted, followed: np.ndarray, jacobian: FloatArray, inflation: FloatArray, reach: float
) -> list[Interval | None]:
    """Profile intervals of the parameters ``followed`` (P,), None for others.

    Where the data know nothing of a direction, one parameter of it is held and none of it followed: that
    changes no profile of the others, and the refits along them need not wander.
    """
    full_problem, theta, free = fitted.problem, fitted.theta, fitted.problem.free
    parameters = [full_problem.model.parameters[i] for i in free]
    lost, involved = lost_directions(parameters, theta[free], jacobian, fitted.noise)
    kept = np.delete(np.arange(len(free)), lost)
    problem = full_problem.pin(lost, theta)
    point = Point(fitted.solution.point.z[kept], fitted.solution.point.states)
    solution = replace(fitted.solution, point=point)
    scaled = jacobian[:, kept] * problem.scale
    unit = np.maximum(np.linalg.norm(scaled, axis=0), 1e-300)
    covariance = inverse_information(scaled / unit) / np.outer(unit, unit) * fitted.noise**2
    ends: list[Interval | None] = [None] * len(free)
    for j, place in enumerate(kept):
        if followed[place] and not involved[place]:
            ends[place] = profile_interval(problem, solution, j, covariance, float(inflation[place]), reach)
    full_problem.evaluations += problem.evaluations
    return ends


def _wide_enough(profile: Interval, wald: Interval, parameter: Parameter) -> Interval:
    """The profile's interval, or where it is too narrow to be smooth the hull of both, within bounds."""
    if profile[1] - profile[0] > NARROW * (wald[1] - wald[0]):
        return profile
    low, high = _hull(profile, wald)
    return max(low, parameter.lower), min(high, parameter.upper)


def _of_rival(rival: Fitted, best: Fitted, inflation: FloatArray, reach: float) -> list[Interval | None]:
    """What a rival adds to every interval: as far as the likelihood that its higher cost leaves it."""
    _, classical, _ = covariances(rival)
    values, errors = rival.theta[rival.problem.free], np.sqrt(np.maximum(np.diag(classical), 0.0))
    excess = max(rival.solution.cost - best.solution.cost, 0.0) / best.noise**2
    remaining = np.sqrt(np.maximum(reach**2 * inflation - excess, 0.0)) * errors
    return [(float(v - e), float(v + e)) if e > 0.0 else None for v, e in zip(values, remaining, strict=True)]


def _hull(one: Interval, other: Interval | None) -> Interval:
    return one if other is None else (min(one[0], other[0]), max(one[1], other[1]))


def _needs_profile(fitted: Fitted, errors: FloatArray, method: Intervals) -> np.ndarray:
    """Which free parameters get a profile, (P,) of bool: by their ``errors`` (P,), SI, by the method, or all.

    Where a simulation goes in steps no slope gives an interval, whatever the method.
    """
    parameters = [fitted.problem.model.parameters[i] for i in fitted.problem.free]
    in_steps = np.array([p.in_steps for p in parameters], dtype=bool)
    if method is Intervals.AUTO:
        return in_steps | _is_curved(fitted, errors, parameters)
    return np.full(len(parameters), method is Intervals.PROFILE) | (in_steps & (method is Intervals.WALD))


def _is_curved(fitted: Fitted, errors: FloatArray, parameters: list[Parameter]) -> np.ndarray:
    """Which free parameters have a cost that is no parabola, (P,) of bool.

    Those of a term with a shape, and sizes that cannot be zero and are poorly known (``errors``, SI).
    """
    model, free = fitted.problem.model, fitted.problem.free
    shaped = {key for key, term in model.terms.items() if any(p.shape for p in term.parameters)}
    of_shape = np.array([p.term in shaped for p in parameters], dtype=bool)
    is_size = np.array([p.term is None and p.lower > 0.0 for p in parameters], dtype=bool)
    return of_shape | (is_size & (errors > POORLY_KNOWN_RELATIVE_ERROR * np.abs(fitted.theta[free])))
