"""Claims that a finished structure search supports: terms by their odds, validated on held-out data.

The search itself is in search.py, the sequence of searches in stages.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.evidence import Evidence, best_heldout_gain
from labhil.diagnose.judge import ALPHA, Data
from labhil.diagnose.refit import without
from labhil.diagnose.search_result import SearchResult, Step
from labhil.diagnose.structures.enumerate import NOISE_RMS_TOLERANCE, relevance
from labhil.diagnose.structures.prior import Structure, closure
from labhil.diagnose.structures.state import (
    SearchState,
    alternatives,
    inclusion_probabilities,
    rivals_of,
    supported_terms,
    undecided_terms,
)
from labhil.identify.fitted import INTERMEDIATE_TOLERANCE, Fitted, fit_terms, with_only
from labhil.identify.score import Score


@dataclass(frozen=True, slots=True)
class Stage:
    """A finished search on windows of one length: its data and its state."""

    data: Data
    state: SearchState

    @property
    def best(self) -> Fitted:
        """The fit of the best structure."""
        return self.state.refitted[self.state.best].fitted

    def leading_fits(self, *, n_structures: int = 3) -> list[Fitted]:
        """Fits of the baseline and of the most probable structures, with which the next stage begins.

        A structure that contains a likelier one is left out (Occam's window of Madigan and Raftery, J. Am.
        Stat. Assoc. 89, 1994): it would take the place of another explanation.

        Args:
            n_structures: structures at most, in addition to the baseline.
        """
        by_evidence = sorted(self.state.refitted, key=lambda s: -self.state.refitted[s].log_evidence)
        kept: list[Structure] = []
        for structure in by_evidence:
            if not any(likelier < structure for likelier in kept):
                kept.append(structure)
        chosen = dict.fromkeys([frozenset[str](), *kept[:n_structures]])
        return [self.state.refitted[structure].fitted for structure in chosen]


def refute(stage: Stage) -> None:
    """Refute structures that predict held-out data far worse than another one, where all leave much out.

    Evidence compares models one of which is complete. Where missing physics outweighs the noise none is, and
    what counts on the short windows of the search may be wrong on those by which the model is judged: a lag
    of the sensor in the place of a rotor's inertia. There a structure is refuted if another one explains so
    much more of the held-out data that the difference is as relevant as a claimed term has to be. Where one
    leaves only noise there, evidence decides. The baseline is what all are compared with, and stays.

    Args:
        stage: a finished search; its state takes the refuted structures.
    """
    state, data = stage.state, stage.data
    squares = {s: data.score_on_metric(r.fitted.theta).excess ** 2 for s, r in state.relevant.items()}
    least = min(squares.values())
    if least <= NOISE_RMS_TOLERANCE**2:
        return

    def is_refuted(square: float) -> bool:
        return relevance(np.array([square]), np.array([least]), np.array([True])) >= state.min_relevance

    state.refuted |= {s for s, square in squares.items() if s and is_refuted(square)}


def conclude_search(stage: Stage, min_log_odds: float, n_candidates: int) -> SearchResult:
    """State the best structure of a search, reduced to the terms with sufficient odds, and its rivals.

    Args:
        stage: a finished search.
        min_log_odds: log odds (nats) that a structure needs over the same without a term.
        n_candidates: number of terms that may be added.

    Returns:
        The result on the searched data; held-out data do not enter.
    """
    state, model = stage.state, stage.data.model
    base = state.refitted[frozenset()].fitted
    best, probabilities = state.best, inclusion_probabilities(state)
    supported = supported_terms(model, state, min_log_odds)
    steps = [_claim(term, odds, probabilities[term]) for term, odds in supported.items()]
    steps.sort(key=lambda s: s.evidence.delta_bic)
    log_evidence = state.log_evidence()
    p_value = float(np.exp(min(log_evidence[frozenset()] - log_evidence[best], 0.0)))
    claimed = closure(model, (step.terms[0] for step in steps), frozenset(base.terms))
    result = SearchResult(
        base,
        _fit_of_part(stage, claimed),
        tuple(steps),
        rivals_of(state, frozenset(supported) if frozenset(supported) in log_evidence else best),
        p_value,
        n_candidates,
        open=undecided_terms(state),
        disturbed=state.refitted[best].log_evidence - state.refitted[best].undisturbed > min_log_odds,
        alternatives=alternatives(state),
    )
    return result.with_steps(result.final, result.missing)


def _fit_of_part(stage: Stage, structure: Structure) -> Fitted:
    """The fit of a part of the best structure; a refit from the best one if the search has no such fit."""
    state = stage.state
    if structure in state.refitted:
        return state.refitted[structure].fitted
    data, near = stage.data, state.refitted[state.best].fitted
    kept = [t for t in near.terms if t not in state.best or t in structure]
    start = with_only(data.model, near.theta, kept)
    return fit_terms(
        data.model, data.search, kept, data.window, data.sigma, start=start, starts=[{}],
        states=near.solution.point.states, iterations=25, tolerance=INTERMEDIATE_TOLERANCE, held=data.held,
    )  # fmt: skip


def _claim(term: str, odds: float, probability: float) -> Step:
    """A claim by the searched data alone; held-out data validate it later."""
    return Step((term,), Evidence(-2.0 * odds, 1.0, 0.0), float(np.exp(-odds)), probability)


def validate_claims(stage: Stage, result: SearchResult) -> SearchResult:
    """Keep the claims that held-out data support, at a false discovery rate of α = ``judge.ALPHA``.

    The claim with the largest p value is dropped while that is not below α (as Benjamini and Hochberg 1995
    require of the largest of m p values). Then the other doubtful claims are tested without it, and in the
    end all claims.

    Args:
        stage: the search that the result belongs to.
        result: its result, with held-out data not yet considered.

    Returns:
        The result with the remaining claims and their gains on held-out data.
    """
    baseline = frozenset(result.baseline.terms)
    tested = _terms(result.missing)
    while result.missing:
        result = replace(result, missing=_validate(stage, result, tested))
        doubtful = [step for step in result.missing if step.evidence.p_value >= ALPHA]
        if doubtful:
            weakest = max(doubtful, key=lambda step: step.evidence.p_value)
            kept = frozenset(without(stage.data.model, result.final.terms, weakest.terms[0])) - baseline
            steps = tuple(step for step in result.missing if step.terms[0] in kept)
            result = result.with_steps(_fit_of_part(stage, kept), steps)
            tested = _terms(doubtful) & kept or _terms(result.missing)
        elif tested == _terms(result.missing):
            break
        else:
            tested = _terms(result.missing)
    return result


def _terms(steps: Sequence[Step]) -> Structure:
    return frozenset(step.terms[0] for step in steps)


def _validate(stage: Stage, result: SearchResult, tested: Structure) -> tuple[Step, ...]:
    """The steps, those of ``tested`` with the gain on held-out data over the final model without the term."""
    data, final = stage.data, result.final
    after = data.score_held_out(final.theta)

    def validate(step: Step) -> Step:
        terms = without(data.model, final.terms, step.terms[0])
        reduced = _fit_of_part(stage, frozenset(terms) - frozenset(result.baseline.terms))
        gain, p_value = best_heldout_gain(data.score_held_out(reduced.theta), after)
        return replace(step, evidence=Evidence(step.evidence.delta_bic, p_value, gain))

    return tuple(validate(step) if step.terms[0] in tested else step for step in result.missing)


def predicts_better(before: Sequence[Score], after: Sequence[Score]) -> bool:
    """Whether errors on held-out data fall significantly (level ``judge.ALPHA``), on windows of some length.

    Args:
        before: scores of the first model on held-out data, on windows of several lengths.
        after: scores of the second model on the same windows.
    """
    return best_heldout_gain(before, after)[1] < ALPHA
