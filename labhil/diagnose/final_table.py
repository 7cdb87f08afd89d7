"""The final parameter table of a diagnosis, with errors beyond the covariance of the fit.

These are disagreement between parts of the data (``contrasts.py``), model discrepancy (``discrepancy.py``)
and differences between likely structures.
"""

from __future__ import annotations

import numpy as np

from labhil.diagnose.accepted import Accepted, accepted_error
from labhil.diagnose.conclude import Conclusion
from labhil.diagnose.contrasts import (
    contrast_with_held_out,
    contrasts_of_halves,
    refit_on_held_out,
    scale_factor,
)
from labhil.diagnose.discrepancy import AbsentEffects, discrepancy_shifts
from labhil.diagnose.search_result import SearchResult
from labhil.identify.fitted import Fitted
from labhil.identify.statistics import Estimate, estimates_from_errors, with_min_error, with_wider_error
from labhil.identify.table import ParameterTable, table_of
from labhil.physics.model import Metric, index_of, terms_named


def final_table(
    conclusion: Conclusion, accepted: Accepted | None, absent: AbsentEffects, held_out_fit: Fitted | None
) -> tuple[list[Estimate], float]:
    """Tabulate all parameters of the final model with their total errors.

    Args:
        conclusion: the end of the search.
        accepted: the model at whose values parameters were held, if there is one.
        absent: the terms that the final fit lacks, beside its curves if it has any.
        held_out_fit: the final model refitted to held-out data, where these determine it.

    Returns:
        Rows of all parameters, held ones included, and the factor of all errors by which parts of the data
        disagree, at least 1.
    """
    result, curve = conclusion.result, conclusion.curves[-1] if conclusion.curves else None
    table = table_of(result.final)
    if curve is None:
        scale, shifts = _error_factor(result.final, table, held_out_fit), discrepancy_shifts(absent)
        curve_rows = list[Estimate]()
    else:
        scale = _error_factor(curve.fit, table_of(curve.fit), held_out_fit)
        coefficients = {coefficient.key for coefficient in curve.model.coefficients}
        shifts = discrepancy_shifts(absent, known=coefficients)
        curve_rows = list(curve.rows)
    # named terms may have been held beside a curve
    curve_keys = {row.key for row in curve_rows}
    fitted = [*curve_rows, *(row for row in table.rows if row.key not in curve_keys)]
    rows = [_with_bias(row, result, scale, shifts.get(row.key, 0.0)) for row in fitted]
    return _with_held(rows, result, accepted), scale


def _has_common_factor(fitted: Fitted) -> bool:
    """Whether one factor applies to all errors: not without parameters, nor of joints (inverse dynamics)."""
    problem = fitted.problem
    return len(problem.free) > 0 and problem.model.metric is not Metric.INVERSE_DYNAMICS


def _error_factor(fitted: Fitted, table: ParameterTable, held_out_fit: Fitted | None) -> float:
    """Factor of a fit's errors by which parts of its data, and of held-out data if known, disagree."""
    if not _has_common_factor(fitted):
        return 1.0
    contrasts = contrasts_of_halves(fitted, table)
    return scale_factor(
        contrasts
        if held_out_fit is None
        else [*contrasts, contrast_with_held_out(fitted, held_out_fit, table)]
    )


def refit_to_held_out(conclusion: Conclusion) -> Fitted | None:
    """Refit the final model to the held-out data.

    Args:
        conclusion: the end of the search.

    Returns:
        The fit; None beside a curve, of inverse dynamics and where the user ended the search early.
    """
    if conclusion.curves or not (conclusion.result.complete and _has_common_factor(conclusion.result.final)):
        return None
    return refit_on_held_out(conclusion.data, conclusion.result.final)


def _with_held(rows: list[Estimate], result: SearchResult, accepted: Accepted | None) -> list[Estimate]:
    """Add rows of held parameters in front and of constants behind, and errors that no fit contains.

    A parameter that was held at an accepted value has the error of that value.
    """
    fitted = result.final
    listed = {row.key for row in rows}
    held = [p for p in fitted.problem.model.parameters if p.term is None and p.key not in listed]
    places = index_of(fitted.problem.model.parameters)
    values = np.array([fitted.theta[places[p.key]] for p in held])
    errors = np.array([result.errors.get(p.key, accepted_error(accepted, p)) for p in held])
    rows = estimates_from_errors(held, values, errors) + rows
    constants = [p for term in terms_named(fitted.problem.model, fitted.terms) for p in term.known]
    rows += estimates_from_errors(constants, np.array([p.scale for p in constants]), np.zeros(len(constants)))
    return [with_min_error(row, result.errors.get(row.key, 0.0)) for row in rows]


def _with_bias(row: Estimate, result: SearchResult, scale: float, shift: float) -> Estimate:
    """The row with its error times ``scale``, plus discrepancy (``shift``) and differences of structures."""
    parameter = next((p for p in result.final.problem.model.parameters if p.key == row.key), None)
    bias = np.hypot(result.between_structures(row.key), shift)
    error = float(np.hypot(scale * row.std_error, bias))
    bounds = (-np.inf, np.inf) if parameter is None else (parameter.lower, parameter.upper)
    return with_wider_error(row, error, bounds)
