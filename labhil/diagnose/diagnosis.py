"""The whole question: do model and recordings disagree, where, what is missing, is it better with it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy import stats

from labhil.diagnose import statements
from labhil.diagnose.accepted import Accepted, accepted_error
from labhil.diagnose.adequacy import residual_rms
from labhil.diagnose.answer import Change, Diagnosis, Undecided
from labhil.diagnose.augmented import augmented_search
from labhil.diagnose.begin import baseline_of, data_of, fit_baseline
from labhil.diagnose.collapsed import are_restored, bound_near_nominal, find_collapsed
from labhil.diagnose.conclude import Conclusion, conclude
from labhil.diagnose.discrepancy import absent_effects
from labhil.diagnose.evidence import effective_samples
from labhil.diagnose.final_table import final_table, on_held_out_of
from labhil.diagnose.force_curve import ForceCurve
from labhil.diagnose.intake import Fault, assess_usability
from labhil.diagnose.joint_curves import strongest
from labhil.diagnose.judge import TOGETHER, Data, is_far_likelier
from labhil.diagnose.load import with_load
from labhil.diagnose.minor import drop_minor_terms
from labhil.diagnose.refit import on_windows
from labhil.diagnose.remainder import find_remainder
from labhil.diagnose.search_result import SearchResult
from labhil.diagnose.structures.stages import search_structures
from labhil.diagnose.timing import detect_all_faults
from labhil.ending import EndedEarly, accept
from labhil.identify.fitted import Fitted
from labhil.identify.score import score, with_forces
from labhil.identify.statistics import Estimate
from labhil.identify.table import table_of
from labhil.physics.model import Model, Record, terms_named
from labhil.physics.terms import unkeyed

FALSE_ALARM = 5e-4


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
    """Find what ``baseline`` lacks on ``searched``, judged on ``held_out``.

    ``reference`` are values of the user's own simulation by parameter name; they distinguish a changed value
    from missing physics; ``accepted`` is the model that they are of, with its covariance, where there is one.
    ``measured`` is the searched record before the model prepared it: faults of the data are looked for there.
    """
    began = time.perf_counter()
    data = data_of(model, searched, held_out, reference)
    progress(f"fitting the baseline: {', '.join(baseline)}")
    terms = [term.key for term in terms_named(model, baseline)]
    data, base, ended_early = baseline_of(data, terms)
    record = data.search if measured is None else measured
    faults = detect_all_faults(model, record)
    refusal = _refuse_search(data, record, faults, ended_early)
    if refusal is not None:
        accept()  # the result is there, and stating it takes no time
        answer = _answer_without_search(data, base, *refusal, faults, heldout_is_test, began)
        return replace(answer, complete=not ended_early)
    search = partial(_search, terms=terms, reference=reference, accepted=accepted, progress=progress)
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
    """The answer of a search in ``data``, but for faults of the data and the time that it took."""
    model, result = data.model, conclusion.result
    curves, doubts = strongest(conclusion.curves), conclusion.doubts
    held_out_fit = on_held_out_of(conclusion)
    accept()  # stating the result takes no time
    absent = absent_effects(result.final)
    excluded, unseen = statements.exclusions(absent, result.possible)
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
        location=statements.location(result, before, after, test, curves, wider=wider),
        missing=(
            *(statements.missing(model, step, result, final, *doubts) for step in result.missing),
            *(statements.missing_curve(curve, *doubts) for curve in curves),
        ),
        rivals=tuple(statements.rival_term(model, rival, result, *doubts) for rival in result.rivals),
        undecided=(
            *statements.too_little(result),
            *statements.as_likely_as_not(result),
            *unseen,
            *statements.unobservable(model),
        ),
        excluded=excluded,
        data="heldout",
        held_out=test,
        before=with_forces(before, model, result.baseline.theta, test, conclusion.sigma),
        after=with_forces(after, *conclusion.accepted, test, conclusion.sigma),
        final_terms=result.final.terms,
        final=final,
        baseline_fit=result.baseline,
        final_fit=result.final,
        curve=statements.curve(curves[0]) if curves else None,
        further_curves=tuple(statements.curve(curve) for curve in curves[1:]),
        seconds=0.0,
        shorter=shorter,
        wider=wider,
        complete=result.complete,
        scale_factor=scale,
        remainder=find_remainder(
            _labels(result, curves), *conclusion.accepted, test, *(shorter or (before, after))
        ),
    )


def _refuse_search(
    data: Data, measured: Record, faults: tuple[Fault, ...], ended_early: bool
) -> tuple[str, str] | None:
    """The verdict without a search, and why there is none; None where the data can be searched."""
    if not assess_usability(measured, faults).is_usable:
        return "data_fault", "the data are at fault"
    if not _is_excited(data.search, data.sigma):
        return "not_decidable", "neither input nor output moves beyond the noise"
    duration, horizon = data.search.duration, data.model.horizon
    if data.model.state_names and duration < horizon:
        reason = f"too short: {duration:.3g} s were searched, and what a model of this rig lacks takes "
        return "not_decidable", reason + f"{horizon:.3g} s to show; record longer, or give another to test on"
    if ended_early:
        return "not_decidable", "ended early, before anything was searched"
    return None


def _labels(result: SearchResult, curves: Sequence[ForceCurve]) -> list[str]:
    """The named effects: keys of terms, and what each curve is over."""
    over = [f"a force over {curve.depends_on[0]}" for curve in curves]
    return [*(step.terms[0] for step in result.missing), *over]


def _conclude(
    data: Data,
    result: SearchResult,
    search: Callable[[Data, Fitted], SearchResult],
    progress: Callable[[str], None],
) -> Conclusion:
    """Conclude a diagnosis; of one that is ended early, the result of its first search."""
    try:
        if result.complete:
            data, result, rms = augmented_search(data, result, search, progress)
            # sizes that were kept near nominal stay there
            data = replace(data, model=result.final.problem.model)
            return conclude(data, result, rms, progress)
    except EndedEarly:
        accept()
    result = replace(result, complete=False)
    data = replace(data, model=result.final.problem.model)
    return conclude(data, result, residual_rms(data, result.final), progress)


def _search(
    data: Data,
    base: Fitted,
    *,
    terms: Sequence[str],
    reference: Mapping[str, float] | None,
    accepted: Accepted | None,
    progress: Callable[[str], None],
) -> SearchResult:
    """Search once; with values of the user's own sizes, once more with these held."""
    result = search_structures(data, base, progress)
    try:
        if not result.complete:
            return result
        result = _with_credible_sizes(data, result, progress)
        result = with_load(data, result, accepted)
        sizes = _sizes(data.model, reference) if reference is not None and not result.errors else frozenset()
        if sizes:
            progress("the same with the sizes of the given model held")
            held = replace(data, held=sizes)
            held_result = search_structures(held, fit_baseline(held, terms), progress)
            result = (
                _likelier(result, held_result) if held_result.complete else replace(result, complete=False)
            )
        return drop_minor_terms(data, result)
    except EndedEarly:
        accept()
        return replace(result, complete=False)


def _with_credible_sizes(data: Data, result: SearchResult, progress: Callable[[str], None]) -> SearchResult:
    """The result; where the baseline's own sizes gave way, that of a search with these kept near nominal.

    The second result has to be far likelier on the searched data: a nominal value may be wrong. Where the
    first one restores the sizes there is nothing more to search.
    """
    lost = find_collapsed(data, result.baseline)
    if not lost:
        return result
    if result.missing and are_restored(lost, result.final):
        return replace(result, collapsed=lost)
    near = replace(data, model=bound_near_nominal(data.model, lost))
    baseline = fit_baseline(near, result.baseline.terms)
    # on the windows that the first search ended on
    short = fit_baseline(data, result.baseline.terms)
    if not is_far_likelier(short, baseline):
        return result
    progress(f"the same with {', '.join(size.key for size in lost)} near nominal")
    result = replace(result, collapsed=lost)
    credible = search_structures(near, baseline, progress)
    if not credible.complete:
        return replace(result, complete=False)
    if not credible.missing or not is_far_likelier(
        credible.final, _refit_like(near, result.final, credible.final)
    ):
        return result
    return replace(credible, collapsed=lost)


def _refit_like(data: Data, fitted: Fitted, like: Fitted) -> Fitted:
    """Refit on the windows of the fit ``like``."""
    data_like = replace(data, model=fitted.problem.model, window=like.window)
    return on_windows(data_like, fitted)


def _sizes(model: Model, reference: Mapping[str, float]) -> frozenset[str]:
    """The rig's own sizes that the user's simulation states."""
    return frozenset(p.key for p in model.parameters if p.term is None and p.key in reference)


def _likelier(free: SearchResult, held: SearchResult) -> SearchResult:
    """The better of two searches by BIC on the search data.

    Refitted sizes may absorb what is missing: a load at the flange is a change of many inertias. Held ones
    would have missing physics make up for a size that has changed: that account needs very strong evidence.
    """
    return held if is_far_likelier(held.final, free.final) else free


def _is_excited(record: Record, sigma: np.ndarray) -> bool:
    """Whether some output moves beyond its noise and the input moves at all."""
    return any(
        bool((np.std(part.outputs, axis=0) > 5.0 * sigma).any() and np.ptp(part.inputs, axis=0).any())
        for part in record.recordings()
    )


def _baseline_p_value(conclusion: Conclusion, verdict: str) -> float:
    """The p value that the baseline suffices: of the first addition, be it a term or a curve.

    Without an addition, that of noise as large as the residuals; and where these are no mismatch, searched
    and held-out data together have not reached the level of one.
    """
    result, curves = conclusion.result, conclusion.curves
    if result.missing:
        return result.p_value
    if curves:
        return float(np.exp(min(0.5 * curves[0].evidence.delta_bic, 0.0)))
    if verdict != "unexplained_mismatch":
        return max(result.p_value, TOGETHER)
    effective, excess = effective_samples(result.final), max(result.final.noise, conclusion.before.excess)
    # sizes that gave way are certain to differ from what is known of them
    least = FALSE_ALARM if result.collapsed else 1.0
    return min(result.p_value, least, float(stats.chi2.sf(effective * excess**2, effective)))


def _verdict(conclusion: Conclusion, changed: Sequence[Change]) -> str:
    if conclusion.result.missing or conclusion.curves:
        return "missing_physics"
    if conclusion.excess_remains and not conclusion.result.complete:
        return "not_decidable"  # its explanation may be among the terms that were not tried
    if conclusion.excess_remains or conclusion.result.collapsed:
        return "unexplained_mismatch"
    return "parameter_change" if changed else "no_mismatch"


def _changes(
    final: Sequence[Estimate], reference: Mapping[str, float] | None, accepted: Accepted | None
) -> tuple[Change, ...]:
    """Reference values that the refitted model contradicts at the level of the verdict.

    The difference is held against the errors of both values. Values of ``[nominal]`` have none: they are what
    a simulation has. Nothing is claimed of a value that these data, or the accepted model's, do not know.
    """
    rows = {row.key: row for row in final if row.identifiable}
    compared = [(rows[name], value) for name, value in (reference or {}).items() if name in rows]
    changes = []
    for row, value in compared:
        error = float(np.hypot(row.std_error, accepted_error(accepted, row)))
        p_value = float(2.0 * stats.norm.sf(abs(row.value - value) / error))
        if p_value * len(compared) < FALSE_ALARM:
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
    """State a verdict without a search, and why there was none."""
    marks = score(data.model, base.theta, data.test, data.test_sigma)
    marks = with_forces(marks, data.model, base.theta, data.test, data.test_sigma)
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
        before=marks,
        after=marks,
        final_terms=base.terms,
        final=rows,
        baseline_fit=base,
        final_fit=base,
        curve=None,
        seconds=time.perf_counter() - began,
    )
