"""The structures that a search has visited: odds, probability, relevance and rivals of each term."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import expit

from labhil.diagnose.search_result import Alternative, Rival
from labhil.diagnose.structures.enumerate import (
    Choice,
    Enumeration,
    Predicted,
    Structure,
    relevance,
    with_disturbance,
)
from labhil.identify.fitted import Fitted
from labhil.physics.model import Model
from labhil.signals import BoolArray

UNLIKELY = 1e-4
"""Probability below which what a structure estimates can move no interval at 99 %."""

UNDECIDED = 0.1
"""Probability from which a term that is not named is as open as one that is not there."""


@dataclass(frozen=True, slots=True)
class Refitted:
    """A structure's own fit, its log evidence where that stands, and what its terms explain there."""

    fitted: Fitted
    log_evidence: float
    undisturbed: float
    choice: Choice
    view: Enumeration
    relevance: Mapping[str, float]

    def acts(self, terms: Collection[str]) -> BoolArray:
        """Outputs (c,) that some of its terms change."""
        responses = self.view.responses
        return np.any([responses.acts(v) for v in self.choice if v.term in terms], axis=0)


@dataclass(slots=True)
class SearchState:
    """The structures a stage has visited: refitted ones, and all as the newest linearisation predicts them.

    ``least`` is what a term explains over what no term does, at least; ``linearised`` are the structures at
    which the others were compared.
    """

    least: float
    refitted: dict[Structure, Refitted] = field(default_factory=dict)
    predicted: dict[Structure, Predicted] = field(default_factory=dict)
    view: Enumeration | None = None
    linearised: set[Structure] = field(default_factory=set)

    @property
    def relevant(self) -> dict[Structure, Refitted]:
        """Refitted structures each of whose terms explains enough."""
        return {s: r for s, r in self.refitted.items() if least_relevance(self.relevance(s)) >= self.least}

    def most(self, evidence: Callable[[Refitted], float]) -> Structure:
        """The refitted structure with the most evidence of a kind."""
        return max(self.refitted, key=lambda s: evidence(self.refitted[s]))

    @property
    def likeliest(self) -> Structure:
        """The refitted structure with the largest evidence."""
        return self.most(with_disturbance)

    @property
    def best(self) -> Structure:
        """The one of the relevant structures with the largest evidence."""
        relevant = self.relevant
        return max(relevant, key=lambda s: relevant[s].log_evidence)

    def relevance(self, structure: Structure) -> dict[str, float]:
        """What each term of a refitted structure explains over what that leaves: by refits, where known."""
        refit = self.refitted[structure]
        shares = dict(refit.relevance)
        for term in shares:
            reduced = self.refitted.get(structure - {term})
            if reduced is not None:
                lacking, having = reduced.fitted.mean_squares, refit.fitted.mean_squares
                shares[term] = relevance(lacking, having, refit.acts([term]))
        return shares

    def values_of(self, structure: Structure) -> Mapping[str, float]:
        """Values by key that the newest linearisation predicts of a structure, if any."""
        predicted = self.predicted.get(structure)
        if predicted is None or self.view is None:
            return {}
        return self.view.responses.sizes(predicted.choice, predicted.sizes)

    def log_evidence(self) -> dict[Structure, float]:
        """Log evidence of the visited structures, but for likelier ones whose terms explain too little."""
        logs = {s: p.log_evidence for s, p in self.predicted.items()}
        logs |= {s: r.log_evidence for s, r in self.refitted.items()}
        most = self.refitted[self.best].log_evidence
        return {structure: value for structure, value in logs.items() if value <= most}


def least_relevance(relevance: Mapping[str, float]) -> float:
    """The smallest relevance of a structure's terms; without terms there is none."""
    return min(relevance.values(), default=np.inf)


def inclusion(state: SearchState) -> dict[str, float]:
    """Return the posterior probability of every term: of all visited structures that have it."""
    log_evidence = state.log_evidence()
    structures, logs = list(log_evidence), np.array(list(log_evidence.values()))
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    probabilities: dict[str, float] = {}
    for structure, weight in zip(structures, weights.tolist(), strict=True):
        for term in structure:
            probabilities[term] = min(probabilities.get(term, 0.0) + weight, 1.0)
    return probabilities


def alternatives(state: SearchState) -> tuple[Alternative, ...]:
    """What every refitted structure estimates, with its probability among these."""
    log_evidence = state.log_evidence()
    kept = [s for s in state.refitted if np.isfinite(log_evidence.get(s, -np.inf))]
    logs = np.array([log_evidence[s] for s in kept])
    weights = np.exp(logs - logs.max())
    fits = [state.refitted[s].fitted for s in kept]
    return tuple(
        Alternative(share, fit.estimates)
        for share, fit in zip((weights / weights.sum()).tolist(), fits, strict=True)
        if share > UNLIKELY
    )


def log_odds(model: Model, state: SearchState, term: str) -> float:
    """Return the log odds that the best structure needs a term, whatever else builds on it.

    Against the structure without it as that was refitted, or as the best one's own linearisation predicts it.
    """
    best = state.best
    refit = state.refitted[best]
    alone = [v for v in refit.choice if v.term != term]
    without = refit.view.evaluate([tuple(alone)])[0].log_evidence
    carriers = {t for t in best if term in model.terms[t].with_terms}
    reduced = state.refitted.get(best - {term})
    # a structure with a size at its bound explains nothing, and is no comparison
    if not carriers and reduced is not None and np.isfinite(reduced.log_evidence):
        without = reduced.log_evidence
    return refit.log_evidence - without


def as_likely_as_not(state: SearchState) -> tuple[str, ...]:
    """Terms of which the refitted structures with and without them are within odds of nine to one."""
    logs = {structure: refit.log_evidence for structure, refit in state.refitted.items()}
    open_terms = []
    for term in sorted({term for structure in logs for term in structure} - state.best):
        having, lacking = (
            max(value for structure, value in logs.items() if (term in structure) == included)
            for included in (True, False)
        )
        probability = float(expit(having - lacking))
        if UNDECIDED <= probability <= 1.0 - UNDECIDED:
            open_terms.append(term)
    return tuple(open_terms)


def rivals_of(state: SearchState, best: Structure) -> tuple[Rival, ...]:
    """Return Structures that have another term in the place of one, within 5 nats."""
    log_evidence, rivals, shares = state.log_evidence(), [], inclusion(state)
    for structure, value in log_evidence.items():
        gone, new = best - structure, structure - best
        if len(gone) == 1 and len(new) == 1 and log_evidence[best] - value < 5.0:
            rival = next(iter(new))
            rivals.append(Rival(rival, next(iter(gone)), 2.0 * (log_evidence[best] - value), shares[rival]))
    return tuple(sorted(rivals, key=lambda r: r.delta_bic))
