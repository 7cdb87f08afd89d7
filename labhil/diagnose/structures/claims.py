"""The claims that a search allows: by odds on its data, borne out by held-out data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.evidence import Evidence, best_heldout_gain
from labhil.diagnose.judge import ALPHA, Data
from labhil.diagnose.refit import without
from labhil.diagnose.search_result import SearchResult, Step
from labhil.diagnose.structures.enumerate import Structure, closure
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


def conclude_search(stage: Stage, claim: float, looks: int) -> SearchResult:
    """State the best structure with its rivals; no terms where the data do not speak for them."""
    state, model = stage.state, stage.data.model
    base = state.refitted[frozenset()].fitted
    best = state.best
    claims = {term: log_odds(model, state, term) for term in best}
    shares = inclusion(state)
    steps = [_step(term, odds, shares[term]) for term, odds in claims.items() if odds > claim]
    steps.sort(key=lambda s: s.evidence.delta_bic)
    log_evidence = state.log_evidence()
    p_value = float(np.exp(min(log_evidence[frozenset()] - log_evidence[best], 0.0)))
    claimed = closure(model, (step.terms[0] for step in steps), frozenset(base.terms))
    result = SearchResult(
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
    return result.with_steps(result.final, result.missing)


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
    """A claim as the searched data make it; held-out data validate it later."""
    return Step((term,), Evidence(-2.0 * odds, 1.0, 0.0), float(np.exp(-odds)), probability)


def validate_claims(stage: Stage, result: SearchResult) -> SearchResult:
    """Keep the claims that held-out data bear out, so that chance makes a tenth of them at most.

    The claim that they bear out least goes first (Benjamini and Hochberg 1995: of m claims the largest p
    value has to be below α); without it the other doubtful ones are tested anew, and in the end all.
    """
    baseline = frozenset(result.baseline.terms)
    tested = _terms(result.missing)
    while result.missing:
        result = replace(result, missing=_validate(stage, result, tested))
        doubtful = [step for step in result.missing if step.evidence.p_value >= ALPHA]
        if doubtful:
            least = max(doubtful, key=lambda step: step.evidence.p_value)
            kept = frozenset(without(stage.data.model, result.final.terms, least.terms[0])) - baseline
            steps = tuple(step for step in result.missing if step.terms[0] in kept)
            result = result.with_steps(_with_only(stage, kept), steps)
            tested = _terms(doubtful) & kept or _terms(result.missing)
        elif tested == _terms(result.missing):
            break
        else:
            tested = _terms(result.missing)
    return result


def _terms(steps: Sequence[Step]) -> Structure:
    return frozenset(step.terms[0] for step in steps)


def _validate(stage: Stage, result: SearchResult, tested: Structure) -> tuple[Step, ...]:
    """The steps, with what held-out data gain by each of ``tested``: against the final model without it."""
    data, final = stage.data, result.final
    after = data.score_held_out(final.theta)

    def validate(step: Step) -> Step:
        terms = without(data.model, final.terms, step.terms[0])
        reduced = _with_only(stage, frozenset(terms) - frozenset(result.baseline.terms))
        gain, p_value = best_heldout_gain(data.score_held_out(reduced.theta), after)
        return replace(step, evidence=Evidence(step.evidence.delta_bic, p_value, gain))

    return tuple(validate(step) if step.terms[0] in tested else step for step in result.missing)


def predicts_better(before: Sequence[Score], after: Sequence[Score]) -> bool:
    """Whether held-out data bear out a step: errors fall along it on windows of some length."""
    return best_heldout_gain(before, after)[1] < ALPHA
