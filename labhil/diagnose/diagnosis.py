"""The diagnosis: do model and recordings disagree, where, which terms are missing, does the fit improve?

``diagnose`` checks the data (``timing.py``), fits the baseline (``begin.py``), searches structures
(``search_with_sizes.py``), concludes (``conclude.py``) and states the answer (``answer.py``).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy import stats

from labhil.diagnose import statements
from labhil.diagnose.accepted import Accepted, accepted_error
from labhil.diagnose.adequacy import leaves_only_noise, residual_rms
from labhil.diagnose.answer import Change, Diagnosis, Undecided
from labhil.diagnose.augmented import augmented_search
from labhil.diagnose.begin import fit_baseline_and_noise, prepare_data
from labhil.diagnose.conclude import Conclusion, conclude
from labhil.diagnose.discrepancy import absent_effects
from labhil.diagnose.evidence import effective_samples
from labhil.diagnose.exclusions import exclusions
from labhil.diagnose.final_table import final_table, refit_to_held_out
from labhil.diagnose.force_curve import ForceCurve
from labhil.diagnose.intake import Fault, assess_usability, is_driven, why_at_rest
from labhil.diagnose.joint_curves import sort_by_heldout_gain
from labhil.diagnose.judge import COMBINED_ALPHA, Data
from labhil.diagnose.remainder import find_remainder
from labhil.diagnose.search_result import SearchResult
from labhil.diagnose.search_with_sizes import search_with_sizes
from labhil.diagnose.timing import detect_all_faults
from labhil.ending import EndedEarly, accept
from labhil.identify.adequacy import NOISE_FLOOR_FACTOR
from labhil.identify.fitted import Fitted
from labhil.identify.score import score, with_forces
from labhil.identify.statistics import Estimate
from labhil.identify.table import table_of
from labhil.physics.model import Model, terms_named
from labhil.physics.record import Record
from labhil.physics.terms import listed, unkeyed

VERDICT_ALPHA = 5e-4
"""Level α of the verdict: the accepted probability of a false alarm."""

MIN_STD_IN_NOISE = 5.0
"""Standard deviation of an output, in those of its noise, from which "no mismatch" says something; a
heuristic."""

ENDED_BEFORE_SEARCH = "not_decidable", "ended early, before anything was searched"
"""Verdict and reason of an answer that has only a baseline."""


def diagnose(
    model: Model,
    searched: Record,
    held_out: Record,
    *,
    heldout_is_test: bool,
    baseline: Sequence[str],
    reference: Mapping[str, float] | None = None,
    accepted: Accepted | None = None,
    measured: Record | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """Find the physics that a baseline model lacks, and test it on held-out data.

    Args:
        model: the model with all terms that may be missing.
        searched: recordings to search, as ``model.prepare`` returns them.
        held_out: recordings to test on, prepared likewise.
        heldout_is_test: whether these are a test recording of their own, not a part of the searched one.
        baseline: names of the baseline's terms.
        reference: values of the user's own model by parameter key; they distinguish a changed value from
            missing physics.
        accepted: the accepted model that these values are from, with its covariance.
        measured: the searched recordings before ``model.prepare``, for the checks of the data.
        progress: is called with a line of text at each stage.

    Returns:
        The answer; without a search where the data are at fault, too short, not excited or where the user
        ended it early.
    """
    began = time.perf_counter()
    data = prepare_data(model, searched, held_out, reference)
    progress(f"fitting the baseline: {', '.join(listed(baseline))}")
    terms = [term.key for term in terms_named(model, baseline)]
    data, base, ended_early = fit_baseline_and_noise(data, terms)
    record = data.search if measured is None else measured
    faults = detect_all_faults(model, record)
    try:
        refusal = _refuse_search(data, base, record, faults, ended_early)
    except EndedEarly:
        refusal, ended_early = ENDED_BEFORE_SEARCH, True
    if refusal is not None:
        accept()  # the result is there, and stating it takes no time
        answer = _answer_without_search(data, base, *refusal, faults, heldout_is_test, began)
        return replace(answer, complete=not ended_early)
    search = partial(
        search_with_sizes, terms=terms, reference=reference, accepted=accepted, progress=progress
    )
    conclusion = _conclude(data, search(data, base), search, progress)
    answer = _answer(data, conclusion, accepted, reference)
    return replace(
        answer,
        faults=faults,
        data="test" if heldout_is_test else "heldout",
        seconds=time.perf_counter() - began,
    )


def _answer(
    data: Data, conclusion: Conclusion, accepted: Accepted | None, reference: Mapping[str, float] | None
) -> Diagnosis:
    """The answer of a search, without faults of the data and duration."""
    model, result = data.model, conclusion.result
    curves, claims = sort_by_heldout_gain(conclusion.curves), conclusion.claims_together
    complete, held_out_fit = result.complete, None
    try:
        held_out_fit = refit_to_held_out(conclusion)
    except EndedEarly:
        complete = False
    accept()  # stating the result takes no time
    # what a curve may stand for is not excluded by the terms beside it
    absent = absent_effects(conclusion.curves[-1].fit if conclusion.curves else result.final)
    excluded, unseen = exclusions(absent, result.possible)
    final, scale = final_table(conclusion, accepted, absent, held_out_fit)
    changed = _changes(final, reference, accepted)
    verdict = _verdict(conclusion, changed)
    test, before, after = conclusion.data.test, conclusion.before, conclusion.after
    wider, shorter = test is not data.test, conclusion.on_shorter_windows
    return Diagnosis(
        verdict=verdict,
        faults=(),
        p_value=_baseline_p_value(conclusion, verdict),
        p_value_method="tail_extrapolated",
        p_value_floor=0.0,
        baseline_terms=result.baseline.terms,
        baseline=table_of(result.baseline).rows,
        changed=changed,
        collapsed=result.collapsed,
        location=statements.location(result, before, after, test, curves, augmented=wider),
        missing=(
            *(statements.missing_term(model, step, result, final, claims) for step in result.missing),
            *(statements.missing_curve(curve, claims) for curve in curves),
        ),
        rivals=tuple(statements.rival_term(model, rival, claims) for rival in result.rivals),
        undecided=(*statements.undecided_terms(result), *unseen, *statements.unobservable_terms(model)),
        excluded=excluded,
        data="heldout",
        held_out=test,
        before=with_forces(before, model, result.baseline.theta, test, conclusion.sigma),
        after=with_forces(after, *conclusion.accepted, test, conclusion.sigma),
        final_terms=result.final.terms,
        final=final,
        baseline_fit=result.baseline,
        final_fit=result.final,
        curve=statements.curve_entry(curves[0]) if curves else None,
        further_curves=tuple(statements.curve_entry(curve) for curve in curves[1:]),
        seconds=0.0,
        shorter=shorter,
        wider=wider,
        complete=complete,
        scale_factor=scale,
        remainder=find_remainder(
            _labels(result, curves), *conclusion.accepted, test, *(shorter or (before, after))
        ),
    )


def _refuse_search(
    data: Data, base: Fitted, measured: Record, faults: tuple[Fault, ...], ended_early: bool
) -> tuple[str, str] | None:
    """Verdict and reason where the data cannot be searched; None where they can."""
    if not assess_usability(measured, faults).is_usable:
        return "data_fault", "the data are at fault"
    if not is_driven(data.search):
        return "not_decidable", "the input never changes"
    # a rig that hardly moves shows little; an error beyond the noise is searched unless nothing moves at all
    least = MIN_STD_IN_NOISE if leaves_only_noise(data, base) else NOISE_FLOOR_FACTOR
    at_rest = why_at_rest(data.search, data.sigma, least)
    if at_rest is not None:
        return "not_decidable", at_rest
    duration, horizon = data.search.duration, data.model.horizon
    if data.model.state_names and duration < horizon:
        reason = f"too short: {duration:.3g} s were searched, and what a model of this rig lacks takes "
        return "not_decidable", reason + f"{horizon:.3g} s to show; record longer, or give another to test on"
    if ended_early:
        return ENDED_BEFORE_SEARCH
    return None


def _labels(result: SearchResult, curves: Sequence[ForceCurve]) -> list[str]:
    """Labels of the missing effects: keys of terms, and the coordinates of curves."""
    over = [f"a force over {curve.depends_on[0]}" for curve in curves]
    return [*(step.terms[0] for step in result.missing), *over]


def _conclude(
    data: Data,
    result: SearchResult,
    search: Callable[[Data, Fitted], SearchResult],
    progress: Callable[[str], None],
) -> Conclusion:
    """Conclude a diagnosis after an augmented search; if the user ends it early, after the first search."""
    try:
        if result.complete:
            data, result, rms = augmented_search(data, result, search, progress)
            # the model of the final fit has the bounds of collapsed sizes
            data = replace(data, model=result.final.problem.model)
            return conclude(data, result, rms, progress)
    except EndedEarly:
        accept()
    result = replace(result, complete=False)
    data = replace(data, model=result.final.problem.model)
    return conclude(data, result, residual_rms(data, result.final), progress)


def _baseline_p_value(conclusion: Conclusion, verdict: str, alpha: float = VERDICT_ALPHA) -> float:
    """p value that the baseline suffices: that of the first addition, a term or a curve.

    Without an addition it is that of noise as large as the residuals, by χ². Where the verdict is no
    mismatch it is at least the level of search and held-out data combined, which they did not reach.
    """
    result, curves = conclusion.result, conclusion.curves
    if result.missing:
        return result.p_value
    if curves:
        return float(np.exp(min(0.5 * curves[0].evidence.delta_bic, 0.0)))
    if verdict != "unexplained_mismatch":
        return max(result.p_value, COMBINED_ALPHA)
    effective, excess = effective_samples(result.final), max(result.final.noise, conclusion.before.excess)
    # collapsed sizes differ from their nominal values by more than any error of these
    upper = alpha if result.collapsed else 1.0
    return min(result.p_value, upper, float(stats.chi2.sf(effective * excess**2, effective)))


def _verdict(conclusion: Conclusion, changed: Sequence[Change]) -> str:
    """The verdict, as the JSON result names it."""
    if conclusion.result.missing or conclusion.curves:
        return "missing_physics"
    if conclusion.excess_remains and not conclusion.result.complete:
        return "not_decidable"  # a term that was not tried may explain it
    if conclusion.excess_remains or conclusion.result.collapsed or conclusion.result.doubtful:
        return "unexplained_mismatch"
    return "parameter_change" if changed else "no_mismatch"


def _changes(
    final: Sequence[Estimate],
    reference: Mapping[str, float] | None,
    accepted: Accepted | None,
    alpha: float = VERDICT_ALPHA,
) -> tuple[Change, ...]:
    """Parameters that differ from the reference values at level ``alpha``, with Bonferroni's correction.

    The test takes the errors of both values; reference values of ``[nominal]`` have none. A parameter that
    either data set does not determine is never listed.
    """
    rows = {row.key: row for row in final if row.identifiable}
    compared = [(rows[name], value) for name, value in (reference or {}).items() if name in rows]
    changes = []
    for row, value in compared:
        error = float(np.hypot(row.std_error, accepted_error(accepted, row)))
        p_value = float(2.0 * stats.norm.sf(abs(row.value - value) / error))
        if p_value * len(compared) < alpha:
            change = Change(row.name, row.joint, value, row.value, row.unit, row.ci99, p_value, row.recording)
            changes.append(change)
    return tuple(changes)


def _answer_without_search(
    data: Data,
    base: Fitted,
    verdict: str,
    reason: str,
    faults: tuple[Fault, ...],
    heldout_is_test: bool,
    began: float,
) -> Diagnosis:
    """The answer without a search; ``reason`` is why there was none."""
    baseline_score = score(data.model, base.theta, data.test, data.test_sigma)
    baseline_score = with_forces(baseline_score, data.model, base.theta, data.test, data.test_sigma)
    rows = table_of(base).rows
    return Diagnosis(
        verdict=verdict,
        faults=faults,
        p_value=1.0,
        p_value_method="tail_extrapolated",
        p_value_floor=0.0,
        baseline_terms=base.terms,
        baseline=rows,
        changed=(),
        location=None,
        missing=(),
        rivals=(),
        undecided=tuple(Undecided(*unkeyed(key), (), reason) for key in data.model.terms),
        excluded=(),
        data="test" if heldout_is_test else "heldout",
        held_out=data.test,
        before=baseline_score,
        after=baseline_score,
        final_terms=base.terms,
        final=rows,
        baseline_fit=base,
        final_fit=base,
        curve=None,
        seconds=time.perf_counter() - began,
    )
