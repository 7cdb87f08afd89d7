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
from labhil.diagnose.collapsed import brought_back, given_way, kept_near
from labhil.diagnose.conclude import Concluded, conclude
from labhil.diagnose.discrepancy import absent_effects
from labhil.diagnose.evidence import effective_samples
from labhil.diagnose.final_table import final_table, on_held_out_of
from labhil.diagnose.force_curve import ForceCurve
from labhil.diagnose.intake import Fault, usable
from labhil.diagnose.joint_curves import strongest
from labhil.diagnose.judge import TOGETHER, Data, far_likelier
from labhil.diagnose.load import with_load
from labhil.diagnose.minor import without_minor
from labhil.diagnose.refit import on_windows
from labhil.diagnose.remainder import find_remainder
from labhil.diagnose.search_result import SearchResult
from labhil.diagnose.structures.stages import search_structures
from labhil.diagnose.timing import all_faults
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

    ``reference`` are values of the user's own simulation by parameter name; with them a changed
    value can be told from missing physics; ``accepted`` is the model that they are of, with its covariance,
    where there is one. ``measured`` is what was searched before the model prepared it:
    there faults of the data are looked for.
    """
    began = time.perf_counter()
    data = data_of(model, searched, held_out, reference)
    progress(f"fitting the baseline: {', '.join(baseline)}")
    terms = [term.key for term in terms_named(model, baseline)]
    data, base, ended_early = baseline_of(data, terms)
    whole = data.search if measured is None else measured
    faults = all_faults(model, whole)
    refused = _refused(data, whole, faults, ended_early)
    if refused is not None:
        accept()  # the result is there, and saying it takes no time
        stated = _unsearched(data, base, *refused, faults, heldout_is_test, began)
        return replace(stated, complete=not ended_early)
    look = partial(_found, terms=terms, reference=reference, accepted=accepted, progress=progress)
    end = _concluded(data, look(data, base), look, progress)
    answer = _answer(data, end, accepted, reference)
    return replace(
        answer,
        faults=faults,
        data="test" if heldout_is_test else "heldout",
        seconds=time.perf_counter() - began,
    )


def _answer(
    data: Data, end: Concluded, accepted: Accepted | None, reference: Mapping[str, float] | None
) -> Diagnosis:
    """What the end of a search in ``data`` says, but for faults of the data and the time that it took."""
    model, found, told, claimed = data.model, end.found, strongest(end.curves), end.doubts
    again = on_held_out_of(end)
    accept()  # stating what was found takes no time
    absent = absent_effects(found.final)
    excluded, unseen = statements.exclusions(absent, found.possible)
    final, scale = final_table(end, accepted, absent, again)
    changed = _changes(final, reference, accepted)
    verdict = _verdict(end, changed)
    wider = end.data.test is not data.test
    shorter = end.on_shorter_windows
    return Diagnosis(
        verdict=verdict,
        faults=(),
        p_value=_suffices(end, verdict),
        p_value_method="tail_extrapolated",
        p_value_floor=0.0,
        baseline_terms=found.baseline.terms,
        baseline=table_of(found.baseline).rows,
        changed=changed,
        collapsed=found.collapsed,
        location=statements.location(found, end.before, end.after, end.data.test, told, wider=wider),
        missing=(
            *(statements.missing(model, step, found, final, *claimed) for step in found.missing),
            *(statements.unnamed(curve, *claimed) for curve in told),
        ),
        rivals=tuple(statements.rival_term(model, rival, found, *claimed) for rival in found.rivals),
        undecided=(
            *statements.too_little(found),
            *statements.as_likely_as_not(found),
            *unseen,
            *statements.undecided(model),
        ),
        excluded=excluded,
        data="heldout",
        held_out=end.data.test,
        before=with_forces(end.before, model, found.baseline.theta, end.data.test, end.sigma),
        after=with_forces(end.after, *end.accepted, end.data.test, end.sigma),
        final_terms=found.final.terms,
        final=final,
        baseline_fit=found.baseline,
        final_fit=found.final,
        curve=statements.curve(told[0]) if told else None,
        further_curves=tuple(statements.curve(curve) for curve in told[1:]),
        seconds=0.0,
        shorter=shorter,
        wider=wider,
        complete=found.complete,
        scale_factor=scale,
        remainder=find_remainder(
            _names(found, told), *end.accepted, end.data.test, *(shorter or (end.before, end.after))
        ),
    )


def _refused(
    data: Data, measured: Record, faults: tuple[Fault, ...], ended_early: bool
) -> tuple[str, str] | None:
    """The verdict without a search, and why there is none; None where the data can be searched."""
    if not usable(measured, faults).fit:
        return "data_fault", "the data are at fault"
    if not _excited(data.search, data.sigma):
        return "not_decidable", "neither input nor output moves beyond the noise"
    duration, horizon = data.search.duration, data.model.horizon
    if data.model.state_names and duration < horizon:
        reason = f"too short: {duration:.3g} s were searched, and what a model of this rig lacks takes "
        return "not_decidable", reason + f"{horizon:.3g} s to show; record longer, or give another to test on"
    if ended_early:
        return "not_decidable", "ended early, before anything was searched"
    return None


def _names(found: SearchResult, curves: Sequence[ForceCurve]) -> list[str]:
    """What was found: keys of terms, and what each curve is over."""
    over = [f"a force over {curve.depends_on[0]}" for curve in curves]
    return [*(step.terms[0] for step in found.missing), *over]


def _concluded(
    data: Data,
    found: SearchResult,
    look: Callable[[Data, Fitted], SearchResult],
    progress: Callable[[str], None],
) -> Concluded:
    """The end of a diagnosis; of one that is ended early, what its first search found."""
    try:
        if found.complete:
            data, found, left = augmented_search(data, found, look, progress)
            # sizes that were kept near nominal stay there
            data = replace(data, model=found.final.problem.model)
            return conclude(data, found, left, progress)
    except EndedEarly:
        accept()
    found = replace(found, complete=False)
    data = replace(data, model=found.final.problem.model)
    return conclude(data, found, residual_rms(data, found.final), progress)


def _found(
    data: Data,
    base: Fitted,
    *,
    terms: Sequence[str],
    reference: Mapping[str, float] | None,
    accepted: Accepted | None,
    progress: Callable[[str], None],
) -> SearchResult:
    """Search once; with values of the user's own sizes, once more with these held."""
    found = search_structures(data, base, progress)
    try:
        if not found.complete:
            return found
        found = _with_credible_sizes(data, found, progress)
        found = with_load(data, found, accepted)
        sizes = _sizes(data.model, reference) if reference is not None and not found.errors else frozenset()
        if sizes:
            progress("the same with the sizes of the given model held")
            held = replace(data, held=sizes)
            again = search_structures(held, fit_baseline(held, terms), progress)
            found = _simpler(found, again) if again.complete else replace(found, complete=False)
        return without_minor(data, found)
    except EndedEarly:
        accept()
        return replace(found, complete=False)


def _with_credible_sizes(data: Data, found: SearchResult, progress: Callable[[str], None]) -> SearchResult:
    """What was found; where the baseline's own sizes gave way, once more with these kept near nominal.

    The second answer has to be far likelier on the searched data: a nominal value may be wrong. Where what
    was found brings them back there is nothing more to ask.
    """
    lost = given_way(data, found.baseline)
    if not lost:
        return found
    if found.missing and brought_back(lost, found.final):
        return replace(found, collapsed=lost)
    near = replace(data, model=kept_near(data.model, lost))
    baseline = fit_baseline(near, found.baseline.terms)
    # on the windows that the first search ended on
    short = fit_baseline(data, found.baseline.terms)
    if not far_likelier(short, baseline):
        return found
    progress(f"the same with {', '.join(size.key for size in lost)} near nominal")
    found = replace(found, collapsed=lost)
    credible = search_structures(near, baseline, progress)
    if not credible.complete:
        return replace(found, complete=False)
    if not credible.missing or not far_likelier(
        credible.final, _onward_like(near, found.final, credible.final)
    ):
        return found
    return replace(credible, collapsed=lost)


def _onward_like(data: Data, fitted: Fitted, like: Fitted) -> Fitted:
    """The one fit on the windows of the other."""
    own = replace(data, model=fitted.problem.model, window=like.window)
    return on_windows(own, fitted)


def _sizes(model: Model, reference: Mapping[str, float]) -> frozenset[str]:
    """The rig's own sizes that the user's simulation states."""
    return frozenset(p.key for p in model.parameters if p.term is None and p.key in reference)


def _simpler(free: SearchResult, held: SearchResult) -> SearchResult:
    """The better of two searches by BIC on the search data.

    Refitted sizes may absorb what is missing: a load at the flange is a change of many inertias. Held ones
    would have missing physics make up for a size that has changed: that account needs very strong evidence.
    """
    return held if far_likelier(held.final, free.final) else free


def _excited(record: Record, sigma: np.ndarray) -> bool:
    """Whether some output moves beyond its noise and the input moves at all."""
    return any(
        bool((np.std(each.outputs, axis=0) > 5.0 * sigma).any() and np.ptp(each.inputs, axis=0).any())
        for each in record.recordings()
    )


def _suffices(end: Concluded, verdict: str) -> float:
    """The p value that the baseline suffices: of what was added to it first, be it named or a curve.

    Where nothing was, of the noise that would be as large as what is left; and where that is no mismatch
    searched and held-out data together have not reached the level of one.
    """
    found, curves = end.found, end.curves
    if found.missing:
        return found.p_value
    if curves:
        return float(np.exp(min(0.5 * curves[0].evidence.delta_bic, 0.0)))
    if verdict != "unexplained_mismatch":
        return max(found.p_value, TOGETHER)
    effective, excess = effective_samples(found.final), max(found.final.noise, end.before.excess)
    # of the sizes that gave way it is certain that they are not what is known of them
    least = FALSE_ALARM if found.collapsed else 1.0
    return min(found.p_value, least, float(stats.chi2.sf(effective * excess**2, effective)))


def _verdict(end: Concluded, changed: Sequence[Change]) -> str:
    if end.found.missing or end.curves:
        return "missing_physics"
    if end.more and not end.found.complete:
        return "not_decidable"  # what explains it may be among what was not tried
    if end.more or end.found.collapsed:
        return "unexplained_mismatch"
    return "parameter_change" if changed else "no_mismatch"


def _changes(
    final: Sequence[Estimate], reference: Mapping[str, float] | None, accepted: Accepted | None
) -> tuple[Change, ...]:
    """Reference values that the refitted model contradicts at the level of the verdict.

    The difference is held against the errors of both values. Values of ``[nominal]`` have none: they are what
    a simulation has. Of a value that these data, or the accepted model's, do not know nothing is claimed.
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


def _unsearched(
    data: Data,
    base: Fitted,
    verdict: str,
    reason: str,
    faults: tuple[Fault, ...],
    heldout_is_test: bool,
    began: float,
) -> Diagnosis:
    """An answer without a search, and why there was none."""
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
