"""The final table of a diagnosis: every value with an error that includes what the fit cannot know."""

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
from labhil.diagnose.discrepancy import AbsentEffects, absent_effects, discrepancy_shifts
from labhil.diagnose.search_result import SearchResult
from labhil.ending import EndedEarly
from labhil.identify.fitted import Fitted
from labhil.identify.statistics import Estimate, stated_estimates, with_error, with_wider_error
from labhil.identify.table import ParameterTable, table_of
from labhil.physics.model import Metric, index_of, terms_named


def final_table(
    conclusion: Conclusion, accepted: Accepted | None, absent: AbsentEffects, held_out_fit: Fitted | None
) -> tuple[list[Estimate], float]:
    """The final table, and the factor of its errors by which parts of the data disagree.

    Args:
        conclusion: where a search ended.
        accepted: the model that sizes were held at, None where there is none.
        absent: the effects that the final fit lacks.
        held_out_fit: that fit on held-out data, where these determine it.

    Returns:
        Rows of all parameters, sizes that were held included, and the factor, at least 1.
    """
    result, curve = conclusion.result, conclusion.curves[-1] if conclusion.curves else None
    table = table_of(result.final)
    if curve is None:
        scale, moved = _scale(result.final, table, held_out_fit), discrepancy_shifts(absent)
        of_curve = list[Estimate]()
    else:
        scale = _scale(curve.fit, table_of(curve.fit), held_out_fit)
        held = {coefficient.key for coefficient in curve.model.coefficients}
        moved = discrepancy_shifts(absent_effects(curve.fit), known=held)
        of_curve = list(curve.rows)
    # named terms may have been held beside a curve
    curve_keys = {row.key for row in of_curve}
    fitted = [*of_curve, *(row for row in table.rows if row.key not in curve_keys)]
    rows = [_with_bias(row, result, scale, moved.get(row.key, 0.0)) for row in fitted]
    return _with_held(rows, result, accepted), scale


def _has_one_scale(fitted: Fitted) -> bool:
    """Whether one factor may be of all errors: there are some, and no joints that have their own."""
    problem = fitted.problem
    return len(problem.free) > 0 and problem.model.metric is not Metric.INVERSE_DYNAMICS


def _scale(fitted: Fitted, table: ParameterTable, held_out_fit: Fitted | None) -> float:
    """The factor of a fit's errors by which parts of its data, and held-out data where known, disagree."""
    if not _has_one_scale(fitted):
        return 1.0
    contrasts = contrasts_of_halves(fitted, table)
    return scale_factor(
        contrasts
        if held_out_fit is None
        else [*contrasts, contrast_with_held_out(fitted, held_out_fit, table)]
    )


def on_held_out_of(conclusion: Conclusion) -> Fitted | None:
    """The final model refitted to held-out data; None beside a curve, and of a search that was cut short."""
    if conclusion.curves or not (conclusion.result.complete and _has_one_scale(conclusion.result.final)):
        return None
    try:
        return refit_on_held_out(conclusion.data, conclusion.result.final)
    except EndedEarly:
        return None


def _with_held(rows: list[Estimate], result: SearchResult, accepted: Accepted | None) -> list[Estimate]:
    """The rows, those of sizes that were held before them, with errors that no fit can know.

    A size that was held at an accepted value is known as well as that.
    """
    fitted = result.final
    listed = {row.key for row in rows}
    held = [p for p in fitted.problem.model.parameters if p.term is None and p.key not in listed]
    places = index_of(fitted.problem.model.parameters)
    values = np.array([fitted.theta[places[p.key]] for p in held])
    errors = np.array([result.errors.get(p.key, accepted_error(accepted, p)) for p in held])
    rows = stated_estimates(held, values, errors) + rows
    constants = [p for term in terms_named(fitted.problem.model, fitted.terms) for p in term.known]
    rows += stated_estimates(constants, np.array([p.scale for p in constants]), np.zeros(len(constants)))
    return [with_error(row, result.errors.get(row.key, 0.0)) for row in rows]


def _with_bias(row: Estimate, result: SearchResult, scale: float, moved: float) -> Estimate:
    """The row with its error times ``scale``, widened by the residuals' and other structures' influence."""
    parameter = next((p for p in result.final.problem.model.parameters if p.key == row.key), None)
    bias = np.hypot(result.between_structures(row.key), moved)
    error = float(np.hypot(scale * row.std_error, bias))
    bounds = (-np.inf, np.inf) if parameter is None else (parameter.lower, parameter.upper)
    return with_wider_error(row, error, bounds)
