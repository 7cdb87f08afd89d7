"""Which terms are missing: screen by projection, confirm by refitting, judge on held-out data.

Forward steps add the best candidate, a swap replaces a term by a rival that explains the search data
better, a backward step removes what is no longer needed. Nothing stays that held-out data do not
support.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from labhil.diagnose.evidence import Evidence, bic, effective_samples, heldout_gain, search_p_value
from labhil.identify.fit import Fitted, fit_terms
from labhil.identify.problem import Point, Problem
from labhil.identify.score import Score, score
from labhil.physics.model import Model, Record, index_of, starts_of, terms_named
from labhil.signals import FloatArray

Progress = Callable[[str], None]

CONFIRMED = 6
"""How many of the screened candidates are refitted at each step."""

NEEDED_BIC = -10.0
"""Very strong evidence on the search data, in the usual reading of BIC."""

STILL_NOISY = 1.15
"""Residuals this much above the noise say that something is still missing."""

WEIGHED = 2
"""How many rivals are tried in the place of each found term."""

HOPEFUL = 0.5
"""A rival that promises to explain less than this share of what a term's absence leaves is not tried."""

RIVAL_BIC = 10.0
"""A rival within this stays on the list: it is under five nats behind."""

ALPHA = 0.01
"""One-sided level of the held-out test that every step has to pass, on top of the search data."""

JUDGED_SHARE = 0.5
"""Judged windows are this share of the scored horizon: more of them, so that they can be counted."""


@dataclass(frozen=True, slots=True)
class Step:
    """One accepted addition with its evidence; ``p_search`` is corrected for all candidates looked at."""

    terms: tuple[str, ...]
    evidence: Evidence
    p_search: float


@dataclass(frozen=True, slots=True)
class Rival:
    """A term that would do about as well in the place of another."""

    term: str
    instead_of: str
    delta_bic: float


@dataclass(frozen=True, slots=True)
class Data:
    """What a search works on: search and test records with their noise, and the windows' length in s."""

    model: Model
    search: Record
    test: Record
    sigma: FloatArray
    test_sigma: FloatArray
    window: float

    def judge(self, theta: FloatArray) -> Score:
        """Score on held-out windows short enough to be counted."""
        return score(self.model, theta, self.test, self.test_sigma, JUDGED_SHARE * self.model.horizon)


@dataclass(frozen=True, slots=True)
class Found:
    """Where a search ended."""

    baseline: Fitted
    final: Fitted
    missing: tuple[Step, ...]
    rivals: tuple[Rival, ...]
    p_value: float
    looks: int


def search(data: Data, baseline: Fitted, progress: Progress) -> Found:
    """Look for missing terms, beginning at a fitted baseline."""
    current, p_value, looks = baseline, 1.0, len(candidates(data.model, baseline.terms))
    with ThreadPoolExecutor(os.cpu_count()) as executor:
        while True:
            groups = candidates(data.model, current.terms)
            progress(f"screening {len(groups)} candidates beside {', '.join(current.terms)}")
            accepted, trials = _forward(data, current, groups, looks, executor, progress)
            if current is baseline and trials:
                effective = effective_samples(trials[0].solution.residuals)
                p_value = search_p_value(baseline, trials[0], effective, looks)
            if accepted is None:
                break
            accepted = _refit(data, accepted, accepted.terms, (), thorough=True)
            current = _prune(data, accepted, set(baseline.terms), progress)
            progress(f"found {', '.join(t for t in current.terms if t not in baseline.terms)}")
        current, rivals = _swap(data, current, set(baseline.terms), executor, progress)
    kept = _steps_of(data, baseline, current, looks)
    rivals = tuple(r for r in rivals if r.instead_of in current.terms)
    return Found(baseline, current, kept, rivals, p_value, looks)


def _forward(
    data: Data,
    current: Fitted,
    groups: Sequence[tuple[str, ...]],
    looks: int,
    executor: Executor,
    progress: Progress,
) -> tuple[Fitted | None, list[Fitted]]:
    """The best supported addition, or None, and all that was refitted, best first.

    While the residuals are still above the noise the lower-ranked candidates get their turn too.
    """
    promises = list(executor.map(lambda group: promised(data, current, group), groups))
    ranked = [groups[i] for i in np.argsort(promises)[::-1]]
    seen: list[Fitted] = []
    while ranked:
        batch, ranked = ranked[:CONFIRMED], ranked[CONFIRMED:]
        progress(f"refitting {', '.join(' + '.join(group) for group in batch)}")
        trials = confirm(data, current, batch, executor)
        seen += trials
        accepted = _first_accepted(data, current, trials, looks)
        if accepted is not None or current.noise < STILL_NOISY:
            return accepted, trials
    return None, seen


def candidates(model: Model, present: Sequence[str]) -> list[tuple[str, ...]]:
    """Every absent term, together with those that it builds on (Stribeck friction on Coulomb friction)."""
    absent = [name for name in model.terms if name not in present]
    return [(*(t for t in model.terms[name].with_terms if t in absent), name) for name in absent]


def without(model: Model, terms: Sequence[str], term: str) -> tuple[str, ...]:
    """These terms less one and what builds on it."""
    return tuple(t for t in terms if t != term and term not in model.terms[t].with_terms)


def confirm(
    data: Data, current: Fitted, groups: Sequence[tuple[str, ...]], executor: Executor
) -> list[Fitted]:
    """Refit candidates, best first by BIC."""

    def refit(group: tuple[str, ...]) -> Fitted:
        return _refit(data, current, (*current.terms, *group), group)

    trials = list(executor.map(refit, groups))
    effective = min((effective_samples(t.solution.residuals) for t in trials), default=1.0)
    return sorted(trials, key=lambda trial: bic(trial, effective))


def promised(data: Data, current: Fitted, group: Sequence[str]) -> float:
    """Share of the squared residuals that a group could explain, by projection.

    Its columns are slopes at neutral for parameters that act there, secants to their starts for the
    rest; what the current model's own parameters and the windows' states explain is taken out first.
    A group of more parameters has to promise more.
    """
    problem, point = current.problem, current.solution.point
    residuals = current.solution.residuals
    lin = problem.linearise(point, residuals)
    own = problem.project(lin, np.column_stack([lin.by_parameters, residuals]))
    basis, target = _orthonormal(own[:, :-1]), own[:, -1]
    target = target - basis @ (basis.T @ target)
    total = float(target @ target)
    best = 0.0
    for columns in _columns(data, current, group):
        new = problem.project(lin, columns)
        new = _orthonormal(new - basis @ (basis.T @ new))
        best = max(best, float(np.sum((new.T @ target) ** 2)) / total if total > 0 else 0.0)
    cost = sum(len(data.model.terms[name].parameters) for name in group)
    return best - 2e-3 * cost


def _columns(data: Data, current: Fitted, group: Sequence[str]) -> list[FloatArray]:
    """For each set of starts, what each parameter of the group changes in the residuals, (N, k)."""
    model, problem = data.model, current.problem
    terms = terms_named(model, group)
    places = index_of(model.parameters)
    before = current.solution.residuals
    sets = []
    for values in starts_of(model, terms, data.search):
        columns = []
        shapes = {p.name for term in terms for p in term.parameters if p.shape}
        for term in terms:
            for parameter in term.parameters:
                if parameter.shape:
                    continue
                theta = current.theta.copy()
                for name in shapes:
                    theta[places[name]] = values[name]
                theta[places[parameter.name]] = values[parameter.name] or 1e-2 * parameter.scale
                columns.append(_residuals_at(problem, theta, current.solution.point.states) - before)
        sets.append(np.column_stack(columns))
    return sets


def _residuals_at(problem: Problem, theta: FloatArray, states: FloatArray) -> FloatArray:
    nothing = np.empty(0, dtype=np.int64)
    moved = Problem(problem.model, problem.record, problem.windows, nothing, theta, problem.sigma)
    return moved.residuals(Point(np.empty(0), states))


def _orthonormal(columns: FloatArray) -> FloatArray:
    """An orthonormal basis of the span of columns (N, k), those of no length left out."""
    length = np.linalg.norm(columns, axis=0)
    columns = columns[:, length > 1e-9 * max(float(length.max(initial=0.0)), 1e-300)]
    if not columns.shape[1]:
        return columns
    left, singular, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return np.asarray(left[:, singular > 1e-8])


def _refit(
    data: Data, current: Fitted, terms: Sequence[str], fresh: Sequence[str], *, thorough: bool = False
) -> Fitted:
    start = current.theta.copy()
    neutral = [i for i, p in enumerate(data.model.parameters) if p.name.partition(".")[0] not in terms]
    for i in neutral:
        if "." in data.model.parameters[i].name:
            start[i] = data.model.parameters[i].neutral
    return fit_terms(
        data.model,
        data.search,
        terms,
        data.window,
        data.sigma,
        start=start,
        states=current.solution.point.states,
        new_terms=fresh,
        iterations=25,
        thorough=thorough,
    )


def _first_accepted(data: Data, current: Fitted, trials: Sequence[Fitted], looks: int) -> Fitted | None:
    """The best trial that both search and held-out data support."""
    before = data.judge(current.theta)
    for trial in trials[:3]:
        if supported(compare(data, current, trial, before, looks)[0]):
            return trial
    return None


def compare(
    data: Data, before: Fitted, after: Fitted, score_before: Score, looks: int
) -> tuple[Evidence, float]:
    """Evidence for ``after`` over ``before``, and the search data's corrected p value."""
    effective = effective_samples(after.solution.residuals)
    gain, p_value = heldout_gain(score_before, data.judge(after.theta))
    delta = bic(after, effective) - bic(before, effective)
    return Evidence(delta, p_value, gain), search_p_value(before, after, effective, looks)


def supported(evidence: Evidence) -> bool:
    """Both kinds of data must speak for a step."""
    return evidence.delta_bic < NEEDED_BIC and evidence.heldout_loglik_gain > 0 and evidence.p_value < ALPHA


def _swap(
    data: Data, current: Fitted, base: set[str], executor: Executor, progress: Progress
) -> tuple[Fitted, tuple[Rival, ...]]:
    """Try the best-screened rivals in the place of each found term; keep what is better."""
    rivals: list[Rival] = []
    for term in [t for t in current.terms if t not in base]:
        reduced = _refit(data, current, without(data.model, current.terms, term), ())
        absent = [group for group in candidates(data.model, reduced.terms) if term not in group]
        groups = [group for group in absent if group[-1] not in current.terms]
        promises = list(executor.map(lambda group: promised(data, reduced, group), groups))  # noqa: B023
        hopeful = [i for i in np.argsort(promises)[::-1][:WEIGHED] if promises[i] > HOPEFUL]
        ranked = [groups[i] for i in hopeful]
        if not ranked:
            continue
        progress(f"weighing {', '.join(group[-1] for group in ranked)} instead of {term}")
        effective = effective_samples(current.solution.residuals)
        for trial in confirm(data, reduced, ranked, executor):
            rival = trial.terms[-1]
            delta = bic(trial, effective) - bic(current, effective)
            if delta < NEEDED_BIC:
                rivals.append(Rival(term, rival, -delta))
                current = trial
                break
            rivals.append(Rival(rival, term, delta))
    return current, tuple(r for r in rivals if r.delta_bic < RIVAL_BIC)


def _prune(data: Data, current: Fitted, base: set[str], progress: Progress) -> Fitted:
    """Remove found terms that the search data no longer need."""
    # what builds on others goes first, so that these can go after it
    found = [t for t in current.terms if t not in base]
    if len(found) < 2:
        return current
    for term in sorted(found, key=lambda t: -len(data.model.terms[t].with_terms)):
        progress(f"is {term} still needed")
        if any(term in data.model.terms[t].with_terms for t in current.terms):
            continue
        reduced = _refit(data, current, without(data.model, current.terms, term), ())
        effective = effective_samples(current.solution.residuals)
        if bic(reduced, effective) - bic(current, effective) < -NEEDED_BIC:
            current = reduced
    return current


def _steps_of(data: Data, baseline: Fitted, final: Fitted, looks: int) -> tuple[Step, ...]:
    """Evidence for each term of the final model: what is lost when it alone is taken out."""
    kept = []
    for term in [t for t in final.terms if t not in baseline.terms]:
        reduced = _refit(data, final, without(data.model, final.terms, term), ())
        evidence, p_search = compare(data, reduced, final, data.judge(reduced.theta), looks)
        kept.append(Step((term,), evidence, p_search))
    return tuple(sorted(kept, key=lambda step: step.evidence.delta_bic))


__all__ = ["Data", "Found", "Rival", "Step", "candidates", "search"]
