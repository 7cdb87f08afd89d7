"""The whole question: do model and recordings disagree, where, what is missing, is it better with it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from labhil.diagnose import locate
from labhil.diagnose.answer import Change, Diagnosis, Excluded, Missing, RivalTerm, Undecided
from labhil.diagnose.contradiction import structure_p_value
from labhil.diagnose.evidence import bic, effective_samples
from labhil.diagnose.intake import Fault, usable
from labhil.diagnose.intake import faults as faults_of
from labhil.diagnose.search import Data, Found, Rival, Step, search
from labhil.identify.fitted import Fitted, climb, covariances, start_theta
from labhil.identify.noise import lasting_noise
from labhil.identify.score import Score, score
from labhil.identify.statistics import Estimate
from labhil.identify.table import table_of
from labhil.identify.windows import noise_of
from labhil.physics.model import Model, Record, index_of, terms_named
from labhil.physics.terms import keyed, unkeyed

SEARCH_WINDOW_IN_HORIZONS = 0.375
FIRST_WINDOW_IN_HORIZONS = 0.1875
FALSE_ALARM = 5e-4
UNEXPLAINED, SURELY_UNEXPLAINED = 1.5, 2.5
"""Errors above the noise floor that no noise makes: with residuals that go with the input, and without."""

LASTS = 1.1
"""Factor by which noise on short windows must exceed that of single samples to count."""


def diagnose(
    model: Model,
    searched: Record,
    held_out: Record,
    *,
    heldout_is_test: bool,
    baseline: Sequence[str],
    reference: Mapping[str, float] | None = None,
    measured: Record | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """Find what ``baseline`` lacks on ``searched``, judged on ``held_out``.

    ``reference`` are values of the user's own simulation by parameter name; with them a changed
    value can be told from missing physics. ``measured`` is what was searched before the model prepared it:
    there faults of the data are looked for.
    """
    began = time.perf_counter()
    sigma = noise_of(searched)
    window = SEARCH_WINDOW_IN_HORIZONS * model.horizon
    begin = start_theta(model, reference)
    data = Data(model, searched, held_out, sigma, noise_of(held_out), window, begin)
    progress(f"fitting the baseline: {', '.join(baseline)}")
    terms = [term.key for term in terms_named(model, baseline)]
    base = _fit_baseline(data, terms)
    data, base = _with_lasting_noise(data, base)
    whole = searched if measured is None else measured
    faults = faults_of(whole, noise_of(whole))
    if not usable(whole, faults).fit:
        reason = "the data are at fault"
        return _unsearched(data, base, "data_fault", reason, faults, heldout_is_test, began)
    if not _excited(searched, sigma):
        reason = "neither input nor output moves beyond the noise"
        return _unsearched(data, base, "not_decidable", reason, faults, heldout_is_test, began)
    found = search(data, base, progress)
    if reference is not None and (sizes := _sizes(model, reference)):
        progress("the same with the sizes of the given model held")
        held = replace(data, held=sizes)
        found = _simpler(found, search(held, _fit_baseline(held, terms), progress))
    progress("scores, intervals and exclusion limits")
    base = found.baseline
    # the same windows and the same noise before and after
    horizon = model.horizon_at(found.final.theta)
    noise = lasting_noise(model, found.final.theta, held_out, noise_of(held_out))
    before = score(model, base.theta, held_out, noise, horizon)
    after = score(model, found.final.theta, held_out, noise, horizon) if found.missing else before
    final = table_of(found.final).rows
    changed = _changes(model, base, found, reference)
    return Diagnosis(
        verdict=_verdict(found, changed, after),
        faults=faults,
        p_value=found.p_value,
        p_value_method="tail_extrapolated",
        p_value_floor=0.0,
        baseline_terms=base.terms,
        baseline=table_of(base).rows,
        changed=changed,
        location=_location(found, before, after, held_out),
        missing=tuple(_missing(model, step, found, final) for step in found.missing),
        rivals=tuple(_rival(model, rival, found) for rival in found.rivals),
        undecided=_undecided(model),
        excluded=_excluded(data, found),
        data="test" if heldout_is_test else "heldout",
        before=before,
        after=after,
        final_terms=found.final.terms,
        final=final,
        baseline_fit=base,
        final_fit=found.final,
        seconds=time.perf_counter() - began,
    )


def _fit_baseline(data: Data, terms: Sequence[str]) -> Fitted:
    """The baseline on the windows of the search, by way of shorter ones."""
    lengths = [FIRST_WINDOW_IN_HORIZONS * data.model.horizon, data.window]
    model, record, sigma, begin = data.model, data.search, data.sigma, data.begin
    return climb(model, record, terms, lengths, sigma, start=begin, fresh=terms, held=data.held)[-1]


def _with_lasting_noise(data: Data, base: Fitted) -> tuple[Data, Fitted]:
    """The data with noise as the baseline leaves it on short windows, and the baseline in units of that."""
    seen = lasting_noise(data.model, base.theta, data.search, data.sigma)
    tested = lasting_noise(data.model, base.theta, data.test, data.test_sigma)
    if np.all(seen < LASTS * data.sigma):
        return replace(data, test_sigma=tested), base
    data = replace(data, sigma=seen, test_sigma=tested)
    return data, _fit_baseline(replace(data, begin=base.theta), base.terms)


def _sizes(model: Model, reference: Mapping[str, float]) -> frozenset[str]:
    """The rig's own sizes that the user's simulation states."""
    return frozenset(p.key for p in model.parameters if p.term is None and p.key in reference)


def _simpler(free: Found, held: Found) -> Found:
    """The better of two searches by BIC on the search data.

    Refitted sizes may absorb what is missing: a load at the flange is a change of many inertias. Held ones
    would have missing physics make up for a size that has changed. The simpler account of the data is right.
    """
    effective = min(effective_samples(free.final), effective_samples(held.final))
    return min(free, held, key=lambda found: bic(found.final, effective))


def _excited(record: Record, sigma: np.ndarray) -> bool:
    """Whether outputs move beyond their noise and the input moves at all."""
    moved = np.std(record.outputs, axis=0) > 5.0 * sigma
    return bool(moved.all() and np.std(record.inputs[:, 0]) > 0)


def _verdict(found: Found, changed: tuple[Change, ...], after: Score) -> str:
    if found.missing:
        return "missing_physics"
    excess = after.rmse / after.noise_floor
    if excess > SURELY_UNEXPLAINED or (excess > UNEXPLAINED and _structured(found.final)):
        return "unexplained_mismatch"
    return "parameter_change" if changed else "no_mismatch"


def _structured(final: Fitted) -> bool:
    """Whether what is left on the search data goes with the input's recent past."""
    _, _, jacobian = covariances(final)
    solution = final.solution
    p_values = structure_p_value(final.problem, solution.point, solution.residuals, jacobian)
    return len(p_values) * min(p_values) < FALSE_ALARM


def _changes(
    model: Model, base: Fitted, found: Found, reference: Mapping[str, float] | None
) -> tuple[Change, ...]:
    """Reference values that the refitted model contradicts at the level of the verdict."""
    if not reference:
        return ()
    rows = {keyed(row.name, row.joint): row for row in table_of(found.final).rows}
    compared = [(rows[name], value) for name, value in reference.items() if name in rows]
    changes = []
    for row, value in compared:
        p_value = float(2.0 * stats.norm.sf(abs(row.value - value) / max(row.std_error, 1e-300)))
        if p_value * len(compared) < FALSE_ALARM:
            changes.append(Change(row.name, row.joint, value, row.value, row.unit, row.ci99, p_value))
    return tuple(changes)


def _location(found: Found, before: Score, after: Score, held_out: Record) -> locate.Location | None:
    if not found.missing:
        return None
    model = found.final.problem.model
    strongest = model.terms[found.missing[0].terms[0]]
    shares = {step.terms[0]: locate.contribution(found.final, step.terms[0]) for step in found.missing}
    regimes = {term: share.regimes() for term, share in shares.items()}
    channel, joint = _channel(before, after)
    return locate.Location(
        channel=channel,
        joint=joint,
        enters=strongest.enters.value,
        times=locate.times(before, after, held_out.t),
        regimes=tuple(regime for found in regimes.values() for regime in found),
        statement=locate.statement(keyed(channel, joint), strongest, regimes),
    )


def _channel(before: Score, after: Score) -> tuple[str, int | None]:
    """The output that gains most, in units of its noise floor."""
    gains = [(b.mse - a.mse) / a.noise_floor**2 for b, a in zip(before.channels, after.channels, strict=True)]
    most = before.channels[int(np.argmax(gains))]
    return most.channel, most.joint


def _missing(model: Model, step: Step, found: Found, final: list[Estimate]) -> Missing:
    (key,) = step.terms
    term = model.terms[key]
    rows = [row for row in final if (row.term, row.joint) == (term.name, term.joint)]
    sizes = ", ".join(f"{row.name.partition('.')[2]} = {row.value:.4g} {row.unit}" for row in rows)
    rivals = [r for r in found.rivals if r.instead_of == key]
    at = "" if term.joint is None else f" of joint {term.joint}"
    return Missing(
        term=term.name,
        joint=term.joint,
        statement=f"The model leaves out {term.statement}{at}: {sizes}.",
        equation=term.equation,
        probability=_probability(0.0, rivals),
        parameters=rows,
        evidence=step.evidence,
    )


def _probability(delta_bic: float, rivals: Sequence[Rival]) -> float:
    """exp(−ΔBIC/2) of one among all that stand for the same term, with the term itself at zero."""
    total = 1.0 + sum(np.exp(-0.5 * r.delta_bic) for r in rivals)
    return float(np.exp(-0.5 * delta_bic) / total)


def _rival(model: Model, rival: Rival, found: Found) -> RivalTerm:
    same = [r for r in found.rivals if r.instead_of == rival.instead_of]
    term = model.terms[rival.term]
    return RivalTerm(
        term=term.name,
        instead_of=rival.instead_of,
        joint=term.joint,
        probability=_probability(rival.delta_bic, same),
        delta_bic=rival.delta_bic,
        distinguishable=False,
        experiment=f"excite with {term.revealed_by}",
    )


def _undecided(model: Model) -> tuple[Undecided, ...]:
    """Terms of which no recording of this rig can speak, with the reason."""
    return tuple(Undecided(*unkeyed(key), (), reason) for key, reason in model.never_seen.items())


def _excluded(data: Data, found: Found) -> tuple[Excluded, ...]:
    """Linearised estimate of every absent term beside the final model, ± its 99 % error."""
    problem, solution = found.final.problem, found.final.solution
    lin = problem.linearise(solution.point, solution.residuals)
    own = problem.project(lin, lin.by_parameters)
    noise = found.final.noise
    limits = []
    for key, term in data.model.terms.items():
        if key in found.final.terms:
            continue
        parameter = next(p for p in term.parameters if not p.shape)
        column = _slope(found.final, parameter.key)
        column = problem.project(lin, column[:, None])[:, 0]
        basis, _ = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))
        column = column - basis @ (basis.T @ column)
        power = float(column @ column)
        if power <= 1e-12:
            continue
        value = -float(column @ solution.residuals) / power
        error = noise / np.sqrt(power)
        largest = (abs(value) + stats.norm.ppf(0.995) * error) * parameter.scale
        limits.append(Excluded(term.name, term.joint, float(largest), parameter.unit, 0.99))
    return tuple(limits)


def _slope(final: Fitted, key: str) -> np.ndarray:
    """Change of the residuals per scale of a parameter at neutral, from a small finite step."""
    model, problem = final.problem.model, final.problem
    parameter = next(p for p in model.parameters if p.key == key)
    step = 1e-2
    theta = final.theta.copy()
    theta[index_of(model.parameters)[key]] += step * parameter.scale
    simulated = model.simulate(theta, problem.record, problem.windows, final.solution.point.states)
    measured = problem.record.outputs[problem.windows.rows]
    residuals = ((simulated - measured) / problem.sigma).ravel()
    return np.asarray((residuals - final.solution.residuals) / step)


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
        seconds=time.perf_counter() - began,
    )
