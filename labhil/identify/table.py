"""The table of a fit: a row per parameter, with error, interval and test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.identify import statistics
from labhil.identify.fitted import Fitted, covariances
from labhil.identify.identifiability import weak_parameters
from labhil.identify.intervals import (
    Intervals,
    bootstrap_intervals,
    profile_interval,
    quantile,
    simultaneous_quantile,
)
from labhil.signals import FloatArray


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
    return ParameterTable(rows, robust, jacobian)


def _intervals(
    fitted: Fitted,
    method: Intervals,
    robust: FloatArray,
    classical: FloatArray,
    jacobian: FloatArray,
    reach: float,
) -> list[tuple[float, float]]:
    """Intervals of all parameters (SI) that reach out to ``reach`` normal standard errors."""
    problem, solution = fitted.problem, fitted.solution
    values, errors = fitted.theta[problem.free], np.sqrt(np.maximum(np.diag(robust), 0.0))
    wald = [(float(v - reach * e), float(v + reach * e)) for v, e in zip(values, errors, strict=True)]
    if method is Intervals.BOOTSTRAP:
        return bootstrap_intervals(jacobian, solution.residuals, values, fitted.dof, reach)
    if method is Intervals.WALD:
        return wald
    inflation = np.diag(robust) / np.maximum(np.diag(classical), 1e-300)
    scaled = classical / np.outer(problem.scale, problem.scale)
    followed = np.isfinite(errors) & (_bent(fitted) if method is Intervals.AUTO else True)
    return [
        profile_interval(problem, solution, j, scaled, float(inflation[j]), reach) if followed[j] else wald[j]
        for j in range(len(values))
    ]


def _bent(fitted: Fitted) -> np.ndarray:
    """Which free parameters belong to a term with a shape, (P,) of bool."""
    model = fitted.problem.model
    shaped = {key for key, term in model.terms.items() if any(p.shape for p in term.parameters)}
    return np.array([model.parameters[i].term in shaped for i in fitted.problem.free], dtype=bool)
