"""Which terms are missing: screen by projection, confirm by refitting, judge on held-out data.

Forward steps add the best candidate, a swap replaces a term by a rival that explains the search data
better, a backward step removes what is no longer needed. Nothing stays that held-out data do not
support.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import stats

from labhil.diagnose.evidence import Evidence, best_heldout_gain, bic, effective_samples, search_p_value
from labhil.identify.fitted import WORST_GROWTH, Fitted, climb, fit_terms
from labhil.identify.problem import Linearised, Point, Problem
from labhil.identify.score import Score, score
from labhil.physics.model import Model, Record, index_of, starts_of, terms_named
from labhil.signals import FloatArray

Progress = Callable[[str], None]

SETTLED = 1.05
"""A fit whose residuals are at most this much above the noise has found what it could."""

LONGER = (2.0, 4.0)
"""The last fits are on windows that are this much longer than those of the search: they know more."""

COST = 2e-3
"""Share of the residuals that each parameter has to promise."""

CONFIRMED = 5
"""How many of the screened candidates are refitted at each step."""

CONFIRMED_PAIRS = 3
"""How many pairs of them, while the residuals are above the noise."""

NEEDED_BIC = -10.0
"""Very strong evidence on the search data, in the usual reading of BIC."""

ALLOWANCE = 0.5
"""Share of the evidence needed that a projection has to promise where only promising terms are refitted."""

STILL_NOISY = 1.15
"""Residuals this much above the noise say that something is still missing."""

WEIGHED = 2
"""How many rivals are tried in the place of each found term."""

FINALISTS = 3
"""How many of them are refitted to the end where much is still unexplained."""

HOPELESS = 3.0
"""A fit whose squared residuals stay above this many times those of the model to beat is not finished."""

HOPEFUL = 0.5
"""A rival that promises to explain less than this share of what a term's absence leaves is not tried."""

RIVAL_BIC = 10.0
"""A rival within this stays on the list: it is under five nats behind."""

JUDGED_SHARES = (1.0, 0.25)
"""What acts slowly shows on long windows, what acts fast and often on many short ones."""

ALPHA = 0.1
"""One-sided level of the held-out test that every step has to pass by itself."""

TRUSTED = 1e-6
"""The search data's p value is trusted down to this: noise is never quite what it is taken for."""

TOGETHER = 5e-4
"""Level of both tests together (Fisher's method)."""

JUDGED_LENGTH, JUDGED_WINDOWS = 4.0 / 3.0, 10
"""Judged windows are this much longer than those of the search, or so short that they can be counted."""


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
    """What a search works on: search and test records with their noise, and the windows' length in s.

    ``begin`` is the vector that fits begin at; parameters with a key in ``held`` stay there.
    """

    model: Model
    search: Record
    test: Record
    sigma: FloatArray
    test_sigma: FloatArray
    window: float
    begin: FloatArray
    held: frozenset[str] = frozenset()

    def judge(self, theta: FloatArray) -> tuple[Score, ...]:
        """Scores on held-out windows short enough to be counted: on long ones, and on short ones."""
        duration = float(self.test.t[-1] - self.test.t[0])
        length = min(JUDGED_LENGTH * self.window, duration / JUDGED_WINDOWS)
        shares = JUDGED_SHARES if self.model.state_names else (1.0,)
        return tuple(score(self.model, theta, self.test, self.test_sigma, share * length) for share in shares)


@dataclass(frozen=True, slots=True)
class Found:
    """Where a search ended."""

    baseline: Fitted
    final: Fitted
    missing: tuple[Step, ...]
    rivals: tuple[Rival, ...]
    p_value: float
    looks: int


@dataclass(slots=True)
class Trail:
    """Where a search stands: the best model so far, p values of its steps, rivals of its terms."""

    current: Fitted
    p_values: list[float]
    rivals: tuple[Rival, ...] = ()


def search(data: Data, baseline: Fitted, progress: Progress) -> Found:
    """Look for missing terms, beginning at a fitted baseline: on short windows, then on longer ones.

    Short ones lead to the neighbourhood whatever is missing; what acts slowly shows on longer ones only.
    """
    looks = len(candidates(data.model, baseline.terms))
    trail = Trail(baseline, [])
    with ThreadPoolExecutor(os.cpu_count()) as executor:
        hunt = Hunt(data, frozenset(baseline.terms), looks, executor, progress)
        hunt.follow(trail)
        if data.model.state_names:
            progress("refitting on longer windows")
            data = hunt.follow_on_longer_windows(trail)
            trail.current = hunt.pruned(data, trail.current)
            baseline = _onward(data, baseline)
    current, kept = _supported_only(data, baseline, trail.current, looks)
    rivals = tuple(r for r in trail.rivals if r.instead_of in current.terms)
    # of the first step when something was found, else of the last, which found nothing to add
    p_value = trail.p_values[0 if kept else -1] if trail.p_values else 1.0
    return Found(baseline, current, kept, rivals, p_value, looks)


@dataclass(frozen=True, slots=True)
class Hunt:
    """What all steps of a search share; ``base`` are the baseline's terms, which are never taken out."""

    data: Data
    base: frozenset[str]
    looks: int
    executor: Executor
    progress: Progress

    def follow(self, trail: Trail, *, only_promising: bool = False) -> None:
        """Add, swap and remove terms until nothing is left to do.

        ``only_promising`` candidates are those of which the projection promises strong evidence.
        """
        while True:
            ranked, pairs = _ranked(self.data, trail.current, self.executor, self.progress)
            if only_promising:
                ranked, pairs = ([c for c in found if c.promising] for found in (ranked, pairs))
            accepted = self._added(trail, ranked, pairs)
            if accepted is None:
                swapped, trail.rivals = _swap(self.data, trail, self.base, self.executor, self.progress)
                if swapped is not trail.current:
                    trail.current = swapped
                    continue
            if accepted is None and trail.current.noise > STILL_NOISY:
                rest = [candidate.group for candidate in ranked[CONFIRMED:]]
                accepted, _ = self._forward(trail.current, rest)
            if accepted is None:
                return
            accepted = _refit(self.data, accepted, accepted.terms, (), thorough=True)
            trail.current = self.pruned(self.data, accepted)
            self.progress(f"found {', '.join(t for t in trail.current.terms if t not in self.base)}")

    def follow_on_longer_windows(self, trail: Trail) -> Data:
        """Go on from there on the longest windows; the data with those that the answer stands on."""
        short = trail.current
        longest = replace(self.data, window=self._reach(LONGER[-1]))
        trail.current = _onward(longest, short)
        replace(self, data=longest).follow(trail, only_promising=True)
        if trail.current.terms != short.terms or trail.current.noise <= WORST_GROWTH * short.noise:
            return longest
        # noise that drives the plant itself biases what long windows say
        middle = replace(self.data, window=self._reach(LONGER[0]))
        trail.current = _onward(middle, short)
        if trail.current.noise <= WORST_GROWTH * short.noise:
            return middle
        trail.current = short
        return self.data

    def pruned(self, data: Data, current: Fitted) -> Fitted:
        """Without the found terms that these data no longer need."""
        return _prune(data, current, self.base, self.progress)

    def _reach(self, share: float) -> float:
        return min(share * self.data.window, float(self.data.search.t[-1] - self.data.search.t[0]))

    def _added(self, trail: Trail, ranked: Sequence[Candidate], pairs: Sequence[Candidate]) -> Fitted | None:
        """The best supported addition of those that promise most."""
        first = [*ranked[:CONFIRMED], *(pairs[:CONFIRMED_PAIRS] if trail.current.noise > STILL_NOISY else [])]
        accepted, trials = self._forward(trail.current, [candidate.group for candidate in first])
        if trials:
            effective = effective_samples(trials[0])
            trail.p_values.append(search_p_value(trail.current, trials[0], effective, self.looks))
        return accepted

    def _forward(
        self, current: Fitted, groups: Sequence[tuple[str, ...]]
    ) -> tuple[Fitted | None, list[Fitted]]:
        """The best supported addition, or None, and all that was refitted, best first."""
        if not groups:
            return None, []
        self.progress(f"refitting {', '.join(' + '.join(group) for group in groups)}")
        trials = confirm(self.data, current, groups, self.executor)
        if current.noise > STILL_NOISY:
            trials = _finish_best(self.data, trials, self.executor)
        return _first_accepted(self.data, current, trials, self.looks), trials


@dataclass(frozen=True, slots=True)
class Candidate:
    """A group of terms with the share of the squared residuals that it promises to explain.

    ``promising`` says that this would be strong evidence, with some allowance for what a projection misses.
    """

    group: tuple[str, ...]
    share: float
    promising: bool


def _onward(data: Data, fitted: Fitted) -> Fitted:
    """Refit on the data's windows.

    Where that leaves more than noise, the same terms begin anew, from their own starts: a search adds
    terms one by one, and its way may have ended in a local minimum.
    """
    model, record, terms, sigma = data.model, data.search, fitted.terms, data.sigma
    held = data.held
    onward = climb(model, record, terms, [data.window], sigma, start=fitted.theta, fresh=(), held=held)[-1]
    if onward.noise < SETTLED:
        return onward
    lengths = [share * data.window for share in (0.25, 0.5, 1.0)]
    anew = climb(model, record, terms, lengths, sigma, start=data.begin, fresh=terms, held=held)[-1]
    return min(onward, anew, key=lambda candidate: candidate.solution.cost)


def _ranked(
    data: Data, current: Fitted, executor: Executor, progress: Progress
) -> tuple[list[Candidate], list[Candidate]]:
    """Absent terms, and pairs of them, those that promise most first.

    Pairs count from the start: one effect that hides another (a constant force under dry friction)
    would let a wrong third explain a little of both.
    """
    groups = candidates(data.model, current.terms)
    progress(f"screening {len(groups)} candidates and their pairs beside {', '.join(current.terms)}")
    screen = Screen.of(data, current)
    columns = list(executor.map(screen.columns_of, groups))
    single = [screen.candidate([own], group) for own, group in zip(columns, groups, strict=True)]
    pairs = [
        screen.candidate([columns[i], columns[j]], joined)
        for i, j in combinations(range(len(groups)), 2)
        for joined in [tuple(dict.fromkeys((*groups[i], *groups[j])))]
        if not set(groups[i]) & set(groups[j])
    ]
    return sorted(single, key=lambda c: -c.share), sorted(pairs, key=lambda c: -c.share)


def candidates(model: Model, present: Sequence[str]) -> list[tuple[str, ...]]:
    """Every absent term, together with those that it builds on (Stribeck friction on Coulomb friction)."""
    absent = [name for name in model.terms if name not in present]
    return [(*(t for t in model.terms[name].with_terms if t in absent), name) for name in absent]


def without(model: Model, terms: Sequence[str], term: str) -> tuple[str, ...]:
    """These terms less one and what builds on it."""
    return tuple(t for t in terms if t != term and term not in model.terms[t].with_terms)


def confirm(
    data: Data,
    current: Fitted,
    groups: Sequence[tuple[str, ...]],
    executor: Executor,
    hopeless: float = float("inf"),
) -> list[Fitted]:
    """Refit candidates, best first by BIC."""

    def refit(group: tuple[str, ...]) -> Fitted:
        return _refit(data, current, (*current.terms, *group), group, hopeless=hopeless)

    trials = list(executor.map(refit, groups))
    effective = min((effective_samples(t) for t in trials), default=1.0)
    return sorted(trials, key=lambda trial: bic(trial, effective))


def _finish_best(data: Data, trials: Sequence[Fitted], executor: Executor) -> list[Fitted]:
    """Refit the best few with a second chance for outlying windows, and order them anew."""
    leading = trials[:FINALISTS]
    finished = list(executor.map(lambda t: _refit(data, t, t.terms, (), thorough=True), leading))
    effective = min(effective_samples(t) for t in finished)
    return sorted(finished, key=lambda trial: bic(trial, effective))


@dataclass(frozen=True, slots=True)
class Screen:
    """What candidates promise beside a fitted model, by projection, without refitting.

    Columns are slopes at neutral for parameters that act there, secants to their starts for the rest;
    what the model's own parameters and the windows' states explain is taken out first.
    """

    data: Data
    current: Fitted
    lin: Linearised
    basis: FloatArray
    target: FloatArray

    @classmethod
    def of(cls, data: Data, current: Fitted) -> Screen:
        """Prepare the projection that all candidates share."""
        problem = current.problem
        residuals = current.solution.residuals
        lin = problem.linearise(current.solution.point, residuals)
        own = problem.project(lin, np.column_stack([lin.by_parameters, residuals]))
        basis, target = _orthonormal(own[:, :-1]), own[:, -1]
        return cls(data, current, lin, basis, target - basis @ (basis.T @ target))

    def columns_of(self, group: Sequence[str]) -> FloatArray:
        """The group's projected columns (N, k), at those of its starts that explain most."""
        best, most = np.empty((len(self.target), 0)), -1.0
        for columns in _columns(self.data, self.current, group):
            new = self.current.problem.project(self.lin, columns)
            new = _orthonormal(new - self.basis @ (self.basis.T @ new))
            explained = float(np.sum((new.T @ self.target) ** 2))
            if explained > most:
                best, most = new, explained
        return best

    def candidate(self, columns: Sequence[FloatArray], group: tuple[str, ...]) -> Candidate:
        """What these columns of a group promise."""
        share = self.promise(columns, group)
        added = sum(len(self.data.model.terms[name].parameters) for name in group)
        explained = min(max(share + COST * added, 0.0), 1.0 - 1e-9)
        effective = effective_samples(self.current)
        gain = effective * np.log(1.0 - explained) + added * np.log(effective)
        return Candidate(group, share, bool(gain < ALLOWANCE * NEEDED_BIC))

    def promise(self, columns: Sequence[FloatArray], group: Sequence[str]) -> float:
        """Share of the squared residuals that these columns explain; more parameters must promise more."""
        new = columns[0] if len(columns) == 1 else _orthonormal(np.column_stack(columns))
        total = float(self.target @ self.target)
        share = float(np.sum((new.T @ self.target) ** 2)) / total if total > 0 else 0.0
        return share - COST * sum(len(self.data.model.terms[name].parameters) for name in group)


def _columns(data: Data, current: Fitted, group: Sequence[str]) -> list[FloatArray]:
    """For each set of starts, what each parameter of the group changes in the residuals, (N, k)."""
    model, problem = data.model, current.problem
    terms = terms_named(model, group)
    places = index_of(model.parameters)
    before = current.solution.residuals
    sets = []
    for values in starts_of(model, terms, data.search):
        columns = []
        shapes = {p.key for term in terms for p in term.parameters if p.shape}
        for term in terms:
            for parameter in term.parameters:
                if parameter.shape:
                    continue
                theta = current.theta.copy()
                for name in shapes:
                    theta[places[name]] = values[name]
                theta[places[parameter.key]] = values[parameter.key] or 1e-2 * parameter.scale
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
    data: Data,
    current: Fitted,
    terms: Sequence[str],
    fresh: Sequence[str],
    *,
    thorough: bool = False,
    hopeless: float = float("inf"),
) -> Fitted:
    start = current.theta.copy()
    for i, parameter in enumerate(data.model.parameters):
        if parameter.term is not None and parameter.term not in terms:
            start[i] = parameter.neutral
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
        hopeless=hopeless,
        held=data.held,
    )


def _first_accepted(data: Data, current: Fitted, trials: Sequence[Fitted], looks: int) -> Fitted | None:
    """The best trial that both search and held-out data support."""
    before = data.judge(current.theta)
    for trial in trials[:3]:
        if supported(*compare(data, current, trial, before, looks)):
            return trial
    return None


def compare(
    data: Data, before: Fitted, after: Fitted, scores_before: Sequence[Score], looks: int
) -> tuple[Evidence, float]:
    """Evidence for ``after`` over ``before``, and the search data's corrected p value."""
    effective = effective_samples(after)
    gain, p_value = best_heldout_gain(scores_before, data.judge(after.theta))
    delta = bic(after, effective) - bic(before, effective)
    return Evidence(delta, p_value, gain), search_p_value(before, after, effective, looks)


def supported(evidence: Evidence, p_search: float) -> bool:
    """Both kinds of data must speak for a step, each by itself and both together."""
    if evidence.delta_bic >= NEEDED_BIC or evidence.heldout_loglik_gain <= 0 or evidence.p_value >= ALPHA:
        return False
    both = -2.0 * (np.log(max(p_search, TRUSTED)) + np.log(max(evidence.p_value, 1e-300)))
    return bool(stats.chi2.sf(both, 4) < TOGETHER)


def _swap(
    data: Data, trail: Trail, base: frozenset[str], executor: Executor, progress: Progress
) -> tuple[Fitted, tuple[Rival, ...]]:
    """Try the best-screened rivals in the place of each found term; keep what is better."""
    current, rivals = trail.current, list[Rival]()
    for term in [t for t in current.terms if t not in base]:
        reduced = _refit(
            data,
            current,
            without(data.model, current.terms, term),
            (),
            hopeless=HOPELESS * current.solution.cost,
        )
        absent = [group for group in candidates(data.model, reduced.terms) if term not in group]
        groups = [group for group in absent if group[-1] not in current.terms]
        screen = Screen.of(data, reduced)
        columns = list(executor.map(screen.columns_of, groups))
        promises = [screen.promise([own], group) for own, group in zip(columns, groups, strict=True)]
        wanted = HOPEFUL * (1.0 - current.solution.cost / reduced.solution.cost)
        hopeful = [i for i in np.argsort(promises)[::-1][:WEIGHED] if promises[i] > wanted]
        ranked = [groups[i] for i in hopeful]
        if not ranked:
            continue
        progress(f"weighing {', '.join(group[-1] for group in ranked)} instead of {term}")
        effective = effective_samples(current)
        for trial in confirm(data, reduced, ranked, executor, HOPELESS * current.solution.cost):
            rival = trial.terms[-1]
            delta = bic(trial, effective) - bic(current, effective)
            if delta < NEEDED_BIC:
                rivals.append(Rival(term, rival, -delta))
                current = trial
                break
            rivals.append(Rival(rival, term, delta))
    return current, tuple(r for r in rivals if r.delta_bic < RIVAL_BIC)


def _prune(data: Data, current: Fitted, base: frozenset[str], progress: Progress) -> Fitted:
    """Remove found terms that the search data no longer need."""
    # what builds on others goes first, so that these can go after it
    found = [t for t in current.terms if t not in base]
    if len(found) < 2:
        return current
    for term in sorted(found, key=lambda t: -len(data.model.terms[t].with_terms)):
        progress(f"is {term} still needed")
        if any(term in data.model.terms[t].with_terms for t in current.terms):
            continue
        reduced = _refit(
            data,
            current,
            without(data.model, current.terms, term),
            (),
            hopeless=HOPELESS * current.solution.cost,
        )
        effective = effective_samples(current)
        if bic(reduced, effective) - bic(current, effective) < -NEEDED_BIC:
            current = reduced
    return current


def _supported_only(
    data: Data, baseline: Fitted, final: Fitted, looks: int
) -> tuple[Fitted, tuple[Step, ...]]:
    """Take out, weakest first, whatever search and held-out data do not both support in the last fit."""
    while True:
        steps = _steps_of(data, baseline, final, looks)
        weak = [step for step in steps if not supported(step.evidence, step.p_search)]
        if not weak:
            return final, steps
        final = _refit(data, final, without(data.model, final.terms, weak[-1].terms[0]), (), thorough=True)


def _steps_of(data: Data, baseline: Fitted, final: Fitted, looks: int) -> tuple[Step, ...]:
    """Evidence for each term of the final model: what is lost when it alone is taken out.

    A term that only carries others, its own sizes at zero, is none that was found.
    """
    kept = []
    places = index_of(data.model.parameters)
    for term in [t for t in final.terms if t not in baseline.terms]:
        sizes = [p.key for p in data.model.terms[term].parameters if not p.shape]
        if all(final.theta[places[key]] == 0.0 for key in sizes):
            continue
        less = without(data.model, final.terms, term)
        reduced = _refit(data, final, less, (), hopeless=HOPELESS * final.solution.cost)
        evidence, p_search = compare(data, reduced, final, data.judge(reduced.theta), looks)
        kept.append(Step((term,), evidence, p_search))
    return tuple(sorted(kept, key=lambda step: step.evidence.delta_bic))


__all__ = ["Data", "Found", "Rival", "Step", "candidates", "search"]
