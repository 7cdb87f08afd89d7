"""The whole question: do model and recordings disagree, where, what is missing, is it better with it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from labhil.diagnose import telling
from labhil.diagnose.accepted import Accepted
from labhil.diagnose.answer import Change, Diagnosis, Undecided
from labhil.diagnose.contradiction import structure_p_value
from labhil.diagnose.evidence import bic, effective_samples
from labhil.diagnose.found import Found
from labhil.diagnose.intake import Fault, faults_of, usable
from labhil.diagnose.judge import NEEDED_BIC, Data
from labhil.diagnose.load import with_load
from labhil.diagnose.search import search
from labhil.diagnose.unmodelled import Unmodelled, unmodelled
from labhil.identify.fitted import Fitted, climb, covariances, start_theta
from labhil.identify.noise import lasting_noise
from labhil.identify.score import Score, score, with_forces
from labhil.identify.statistics import Estimate, stated, with_error
from labhil.identify.table import table_of
from labhil.identify.windows import noise_of, told_apart
from labhil.physics.model import Model, Record, index_of, terms_named
from labhil.physics.terms import unkeyed
from labhil.signals import FloatArray

SEARCH_WINDOW_IN_HORIZONS = 0.375
FIRST_WINDOW_IN_HORIZONS = 0.1875
FALSE_ALARM = 5e-4
UNEXPLAINED, SURELY_UNEXPLAINED = 1.5, 2.5
"""Errors above the noise floor that no noise makes: with residuals that go with the input, and without."""

MISNAMED = 1.3
"""The same of terms that were found: the right ones leave noise, wrong ones stand in for a nameless force."""

LASTS = 1.1
"""Factor by which noise as the baseline leaves it must differ from that of single samples to count."""


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
    searched, held_out, sigma = data.search, data.test, data.sigma
    progress(f"fitting the baseline: {', '.join(baseline)}")
    terms = [term.key for term in terms_named(model, baseline)]
    base = fit_baseline(data, terms)
    data, base = _with_lasting_noise(data, base)
    whole = searched if measured is None else measured
    faults = faults_of(whole)
    if not usable(whole, faults).fit:
        reason = "the data are at fault"
        return _unsearched(data, base, "data_fault", reason, faults, heldout_is_test, began)
    if not _excited(searched, sigma):
        reason = "neither input nor output moves beyond the noise"
        return _unsearched(data, base, "not_decidable", reason, faults, heldout_is_test, began)
    found = with_load(data, search(data, base, progress), accepted)
    sizes = _sizes(model, reference) if reference is not None and not found.errors else frozenset()
    if sizes:
        progress("the same with the sizes of the given model held")
        held = replace(data, held=sizes)
        found = _simpler(found, search(held, fit_baseline(held, terms), progress))
    progress("scores, intervals and exclusion limits")
    base = found.baseline
    # the same windows and the same noise before and after
    horizon = model.horizon_at(found.final.theta)
    noise = lasting_noise(model, found.final.theta, held_out, noise_of(held_out))
    before = score(model, base.theta, held_out, noise, horizon)
    after = score(model, found.final.theta, held_out, noise, horizon) if found.missing else before
    unexplained = _unexplained(found, after)
    found, beyond = _beyond(data, found) if unexplained else (found, None)
    after = after if beyond is None else score(*_accepted(model, found, beyond), held_out, noise, horizon)
    final = _rows(found) if beyond is None else beyond.rows
    changed = _changes(final, reference)
    return Diagnosis(
        verdict=_verdict(found, changed, beyond, unexplained),
        faults=faults,
        p_value=found.p_value,
        p_value_method="tail_extrapolated",
        p_value_floor=0.0,
        baseline_terms=base.terms,
        baseline=table_of(base).rows,
        changed=changed,
        location=telling.location(found, before, after, held_out, beyond),
        missing=(
            *(telling.missing(model, step, found, final) for step in found.missing),
            *(() if beyond is None else (telling.unnamed(beyond),)),
        ),
        rivals=tuple(telling.rival_term(model, rival, found) for rival in found.rivals),
        undecided=telling.undecided(model),
        excluded=telling.excluded(data, found),
        data="test" if heldout_is_test else "heldout",
        before=with_forces(before, model, base.theta, held_out, noise),
        after=with_forces(after, *_accepted(model, found, beyond), held_out, noise),
        final_terms=found.final.terms,
        final=final,
        baseline_fit=base,
        final_fit=found.final,
        curve=None if beyond is None else telling.curve(beyond),
        seconds=time.perf_counter() - began,
        shorter=_on_shorter_windows(data, found, before, after),
    )


def _on_shorter_windows(data: Data, found: Found, before: Score, after: Score) -> tuple[Score, Score] | None:
    """Scores on windows of the search, if the metric's are worse with what was found than without.

    Noise that drives the plant itself outgrows every model on long windows.
    """
    if not found.missing or after.rmse < before.rmse or not data.model.state_names:
        return None
    return data.judge(found.baseline.theta)[0], data.judge(found.final.theta)[0]


def _beyond(data: Data, found: Found) -> tuple[Found, Unmodelled | None]:
    """A force that no named term explains, and what was found without the terms that it makes needless.

    Where a curve is the answer, named terms may only have stood in for it.
    """
    beyond = _curve(data, found.final)
    if beyond is None or not found.missing:
        return found, beyond
    alone = _curve(data, found.baseline)
    effective = effective_samples(beyond.fit)
    if alone is None:
        return found, beyond
    marks = [bic(each.fit, effective, each.degrees) for each in (alone, beyond)]
    if marks[0] > marks[1]:
        return found, beyond
    return replace(found, final=found.baseline, missing=(), rivals=()), alone


def _curve(data: Data, final: Fitted) -> Unmodelled | None:
    """A force beside a fit, judged on windows as long as those of that fit."""
    rows = final.problem.windows
    length = float(data.search.t[rows.last[0] - 1] - data.search.t[rows.first[0]])
    return unmodelled(replace(data, window=length), final)


def _accepted(model: Model, found: Found, beyond: Unmodelled | None) -> tuple[Model, FloatArray]:
    """The model that is left, with its vector."""
    return (model, found.final.theta) if beyond is None else (beyond.model, beyond.fit.theta)


def data_of(
    model: Model, searched: Record, held_out: Record, reference: Mapping[str, float] | None = None
) -> Data:
    """What a search works on, its fits begun at ``reference`` where there is one."""
    searched, held_out = told_apart(model, searched), told_apart(model, held_out)
    window, begin = SEARCH_WINDOW_IN_HORIZONS * model.horizon, start_theta(model, reference)
    return Data(model, searched, held_out, noise_of(searched), noise_of(held_out), window, begin)


def fit_baseline(data: Data, terms: Sequence[str]) -> Fitted:
    """The baseline on the windows of the search, by way of shorter ones."""
    lengths = [FIRST_WINDOW_IN_HORIZONS * data.model.horizon, data.window]
    model, record, sigma, begin = data.model, data.search, data.sigma, data.begin
    return climb(model, record, terms, lengths, sigma, start=begin, fresh=terms, held=data.held)[-1]


def _with_lasting_noise(data: Data, base: Fitted) -> tuple[Data, Fitted]:
    """The data with noise as the baseline leaves it on short windows, and the baseline in units of that."""
    seen = lasting_noise(data.model, base.theta, data.search, data.sigma)
    tested = lasting_noise(data.model, base.theta, data.test, data.test_sigma)
    if np.all((seen < LASTS * data.sigma) & (LASTS * seen > data.sigma)):
        return replace(data, test_sigma=tested), base
    data = replace(data, sigma=seen, test_sigma=tested)
    return data, fit_baseline(replace(data, begin=base.theta), base.terms)


def _sizes(model: Model, reference: Mapping[str, float]) -> frozenset[str]:
    """The rig's own sizes that the user's simulation states."""
    return frozenset(p.key for p in model.parameters if p.term is None and p.key in reference)


def _simpler(free: Found, held: Found) -> Found:
    """The better of two searches by BIC on the search data.

    Refitted sizes may absorb what is missing: a load at the flange is a change of many inertias. Held ones
    would have missing physics make up for a size that has changed: that account needs very strong evidence.
    """
    effective = min(effective_samples(free.final), effective_samples(held.final))
    return held if bic(held.final, effective) - bic(free.final, effective) < NEEDED_BIC else free


def _excited(record: Record, sigma: np.ndarray) -> bool:
    """Whether outputs move beyond their noise and the input moves at all."""
    return any(
        bool((np.std(each.outputs, axis=0) > 5.0 * sigma).all() and np.std(each.inputs[:, 0]) > 0)
        for each in record.recordings()
    )


def _rows(found: Found) -> list[Estimate]:
    """The table of what is left, sizes that were held included, with errors that the fit cannot know."""
    fitted = found.final
    rows = table_of(fitted).rows
    there = {row.key for row in rows}
    held = [p for p in fitted.problem.model.parameters if p.term is None and p.key not in there]
    places = index_of(fitted.problem.model.parameters)
    values = np.array([fitted.theta[places[p.key]] for p in held])
    rows = stated(held, values, np.array([found.errors.get(p.key, 0.0) for p in held])) + rows
    return [with_error(row, found.errors.get(row.key, 0.0)) for row in rows]


def _verdict(found: Found, changed: tuple[Change, ...], beyond: Unmodelled | None, unexplained: bool) -> str:
    if found.missing or beyond is not None:
        return "missing_physics"
    if unexplained:
        return "unexplained_mismatch"
    return "parameter_change" if changed else "no_mismatch"


def _unexplained(found: Found, after: Score) -> bool:
    """Whether named terms leave more than noise; found ones are doubted sooner than the baseline."""
    excess = after.rmse / after.noise_floor
    if excess > (MISNAMED if found.missing else SURELY_UNEXPLAINED):
        return True
    return excess > UNEXPLAINED and _structured(found.final)


def _structured(final: Fitted) -> bool:
    """Whether what is left on the search data goes with the input's recent past."""
    _, _, jacobian = covariances(final)
    solution = final.solution
    p_values = structure_p_value(final.problem, solution.point, solution.residuals, jacobian)
    return len(p_values) * min(p_values) < FALSE_ALARM


def _changes(final: Sequence[Estimate], reference: Mapping[str, float] | None) -> tuple[Change, ...]:
    """Reference values that the refitted model contradicts at the level of the verdict."""
    if not reference:
        return ()
    rows = {row.key: row for row in final}
    compared = [(rows[name], value) for name, value in reference.items() if name in rows]
    changes = []
    for row, value in compared:
        p_value = float(2.0 * stats.norm.sf(abs(row.value - value) / max(row.std_error, 1e-300)))
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
        before=marks,
        after=marks,
        final_terms=base.terms,
        final=rows,
        baseline_fit=base,
        final_fit=base,
        curve=None,
        seconds=time.perf_counter() - began,
    )
