"""The table of what a diagnosis ends at: every value with an error that holds what the fit cannot know."""

from __future__ import annotations

import numpy as np

from labhil.diagnose.accepted import Accepted, accepted_error
from labhil.diagnose.conclude import Concluded
from labhil.diagnose.contrasts import between_parts, between_recordings, on_held_out, scale_factor
from labhil.diagnose.discrepancy import AbsentEffects, absent_effects, moved_by_what_is_left
from labhil.diagnose.search_result import SearchResult
from labhil.ending import EndedEarly
from labhil.identify.fitted import Fitted
from labhil.identify.statistics import Estimate, stated, with_error, with_wider_error
from labhil.identify.table import ParameterTable, table_of
from labhil.physics.model import Metric, index_of, terms_named


def final_table(
    end: Concluded, accepted: Accepted | None, absent: AbsentEffects, again: Fitted | None
) -> tuple[list[Estimate], float]:
    """The table of what is left, and the factor of its errors by which parts of the data disagree.

    Args:
        end: where a search ended.
        accepted: the model that sizes were held at, None where there is none.
        absent: what the final fit lacks.
        again: that fit on held-out data, where these can tell.

    Returns:
        Rows of all parameters, sizes that were held included, and the factor, at least 1.
    """
    found, curve = end.found, end.curves[-1] if end.curves else None
    table = table_of(found.final)
    if curve is None:
        scale, moved = _scale(found.final, table, again), moved_by_what_is_left(absent)
        of_curve = list[Estimate]()
    else:
        scale = _scale(curve.fit, table_of(curve.fit), again)
        held = {each.key for each in curve.model.coefficients}
        moved = moved_by_what_is_left(absent_effects(curve.fit), but=held)
        of_curve = list(curve.rows)
    # what is named may have been held beside a curve
    there = {row.key for row in of_curve}
    fitted = [*of_curve, *(row for row in table.rows if row.key not in there)]
    rows = [_with_bias(row, found, scale, moved.get(row.key, 0.0)) for row in fitted]
    return _with_held(rows, found, accepted), scale


def _has_one_scale(fitted: Fitted) -> bool:
    """Whether one factor may be of all errors: an arm's joints have values and errors of their own."""
    return fitted.problem.model.metric is not Metric.INVERSE_DYNAMICS


def _scale(fitted: Fitted, table: ParameterTable, again: Fitted | None) -> float:
    """The factor of a fit's errors by which parts of its data, and held-out data where known, disagree."""
    if not _has_one_scale(fitted):
        return 1.0
    contrasts = between_parts(fitted, table)
    return scale_factor(
        contrasts if again is None else [*contrasts, between_recordings(fitted, again, table)]
    )


def on_held_out_of(end: Concluded) -> Fitted | None:
    """The final model refitted to held-out data; None beside a curve, and of a search that was cut short."""
    if end.curves or not (end.found.complete and _has_one_scale(end.found.final)):
        return None
    try:
        return on_held_out(end.data, end.found.final)
    except EndedEarly:
        return None


def _with_held(rows: list[Estimate], found: SearchResult, accepted: Accepted | None) -> list[Estimate]:
    """The rows, those of sizes that were held before them, with errors that no fit can know.

    A size that was held at an accepted value is known as well as that.
    """
    fitted = found.final
    there = {row.key for row in rows}
    held = [p for p in fitted.problem.model.parameters if p.term is None and p.key not in there]
    places = index_of(fitted.problem.model.parameters)
    values = np.array([fitted.theta[places[p.key]] for p in held])
    errors = np.array([found.errors.get(p.key, accepted_error(accepted, p)) for p in held])
    rows = stated(held, values, errors) + rows
    known = [p for term in terms_named(fitted.problem.model, fitted.terms) for p in term.known]
    rows += stated(known, np.array([p.scale for p in known]), np.zeros(len(known)))
    return [with_error(row, found.errors.get(row.key, 0.0)) for row in rows]


def _with_bias(row: Estimate, found: SearchResult, scale: float, moved: float) -> Estimate:
    """The row with its error times ``scale``, and beside it what is left and other structures may do."""
    parameter = next((p for p in found.final.problem.model.parameters if p.key == row.key), None)
    beside = np.hypot(found.between_structures(row.key), moved)
    error = float(np.hypot(scale * row.std_error, beside))
    bounds = (-np.inf, np.inf) if parameter is None else (parameter.lower, parameter.upper)
    return with_wider_error(row, error, bounds)
