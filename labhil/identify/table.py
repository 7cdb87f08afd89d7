"""The table of a fit: a row per parameter, with standard error, confidence interval and test.

``statistics`` has the covariance behind it, ``intervals`` the ways to make intervals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.identify import statistics
from labhil.identify.fitted import Fitted
from labhil.identify.identifiability import (
    covariance_without,
    undetermined_directions,
    weak_parameters,
)
from labhil.identify.intervals import (
    Intervals,
    bootstrap_intervals,
    profile_of,
    quantile,
    simultaneous_quantile,
)
from labhil.identify.problem import Point
from labhil.identify.shapes import POORLY_KNOWN_RELATIVE_ERROR
from labhil.physics.terms import Parameter
from labhil.signals import FloatArray

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class UndeterminedOptions:
    """When an interval is so wide that its parameter counts as not determined (chosen values).

    Practical non-identifiability is a flat profile (Raue and others, Bioinformatics 25, 2009).

    Attributes:
        max_end_ratio: Upper over lower end of the interval of a positive constant of the rig.
        max_width_ratio: Width of the interval over that of Wald's.
        max_correlation: Correlation with the estimate of such a parameter, beyond which another one counts
            as not determined either.
    """

    max_end_ratio: float = 100.0
    max_width_ratio: float = 10.0
    max_correlation: float = 0.99


DEFAULT_UNDETERMINED = UndeterminedOptions()


@dataclass(frozen=True, slots=True)
class ParameterTable:
    """Rows of a table with the matrices behind them.

    Attributes:
        rows: One for each free parameter.
        covariance: (P, P) robust, SI units.
        jacobian: (N, P) of the residuals, in units of noise per SI unit, states projected out.
        lower: Where a profile found a lower minimum than the fit's; None where none did.
    """

    rows: list[statistics.Estimate]
    covariance: FloatArray
    jacobian: FloatArray
    lower: Point | None = None


def table_of(
    fitted: Fitted,
    method: Intervals = Intervals.WALD,
    simultaneous: bool = False,
    *,
    stop_at_lower: bool = False,
) -> ParameterTable:
    """Make the table of a fitted model.

    Args:
        fitted: The fit.
        method: How intervals are made.
        simultaneous: Intervals hold for all parameters together with 99 %, not for each.
        stop_at_lower: Make no further profiles once one came upon a lower minimum.
    """
    robust, classical, jacobian = fitted.covariances
    chosen = [fitted.problem.model.parameters[i] for i in fitted.problem.free]
    values = fitted.theta[fitted.problem.free]
    n = len(fitted.solution.residuals)
    unknown = weak_parameters(chosen, values, jacobian, fitted.noise)
    reach = simultaneous_quantile(robust) if simultaneous else quantile()
    ends, lower = _intervals(fitted, method, robust, classical, jacobian, reach, stop_at_lower)
    rows = statistics.estimates(chosen, values, robust, classical, n, unknown, ends)
    if method is not Intervals.WALD:
        rows = _mark_undetermined(rows, chosen, robust, reach)
    return ParameterTable(rows, robust, jacobian, lower)


def widen(
    table: ParameterTable,
    parameters: Sequence[Parameter],
    values: Sequence[Mapping[str, float]],
    errors: Sequence[Mapping[str, float]],
    shifts: FloatArray,
) -> ParameterTable:
    """Widen the errors of a model that does not explain its data by the bias that the data show.

    A complete model gives the same estimates on windows of any length, up to their errors. The variance
    beyond these errors is added. A bias that all lengths have in common remains unseen.

    Args:
        table: Of the fit.
        parameters: P of them, in the order of the rows.
        values: Estimates by key of fits on windows of other lengths, SI units.
        errors: Their standard errors.
        shifts: (P,) changes of the estimates by the unknown course of the input between samples.
    """
    spread = np.array([_spread(row, values, errors) for row in table.rows])
    old = np.array([row.std_error for row in table.rows])
    new = np.hypot(np.hypot(old, spread), shifts)
    known = np.isfinite(new) & (old > 0.0)
    factor = np.where(known, new, 1.0) / np.where(known, old, 1.0)
    rows = [
        statistics.with_wider_error(row, float(error), (parameter.lower, parameter.upper))
        for row, error, parameter in zip(table.rows, new, parameters, strict=True)
    ]
    covariance = table.covariance * np.outer(factor, factor)
    return replace(table, rows=rows, covariance=covariance)


def _spread(
    row: statistics.Estimate, values: Sequence[Mapping[str, float]], errors: Sequence[Mapping[str, float]]
) -> float:
    """RMS distance of other estimates of a parameter, less the part that their own errors explain."""
    excess = [
        max((value[row.key] - row.value) ** 2 - error[row.key] ** 2, 0.0)
        for value, error in zip(values, errors, strict=True)
        if np.isfinite(error[row.key])
    ]
    return float(np.sqrt(np.mean(excess))) if excess else 0.0


def _mark_undetermined(
    rows: list[statistics.Estimate],
    parameters: list[Parameter],
    covariance: FloatArray,
    reach: float,
    options: UndeterminedOptions = DEFAULT_UNDETERMINED,
) -> list[statistics.Estimate]:
    """Mark rows as not identifiable whose interval is too wide, and those that are correlated with such."""
    too_wide = np.array(
        [_is_too_wide(row, p, reach, options) for row, p in zip(rows, parameters, strict=True)]
    )
    errors = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    finite = np.isfinite(errors)
    correlated = np.zeros((len(rows), len(rows)), dtype=bool)
    block = np.ix_(finite, finite)
    correlation = np.abs(covariance[block] / np.outer(errors[finite], errors[finite]))
    correlated[block] = correlation > options.max_correlation
    undetermined = too_wide | (correlated & too_wide).any(axis=1)
    return [
        replace(row, identifiable=False, significant=False) if marked else row
        for row, marked in zip(rows, undetermined, strict=True)
    ]


def _is_too_wide(
    row: statistics.Estimate, parameter: Parameter, reach: float, options: UndeterminedOptions
) -> bool:
    """Whether the interval spans orders of magnitude, or far more than Wald's."""
    low, high = row.ci99
    wald_width = 2.0 * reach * row.std_error
    is_flat = not parameter.in_steps and high - low > options.max_width_ratio * wald_width
    return (parameter.is_positive and high > options.max_end_ratio * low) or is_flat


def _intervals(
    fitted: Fitted,
    method: Intervals,
    robust: FloatArray,
    classical: FloatArray,
    jacobian: FloatArray,
    reach: float,
    stop_at_lower: bool,
) -> tuple[list[Interval], Point | None]:
    """Intervals of all parameters (SI), ``reach`` normal standard errors to either side, rivals included.

    The second is a point of lower cost that a profile came upon.
    """
    problem, solution = fitted.problem, fitted.solution
    values, errors = fitted.theta[problem.free], np.sqrt(np.maximum(np.diag(robust), 0.0))
    finite = np.isfinite(np.diag(robust))
    inflation = np.ones(len(values))
    inflation[finite] = np.diag(robust)[finite] / np.maximum(np.diag(classical)[finite], 1e-300)
    ends = [(float(v - reach * e), float(v + reach * e)) for v, e in zip(values, errors, strict=True)]
    if method is Intervals.BOOTSTRAP:
        begins = [row * len(problem.sigma) for row in problem.begins]
        ends = bootstrap_intervals(
            jacobian, solution.residuals, values, fitted.dof, reach, begins=tuple(begins)
        )
    lower = None
    profiled = np.isfinite(errors) & _needs_profile(fitted, errors, method)
    if np.any(profiled):
        profiles, lower = _profiles(fitted, profiled, jacobian, inflation, reach, stop_at_lower)
        parameters = [problem.model.parameters[i] for i in problem.free]
        ends = [
            wald if profile is None else _with_min_width(profile, wald, parameter)
            for profile, wald, parameter in zip(profiles, ends, parameters, strict=True)
        ]
    for rival in fitted.rivals:
        further = _intervals_of_rival(rival, fitted, inflation, reach)
        ends = [_hull(*pair) for pair in zip(ends, further, strict=True)]
    return ends, lower


def _profiles(
    fitted: Fitted,
    profiled: np.ndarray,
    jacobian: FloatArray,
    inflation: FloatArray,
    reach: float,
    stop_at_lower: bool,
) -> tuple[list[Interval | None], Point | None]:
    """Profile intervals of the parameters ``profiled`` (P,) of bool, None for others; then a lower minimum.

    Of each direction that the data do not determine, one parameter is held and none is profiled. This changes
    no profile of the others, and keeps their refits from drifting along it.
    """
    full_problem, theta, free = fitted.problem, fitted.theta, fitted.problem.free
    parameters = [full_problem.model.parameters[i] for i in free]
    held, involved = undetermined_directions(parameters, theta[free], jacobian, fitted.noise)
    kept = np.delete(np.arange(len(free)), held)
    problem = full_problem.pin(held, theta)
    point = Point(fitted.solution.point.z[kept], fitted.solution.point.states)
    solution = replace(fitted.solution, point=point)
    covariance = covariance_without(jacobian * full_problem.scale, held) * fitted.noise**2
    slopes = problem.linearise(point, solution.residuals)
    ends: list[Interval | None] = [None] * len(free)
    lower: Point | None = None
    for j, place in enumerate(kept):
        if lower is not None and stop_at_lower:
            break
        if profiled[place] and not involved[place]:
            profile = profile_of(problem, solution, slopes, j, covariance, float(inflation[place]), reach)
            ends[place] = profile.low, profile.high
            if profile.lower is not None:
                z = fitted.solution.point.z.copy()
                z[kept] = profile.lower.point.z
                lower = Point(z, profile.lower.point.states)
    full_problem.evaluations += problem.evaluations
    return ends, lower


def _with_min_width(
    profile: Interval, wald: Interval, parameter: Parameter, *, min_width_ratio: float = 0.7
) -> Interval:
    """The profile's interval, or where it is much narrower than Wald's the hull of both, within bounds.

    A profile that is so narrow has stopped at the edge of a rough valley of the cost.
    """
    if profile[1] - profile[0] > min_width_ratio * (wald[1] - wald[0]):
        return profile
    low, high = _hull(profile, wald)
    return max(low, parameter.lower), min(high, parameter.upper)


def _intervals_of_rival(
    rival: Fitted, best: Fitted, inflation: FloatArray, reach: float
) -> list[Interval | None]:
    """Intervals around a rival minimum, narrower as its cost is higher; None where it is out of reach."""
    _, classical, _ = rival.covariances
    values, errors = rival.theta[rival.problem.free], np.sqrt(np.maximum(np.diag(classical), 0.0))
    excess = max(rival.solution.cost - best.solution.cost, 0.0) / best.noise**2
    remaining = np.sqrt(np.maximum(reach**2 * inflation - excess, 0.0)) * errors
    return [(float(v - e), float(v + e)) if e > 0.0 else None for v, e in zip(values, remaining, strict=True)]


def _hull(one: Interval, other: Interval | None) -> Interval:
    """The smallest interval that contains both."""
    return one if other is None else (min(one[0], other[0]), max(one[1], other[1]))


def _needs_profile(fitted: Fitted, errors: FloatArray, method: Intervals) -> np.ndarray:
    """Mark the free parameters whose interval is a profile, (P,) of bool; ``errors`` (P,) are in SI units.

    A parameter by which the simulation changes in steps always gets one, since slopes do not give its error.
    """
    parameters = [fitted.problem.model.parameters[i] for i in fitted.problem.free]
    in_steps = np.array([p.in_steps for p in parameters], dtype=bool)
    if method is Intervals.AUTO:
        return in_steps | _is_curved(fitted, errors, parameters)
    return np.full(len(parameters), method is Intervals.PROFILE) | (in_steps & (method is Intervals.WALD))


def _is_curved(fitted: Fitted, errors: FloatArray, parameters: list[Parameter]) -> np.ndarray:
    """Mark the free parameters whose cost is no parabola, (P,) of bool.

    These are parameters of a term with a shape, and poorly known positive constants (``errors``, SI units).
    """
    model, free = fitted.problem.model, fitted.problem.free
    shaped = {key for key, term in model.terms.items() if any(p.shape for p in term.parameters)}
    has_shape = np.array([p.term in shaped for p in parameters], dtype=bool)
    is_positive = np.array([p.is_positive for p in parameters], dtype=bool)
    return has_shape | (is_positive & (errors > POORLY_KNOWN_RELATIVE_ERROR * np.abs(fitted.theta[free])))
