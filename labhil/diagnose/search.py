"""Which terms are missing: screen by projection, confirm by refitting, judge on held-out data.

Forward steps add the best candidate, a swap replaces a term by a rival that explains the search data
better, a backward step removes what is no longer needed. Nothing stays that held-out data do not
support.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace

from labhil.cores import cores
from labhil.diagnose.evidence import best_heldout_gain, effective_samples, search_p_value
from labhil.diagnose.foretold import compare
from labhil.diagnose.found import Found, Trail
from labhil.diagnose.judge import ALPHA, Data, supported
from labhil.diagnose.refit import confirm, finish_best, refit
from labhil.diagnose.screen import Candidate, Progress, rank
from labhil.diagnose.structures.enumerate import candidates
from labhil.diagnose.weigh import ON_THE_WAY, pruned, relevant, supported_only, swapped
from labhil.ending import EndedEarly, accept
from labhil.identify.fitted import WORST_GROWTH, Fitted, climb

SETTLED = 1.05
"""A fit whose residuals are at most this much above the noise has found what it could."""

LONGER, MIDDLE = 4.0, 2.0
"""The last fits are on windows that are this much longer than those of the search: they know more.

On the shorter ones where a model does not hold on the longer ones.
"""

MUCH_LONGER, WHOLE_GROWTH = 1.5, 1.1
"""How much longer a whole recording has to be to be worth the way, and how much more noise it may leave.

A window's own initial state takes up what is slow in it; a whole recording has one.
"""

CONFIRMED = 5
"""How many of the screened candidates are refitted at each step."""

CONFIRMED_PAIRS = 3
"""How many pairs of them, while the residuals are above the noise."""

ASKED = 3
"""How many of these the held-out data are asked about."""

STILL_NOISY = 1.15
"""Residuals this much above the noise say that something is still missing."""


def search(data: Data, baseline: Fitted, progress: Progress) -> Found:
    """Look for missing terms, beginning at a fitted baseline: on short windows, then on longer ones.

    Short ones lead to the neighbourhood whatever is missing; what acts slowly shows on longer ones only.
    """
    looks = len(candidates(data.model, baseline.terms))
    trail = Trail(baseline, [])
    trail.begin(baseline)
    short: Fitted | None = None
    complete = True
    try:
        with ThreadPoolExecutor(cores()) as executor:
            hunt = Hunt(data, baseline, looks, executor, progress)
            hunt.follow(trail)
            if data.model.state_names:
                short = trail.current
                progress("refitting on longer windows")
                data, baseline = hunt.follow_on_longer_windows(trail)
                short = None
                trail.current = hunt.pruned(data, trail.current)
    except EndedEarly:
        accept()
        complete = False
        # on longer windows the search was between one problem and another
        trail.current = trail.current if short is None else short
    current, kept = supported_only(data, baseline, trail.current, looks)
    told = {step.terms[0] for step in kept}
    rivals = tuple(r for r in trail.rivals if r.instead_of in told)
    # of the first step when something was found, else of the last, which found nothing to add
    p_value = trail.p_values[0 if kept else -1] if trail.p_values else 1.0
    return Found(baseline, current, kept, rivals, p_value, looks, complete=complete)


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
            worth = accepted is not None and relevant(self.baseline, trail.current, accepted, self._share)
            if not worth and self._swapped(trail, widely=only_promising):
                continue
            if accepted is None:
                accepted, _ = self._forward(trail.current, self._others(trail.current, ranked[CONFIRMED:]))
            if accepted is None or not relevant(self.baseline, trail.current, accepted, self._share):
                return
            accepted = refit(self.data, accepted, accepted.terms, (), thorough=True)
            if not trail.go(self.pruned(self.data, accepted)):
                return
            self.progress(f"found {', '.join(t for t in trail.current.terms if t not in self.base)}")

    def follow_on_longer_windows(self, trail: Trail) -> tuple[Data, Fitted]:
        """Go on from there on longer windows; the data with those that the answer stands on.

        With the baseline refitted to these.
        """
        short = trail.current
        longer = self._on(self._windows(LONGER))
        # what gave way on short windows may be right on long ones
        trail.begin(onward(longer.data, short))
        longer.follow(trail, only_promising=True)
        # noise that drives the plant itself, or a force without a name, biases what long windows say
        if trail.current.noise <= WORST_GROWTH * short.noise:
            longest = longer._followed_on_the_whole(trail)
            return longest.data, longest.baseline
        middle = self._windows(MIDDLE)
        trail.current = onward(middle, short)
        if trail.current.noise <= WORST_GROWTH * short.noise:
            return middle, onward(middle, self.baseline)
        trail.current = short
        return self.data, onward(self.data, self.baseline)

    def _followed_on_the_whole(self, trail: Trail) -> Hunt:
        """Go on where each recording is one window, if a fit there foretells held-out data better."""
        data = self._windows(float("inf"))
        if data.window < MUCH_LONGER * self.data.window:
            return self
        current = onward(data, trail.current)
        if current.noise > WHOLE_GROWTH * trail.current.noise:
            return self
        scores = (self.data.judge(fitted.theta) for fitted in (trail.current, current))
        if best_heldout_gain(*scores)[1] >= ALPHA:
            return self
        self.progress("refitting on whole recordings")
        trail.begin(current)
        whole = self._on(data)
        whole.follow(trail, only_promising=True)
        return whole

    def _on(self, data: Data) -> Hunt:
        """The same on other windows, the baseline refitted to these."""
        return replace(self, data=data, baseline=onward(data, self.baseline))

    def pruned(self, data: Data, current: Fitted) -> Fitted:
        """Without the found terms that these data no longer need."""
        return pruned(data, current, self.base, self.progress)

    @property
    def _share(self) -> float:
        """Of what is worth telling: in a linear problem no step leads through a valley to another one."""
        return ON_THE_WAY if self.data.model.state_names else 1.0

    def _windows(self, longer: float) -> Data:
        """The data with windows so many times longer, as far as a recording reaches."""
        return replace(self.data, window=min(longer * self.data.window, self.data.search.longest))

    def _others(self, current: Fitted, ranked: Sequence[Candidate]) -> list[tuple[str, ...]]:
        """What else is refitted where none of the first is accepted: while much is left, everything.

        Of an arm whatever promises strong evidence: those that promise most may all be of the one joint that
        no term explains, and refits are linear.
        """
        noisy, arm = current.noise > STILL_NOISY, not self.data.model.state_names
        return [candidate.group for candidate in ranked if noisy or (arm and candidate.promising)]

    def _swapped(self, trail: Trail, *, widely: bool) -> bool:
        """Whether a rival took the place of a found term."""
        best, trail.rivals = swapped(self.data, trail, self.base, self.executor, self.progress, widely=widely)
        return best is not trail.current and trail.go(best)

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
            trials = finish_best(self.data, trials, self.executor)
        return _first_accepted(self.data, current, trials, self.looks), trials


def onward(data: Data, fitted: Fitted) -> Fitted:
    """Refit on the data's windows.

    Where that leaves more than noise, the same terms begin anew, from their own starts: a search adds
    terms one by one, and its way may have ended in a local minimum.
    """
    model, record, terms, sigma = data.model, data.search, fitted.terms, data.sigma
    held = data.held
    further = climb(model, record, terms, [data.window], sigma, start=fitted.theta, fresh=(), held=held)[-1]
    if further.noise < SETTLED:
        return further
    lengths = [share * data.window for share in (0.25, 0.5, 1.0)]
    anew = climb(model, record, terms, lengths, sigma, start=data.begin, fresh=terms, held=held)[-1]
    return min(further, anew, key=lambda candidate: candidate.solution.cost)


def on_several_windows(data: Data, found: Found) -> Found:
    """The same where windows can be left out in turn, as a curve asks for: not on whole recordings."""
    data = replace(data, window=LONGER * data.window)
    if found.final.window < MUCH_LONGER * data.window or not data.model.state_names:
        return found
    return replace(found, baseline=onward(data, found.baseline), final=onward(data, found.final))


def _first_accepted(data: Data, current: Fitted, trials: Sequence[Fitted], looks: int) -> Fitted | None:
    """The best trial that both search and held-out data support; of an arm each joint has its own."""
    before = data.judge(current.theta)
    for trial in trials[:ASKED] if data.model.state_names else trials:
        if supported(*compare(data, current, trial, before, looks)):
            return trial
    return None
