"""What may be claimed of what a search visited: by odds on its data, borne out by held-out data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.evidence import Evidence, best_heldout_gain
from labhil.diagnose.judge import ALPHA, Data
from labhil.diagnose.refit import without
from labhil.diagnose.search_result import SearchResult, Step
from labhil.diagnose.structures.enumerate import Structure, closed
from labhil.diagnose.structures.state import (
    SearchState,
    alternatives,
    as_likely_as_not,
    inclusion,
    log_odds,
    rivals_of,
)  # fmt: skip
from labhil.identify.fitted import Fitted, fit_terms, with_only
from labhil.identify.score import Score

LEADING = 3
"""Structures of a stage with which the next one begins, at most, beside the baseline."""


@dataclass(frozen=True, slots=True)
class Stage:
    """What a search visited on windows of one length."""

    data: Data
    state: SearchState

    @property
    def best(self) -> Fitted:
        """The fit of the best structure."""
        return self.state.refitted[self.state.best].fitted

    @property
    def leading(self) -> list[Fitted]:
        """The baseline and the likeliest structures."""
        by_evidence = sorted(self.state.refitted, key=lambda s: -self.state.refitted[s].log_evidence)
        chosen = dict.fromkeys([frozenset[str](), *by_evidence[:LEADING]])
        return [self.state.refitted[structure].fitted for structure in chosen]


def concluded(stage: Stage, claim: float, looks: int) -> SearchResult:
    """The best structure with its rivals; nothing where the data do not speak for it."""
    state, model = stage.state, stage.data.model
    base = state.refitted[frozenset()].fitted
    best = state.best
    claims = {term: log_odds(model, state, term) for term in best}
    shares = inclusion(state)
    steps = [_step(term, odds, shares[term]) for term, odds in claims.items() if odds > claim]
    steps.sort(key=lambda s: s.evidence.delta_bic)
    known = state.log_evidence()
    p_value = float(np.exp(min(known[frozenset()] - known[best], 0.0)))
    claimed = closed(model, (step.terms[0] for step in steps), frozenset(base.terms))
    found = SearchResult(
        base,
        _with_only(stage, claimed),
        tuple(steps),
        rivals_of(state, best),
        p_value,
        looks,
        open=as_likely_as_not(state),
        disturbed=state.refitted[best].log_evidence - state.refitted[best].undisturbed > claim,
        alternatives=alternatives(state),
    )
    return found.ending(found.final, found.missing)


def _with_only(stage: Stage, structure: Structure) -> Fitted:
    """The best fit, without terms of which too little is known to claim them."""
    state = stage.state
    if structure in state.refitted:
        return state.refitted[structure].fitted
    data, near = stage.data, state.refitted[state.best].fitted
    kept = [t for t in near.terms if t not in state.best or t in structure]
    start = with_only(data.model, near.theta, kept)
    return fit_terms(
        data.model, data.search, kept, data.window, data.sigma, start=start, starts=[{}],
        states=near.solution.point.states, held=data.held,
    )  # fmt: skip


def _step(term: str, odds: float, probability: float) -> Step:
    """A claim as the searched data make it; held-out data are asked later."""
    return Step((term,), Evidence(-2.0 * odds, 1.0, 0.0), float(np.exp(-odds)), True, probability)


def borne_out(stage: Stage, found: SearchResult) -> SearchResult:
    """Only what held-out data bear out, too, so that chance makes a tenth of the claims at most.

    The one that they bear out least goes first (Benjamini and Hochberg 1995: of m claims the largest p value
    has to be below α); without it the other doubtful ones are asked anew, and in the end all.
    """
    baseline = frozenset(found.baseline.terms)
    asked = _terms(found.missing)
    while found.missing:
        found = replace(found, missing=_validated(stage, found, asked))
        doubtful = [step for step in found.missing if step.evidence.p_value >= ALPHA]
        if doubtful:
            least = max(doubtful, key=lambda step: step.evidence.p_value)
            kept = frozenset(without(stage.data.model, found.final.terms, least.terms[0])) - baseline
            steps = tuple(step for step in found.missing if step.terms[0] in kept)
            found = found.ending(_with_only(stage, kept), steps)
            asked = _terms(doubtful) & kept or _terms(found.missing)
        elif asked == _terms(found.missing):
            break
        else:
            asked = _terms(found.missing)
    return found


def _terms(steps: Sequence[Step]) -> Structure:
    return frozenset(step.terms[0] for step in steps)


def _validated(stage: Stage, found: SearchResult, asked: Structure) -> tuple[Step, ...]:
    """The steps, with what held-out data gain by each of ``asked``: against the final model without it."""
    data, final = stage.data, found.final
    after = data.judge(final.theta)

    def validated(step: Step) -> Step:
        terms = without(data.model, final.terms, step.terms[0])
        reduced = _with_only(stage, frozenset(terms) - frozenset(found.baseline.terms))
        gain, p_value = best_heldout_gain(data.judge(reduced.theta), after)
        return replace(step, evidence=Evidence(step.evidence.delta_bic, p_value, gain))

    return tuple(validated(step) if step.terms[0] in asked else step for step in found.missing)


def predicts_better(before: Sequence[Score], after: Sequence[Score]) -> bool:
    """Whether held-out data bear out a step: errors fall along it on windows of some length."""
    return best_heldout_gain(before, after)[1] < ALPHA
