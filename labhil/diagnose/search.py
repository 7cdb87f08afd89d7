"""Which terms are missing: screen by projection, confirm by refitting, judge on held-out data.

Forward steps add the best candidate, a swap replaces a term by a rival that explains the search data
better, a backward step removes what is no longer needed. Nothing stays that held-out data do not
support.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from labhil.diagnose.evidence import Evidence, bic, effective_samples, heldout_gain, search_p_value
from labhil.diagnose.judge import NEEDED_BIC, Data, compare, supported
from labhil.diagnose.screen import Candidate, Progress, Screen, candidates, rank
from labhil.identify.fitted import WORST_GROWTH, Fitted, climb, covariances, fit_terms
from labhil.identify.intervals import quantile
from labhil.identify.score import Score
from labhil.physics.model import Model, index_of

SETTLED = 1.05
"""A fit whose residuals are at most this much above the noise has found what it could."""

LONGER = (2.0, 4.0)
"""The last fits are on windows that are this much longer than those of the search: they know more."""

CONFIRMED = 5
"""How many of the screened candidates are refitted at each step."""

CONFIRMED_PAIRS = 3
"""How many pairs of them, while the residuals are above the noise."""

STILL_NOISY = 1.15
"""Residuals this much above the noise say that something is still missing."""

RELEVANT, RELEVANT_BESIDE = 0.05, 0.5
"""A term has to explain this share of the baseline's squared residuals beyond noise, or this of what is left.

On precise recordings of real mechanisms there is always a further term that chance does not explain.
"""

WEIGHED, WEIGHED_WIDELY = (2, 0.5), (5, 0.1)
"""How many rivals are tried in the place of each found term, and what share of what its absence leaves they
have to promise: on long windows, where a projection says less, more of them and with less."""

ROUGHLY = 1e-4
"""Share of the cost by which a step has to lower it while candidates are compared: part of a BIC unit."""

LEADING = 0.4
"""Scouts that stay behind the best by more than this share of what it gained are not refitted to the end."""

FINALISTS = 3
"""How many of them are refitted to the end where much is still unexplained."""

HOPELESS = 3.0
"""A fit whose squared residuals stay above this many times those of the model to beat is not finished."""

RIVAL_BIC = 10.0
"""A rival within this stays on the list: it is under five nats behind."""


@dataclass(frozen=True, slots=True)
class Step:
    """One accepted addition with its evidence; ``p_search`` is corrected for all candidates looked at.

    ``told``: it explains enough to be worth telling, and a size of it is told from zero.
    """

    terms: tuple[str, ...]
    evidence: Evidence
    p_search: float
    told: bool


@dataclass(frozen=True, slots=True)
class Rival:
    """A term that would do about as well in the place of another."""

    term: str
    instead_of: str
    delta_bic: float


@dataclass(frozen=True, slots=True)
class Found:
    """Where a search ended; ``errors`` are standard errors by key that its fits by themselves cannot know."""

    baseline: Fitted
    final: Fitted
    missing: tuple[Step, ...]
    rivals: tuple[Rival, ...]
    p_value: float
    looks: int
    errors: Mapping[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class Trail:
    """Where a search stands: the best model so far, p values of its steps, rivals of its terms.

    ``been`` are the sets of terms that it stood at, and does not go back to.
    """

    current: Fitted
    p_values: list[float]
    rivals: tuple[Rival, ...] = ()
    been: set[frozenset[str]] = field(default_factory=set)

    def go(self, fitted: Fitted) -> bool:
        """Stand there from now on; False, and stay, where it has been before."""
        terms = frozenset(fitted.terms)
        if terms in self.been:
            return False
        self.been.add(terms)
        self.current = fitted
        return True


def search(data: Data, baseline: Fitted, progress: Progress) -> Found:
    """Look for missing terms, beginning at a fitted baseline: on short windows, then on longer ones.

    Short ones lead to the neighbourhood whatever is missing; what acts slowly shows on longer ones only.
    """
    looks = len(candidates(data.model, baseline.terms))
    trail = Trail(baseline, [], been={frozenset(baseline.terms)})
    with ThreadPoolExecutor(os.cpu_count()) as executor:
        hunt = Hunt(data, baseline, looks, executor, progress)
        hunt.follow(trail)
        if data.model.state_names:
            progress("refitting on longer windows")
            data, baseline = hunt.follow_on_longer_windows(trail)
            trail.current = hunt.pruned(data, trail.current)
    current, kept = _supported_only(data, baseline, trail.current, looks)
    rivals = tuple(r for r in trail.rivals if r.instead_of in current.terms)
    # of the first step when something was found, else of the last, which found nothing to add
    p_value = trail.p_values[0 if kept else -1] if trail.p_values else 1.0
    return Found(baseline, current, kept, rivals, p_value, looks)


@dataclass(frozen=True, slots=True)
class Hunt:
    """What all steps of a search share; the terms of the ``baseline`` are never taken out."""

    data: Data
    baseline: Fitted
    looks: int
    executor: Executor
    progress: Progress

    @property
    def base(self) -> frozenset[str]:
        """The baseline's terms."""
        return frozenset(self.baseline.terms)

    def follow(self, trail: Trail, *, only_promising: bool = False) -> None:
        """Add, swap and remove terms until nothing is left to do.

        ``only_promising`` candidates are those of which the projection promises strong evidence.
        """
        while True:
            ranked, pairs = rank(self.data, trail.current, self.executor, self.progress)
            if only_promising:
                ranked, pairs = ([c for c in found if c.promising] for found in (ranked, pairs))
            accepted = self._added(trail, ranked, pairs)
            if accepted is None and self._swapped(trail, widely=only_promising):
                continue
            if accepted is None and trail.current.noise > STILL_NOISY:
                rest = [candidate.group for candidate in ranked[CONFIRMED:]]
                accepted, _ = self._forward(trail.current, rest)
            if accepted is None or not _relevant(self.baseline, trail.current, accepted):
                return
            accepted = refit(self.data, accepted, accepted.terms, (), thorough=True)
            if not trail.go(self.pruned(self.data, accepted)):
                return
            self.progress(f"found {', '.join(t for t in trail.current.terms if t not in self.base)}")

    def follow_on_longer_windows(self, trail: Trail) -> tuple[Data, Fitted]:
        """Go on from there on the longest windows; the data with those that the answer stands on.

        With the baseline refitted to these.
        """
        short = trail.current
        longest = replace(self.data, window=self._reach(LONGER[-1]))
        trail.current = _onward(longest, short)
        # what gave way on short windows may be right on long ones
        trail.been = {frozenset(short.terms)}
        onward = replace(self, data=longest, baseline=_onward(longest, self.baseline))
        onward.follow(trail, only_promising=True)
        # noise that drives the plant itself, or a force without a name, biases what long windows say
        if trail.current.noise <= WORST_GROWTH * short.noise:
            return longest, onward.baseline
        middle = replace(self.data, window=self._reach(LONGER[0]))
        trail.current = _onward(middle, short)
        if trail.current.noise <= WORST_GROWTH * short.noise:
            return middle, _onward(middle, self.baseline)
        trail.current = short
        return self.data, _onward(self.data, self.baseline)

    def pruned(self, data: Data, current: Fitted) -> Fitted:
        """Without the found terms that these data no longer need."""
        return _prune(data, current, self.base, self.progress)

    def _reach(self, share: float) -> float:
        return min(share * self.data.window, self.data.search.longest)

    def _swapped(self, trail: Trail, *, widely: bool) -> bool:
        """Whether a rival took the place of a found term."""
        swapped, trail.rivals = _swap(
            self.data, trail, self.base, self.executor, self.progress, widely=widely
        )
        return swapped is not trail.current and trail.go(swapped)

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
    """Refit candidates, best first by BIC: a few steps each, and to the end where that promises most."""

    def scout(group: tuple[str, ...]) -> Fitted:
        return refit(data, current, (*current.terms, *group), group, hopeless=0.0, tolerance=ROUGHLY)

    def finish(trial: Fitted) -> Fitted:
        if trial.solution.converged or trial.solution.cost > hopeless:
            return trial
        return refit(data, trial, trial.terms, (), tolerance=ROUGHLY)

    scouts = list(executor.map(scout, groups))
    if not scouts:
        return []
    effective = min(effective_samples(t) for t in scouts)
    marks = [bic(trial, effective) for trial in scouts]
    within = min(marks) + max(NEEDED_BIC, LEADING * (bic(current, effective) - min(marks)))
    leading = [trial for trial, mark in zip(scouts, marks, strict=True) if mark <= within]
    others = [trial for trial, mark in zip(scouts, marks, strict=True) if mark > within]
    trials = [*executor.map(finish, leading), *others]
    effective = min(effective_samples(t) for t in trials)
    return sorted(trials, key=lambda trial: bic(trial, effective))


def _finish_best(data: Data, trials: Sequence[Fitted], executor: Executor) -> list[Fitted]:
    """Refit the best few with a second chance for outlying windows, and order them anew."""
    leading = trials[:FINALISTS]
    finished = list(executor.map(lambda t: refit(data, t, t.terms, (), thorough=True), leading))
    effective = min(effective_samples(t) for t in finished)
    return sorted(finished, key=lambda trial: bic(trial, effective))


def refit(
    data: Data,
    current: Fitted,
    terms: Sequence[str],
    fresh: Sequence[str],
    *,
    thorough: bool = False,
    hopeless: float = float("inf"),
    tolerance: float = 1e-6,
) -> Fitted:
    """Fit ``terms`` from where a fit stands; those in ``fresh`` begin at each of their own starts."""
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
        tolerance=tolerance,
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


def _swap(
    data: Data, trail: Trail, base: frozenset[str], executor: Executor, progress: Progress, *, widely: bool
) -> tuple[Fitted, tuple[Rival, ...]]:
    """Try the best-screened rivals in the place of each found term; keep what both kinds of data prefer."""
    current, rivals = trail.current, list[Rival]()
    for term in [t for t in current.terms if t not in base]:
        if term not in current.terms:
            continue
        reduced = _without(data, current, term)
        absent = [group for group in candidates(data.model, reduced.terms) if term not in group]
        groups = [group for group in absent if group[-1] not in current.terms]
        groups = _hopeful(data, current, reduced, groups, executor, *(WEIGHED_WIDELY if widely else WEIGHED))
        if not groups:
            continue
        progress(f"weighing {', '.join(group[-1] for group in groups)} instead of {term}")
        effective, scores = effective_samples(current), data.judge(current.theta)
        for trial in confirm(data, reduced, groups, executor, HOPELESS * current.solution.cost)[:FINALISTS]:
            rival, delta = trial.terms[-1], bic(trial, effective) - bic(current, effective)
            new = frozenset(trial.terms) not in trail.been
            if new and _preferred(scores, data.judge(trial.theta), delta):
                rivals.append(Rival(term, rival, -delta))
                current = trial
                break
            rivals.append(Rival(rival, term, delta))
    return current, tuple(r for r in rivals if abs(r.delta_bic) < RIVAL_BIC)


def _hopeful(
    data: Data,
    current: Fitted,
    reduced: Fitted,
    groups: Sequence[tuple[str, ...]],
    executor: Executor,
    most: int,
    share: float,
) -> list[tuple[str, ...]]:
    """The groups that promise most beside the reduced model.

    At most so many, and at least this share of what the absence of the term in question leaves.
    """
    screen = Screen.of(data, reduced)
    columns = list(executor.map(screen.columns_of, groups))
    promises = [screen.promise([own], group) for own, group in zip(columns, groups, strict=True)]
    wanted = share * (1.0 - current.solution.cost / reduced.solution.cost)
    return [groups[i] for i in np.argsort(promises)[::-1][:most] if promises[i] > wanted]


def _preferred(before: Sequence[Score], after: Sequence[Score], delta_bic: float) -> bool:
    """Whether search and held-out data together prefer ``after``: what the one cannot tell the other may."""
    pairs = zip(before, after, strict=True)
    most_telling = max((heldout_gain(b, a)[0] for b, a in pairs), key=abs)
    return delta_bic - 2.0 * most_telling < 0.0


def _relevant(baseline: Fitted, before: Fitted, after: Fitted) -> bool:
    """Whether a step explains enough of what the baseline leaves unexplained."""
    at_first, left = (fitted.solution.cost - fitted.dof for fitted in (baseline, before))
    return before.solution.cost - after.solution.cost > min(RELEVANT * at_first, RELEVANT_BESIDE * left)


def _significant(fitted: Fitted, term: str) -> bool:
    """Whether a size of this term is told from zero; one with a shape is judged by its evidence alone."""
    parameters = fitted.problem.model.terms[term].parameters
    if any(p.shape for p in parameters):
        return True
    robust, _, _ = covariances(fitted)
    places = index_of(fitted.problem.model.parameters)
    free = fitted.problem.free.tolist()
    own = [free.index(places[p.key]) for p in parameters if places[p.key] in free]
    values, errors = fitted.theta[fitted.problem.free[own]], np.sqrt(np.diag(robust)[own])
    return bool(np.any(np.abs(values) > quantile() * errors))


def _without(data: Data, current: Fitted, term: str) -> Fitted:
    """The model refitted without a term and what builds on it, unless that is hopelessly worse."""
    terms = without(data.model, current.terms, term)
    return refit(data, current, terms, (), hopeless=HOPELESS * current.solution.cost)


def _prune(data: Data, current: Fitted, base: frozenset[str], progress: Progress) -> Fitted:
    """Remove found terms that the search data no longer need."""
    # what builds on others goes first, so that these can go after it; two weak ones must not both go
    effective = effective_samples(current)
    allowed = bic(current, effective) - NEEDED_BIC
    found = [t for t in current.terms if t not in base]
    if len(found) < 2:
        return current
    for term in sorted(found, key=lambda t: -len(data.model.terms[t].with_terms)):
        progress(f"is {term} still needed")
        if any(term in data.model.terms[t].with_terms for t in current.terms):
            continue
        reduced = _without(data, current, term)
        if bic(reduced, effective) < allowed:
            current = reduced
    return current


def _supported_only(
    data: Data, baseline: Fitted, final: Fitted, looks: int
) -> tuple[Fitted, tuple[Step, ...]]:
    """Take out, weakest first, whatever search and held-out data do not both support in the last fit."""
    while True:
        steps = _steps_of(data, baseline, final, looks)
        weak = [step for step in steps if not (step.told and supported(step.evidence, step.p_search))]
        if not weak:
            return final, steps
        final = refit(data, final, without(data.model, final.terms, weak[-1].terms[0]), (), thorough=True)


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
        reduced = _without(data, final, term)
        evidence, p_search = compare(data, reduced, final, data.judge(reduced.theta), looks)
        told = _relevant(baseline, reduced, final) and _significant(final, term)
        kept.append(Step((term,), evidence, p_search, told))
    return tuple(sorted(kept, key=lambda step: step.evidence.delta_bic))
