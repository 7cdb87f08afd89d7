"""State of a structure search: the structures visited so far, with odds, probabilities and rivals of terms.

The state is filled by search.py and read by claims.py.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit

from labhil.diagnose.search_result import Alternative, Rival
from labhil.diagnose.structures.enumerate import Choice, Enumeration, Prediction, relevance, with_disturbance
from labhil.diagnose.structures.prior import Structure
from labhil.diagnose.structures.responses import linearise_to_flatter_side
from labhil.identify.fitted import Fitted
from labhil.physics.model import Model
from labhil.signals import BoolArray


@dataclass(frozen=True, slots=True)
class RefittedStructure:
    """A structure that was refitted by simulation, with its evidence on the linearisation at that fit.

    Attributes:
        fitted: the fit.
        log_evidence: marginalised over the disturbance, prior of the structure included.
        undisturbed: the same given that there is no disturbance.
        choice: variant of each term.
        enumeration: the linearisation at the fit, with the responses of the fit's own terms.
        relevance: relevance of each term as that linearisation predicts it.
        at_bound: terms with a size at its bound; with any, there is no evidence.
    """

    fitted: Fitted
    log_evidence: float
    undisturbed: float
    choice: Choice
    enumeration: Enumeration
    relevance: Mapping[str, float]
    at_bound: Structure = frozenset()

    def affected_outputs(self, terms: Collection[str]) -> BoolArray:
        """Whether any of these terms changes an output, (c,)."""
        responses = self.enumeration.responses
        return np.any([responses.affected_outputs(v) for v in self.choice if v.term in terms], axis=0)


def convergence_deficit(fitted: Fitted, dof: float) -> float:
    """Log likelihood (≤ 0) of an unconverged fit over that of the minimum of its linearisation.

    The evidence assumes that a fit stands at the minimum of its linearisation.

    Args:
        fitted: the fit.
        dof: number of independent residuals.
    """
    if fitted.solution.converged:
        return 0.0
    problem, solution = fitted.problem, fitted.solution
    lin = linearise_to_flatter_side(problem, solution)
    projected = problem.project(lin, np.column_stack([solution.residuals, lin.by_parameters]))
    residuals, slopes = projected[:, 0], projected[:, 1:]
    minimum = residuals - slopes @ np.linalg.lstsq(slopes, residuals, rcond=None)[0]
    squares = max(float(solution.residuals @ solution.residuals), 1e-300)
    return 0.5 * dof * min(float(np.log(max(float(minimum @ minimum), 1e-300) / squares)), 0.0)


@dataclass(slots=True)
class SearchState:
    """The structures that a search has visited on windows of one length.

    Attributes:
        min_relevance: smallest relevance of a term that may be claimed.
        refitted: structures that were refitted by simulation.
        predicted: structures as the newest linearisation predicts them.
        enumeration: the newest linearisation.
        linearised: structures at whose fits the others were compared.
        reduced: structures that were refitted again without a term, each with the cost of the fit with it.
        refuted: structures with terms that held-out data speak against, see `claims.refute`.
    """

    min_relevance: float
    refitted: dict[Structure, RefittedStructure] = field(default_factory=dict)
    predicted: dict[Structure, Prediction] = field(default_factory=dict)
    enumeration: Enumeration | None = None
    linearised: set[Structure] = field(default_factory=set)
    reduced: set[tuple[Structure, float]] = field(default_factory=set)
    refuted: set[Structure] = field(default_factory=set)

    @property
    def relevant(self) -> dict[Structure, RefittedStructure]:
        """Refitted structures whose terms all have the smallest relevance or more."""
        return {
            s: r
            for s, r in self.refitted.items()
            if smallest_relevance(self.relevance(s)) >= self.min_relevance
        }

    def best_by(self, evidence: Callable[[RefittedStructure], float]) -> Structure:
        """The refitted structure with the largest evidence of a kind."""
        return max(self.refitted, key=lambda s: evidence(self.refitted[s]))

    @property
    def likeliest(self) -> Structure:
        """The refitted structure with the largest evidence."""
        return self.best_by(with_disturbance)

    @property
    def best(self) -> Structure:
        """The relevant refitted structure with the largest evidence of those that are not refuted."""
        relevant = self.relevant
        return max(relevant.keys() - self.refuted, key=lambda s: relevant[s].log_evidence)

    def relevance(self, structure: Structure) -> dict[str, float]:
        """Relevance of each term of a refitted structure; by the refit without the term, if there is one."""
        refit = self.refitted[structure]
        shares = dict(refit.relevance)
        for term in shares:
            reduced = self.refitted.get(structure - {term})
            if reduced is not None:
                without_term, with_term = reduced.fitted.mean_squares, refit.fitted.mean_squares
                shares[term] = relevance(without_term, with_term, refit.affected_outputs([term]))
        return shares

    def values_of(self, structure: Structure) -> Mapping[str, float]:
        """Parameter values by key that the newest linearisation predicts; empty for an unknown structure."""
        predicted = self.predicted.get(structure)
        if predicted is None or self.enumeration is None:
            return {}
        return self.enumeration.responses.sizes(predicted.choice, predicted.sizes)

    def corrected_predictions(self) -> dict[Structure, Prediction]:
        """The newest linearisation's predictions, lowered by what it overestimates of refitted subsets.

        What a linearisation overestimates of a structure's largest refitted subset it overestimates of the
        structure, too. At the fit of a term that its local slopes do not show, each structure without it
        seems as good.
        """
        known = [
            s for s in self.predicted if s in self.refitted and np.isfinite(self.refitted[s].log_evidence)
        ]
        known.sort(key=lambda s: (len(s), self.refitted[s].log_evidence), reverse=True)

        def correct(predicted: Prediction) -> Prediction:
            subset = next(s for s in known if s <= predicted.structure)  # the empty one, if no other
            before, refitted = self.predicted[subset], self.refitted[subset]
            return replace(
                predicted,
                log_evidence=predicted.log_evidence + min(refitted.log_evidence - before.log_evidence, 0.0),
                undisturbed=predicted.undisturbed + min(refitted.undisturbed - before.undisturbed, 0.0),
            )

        return {structure: correct(predicted) for structure, predicted in self.predicted.items()}

    def log_evidence(self) -> dict[Structure, float]:
        """Log evidence of all visited structures that are neither refuted nor likelier than the best one."""
        logs = {s: p.log_evidence for s, p in self.corrected_predictions().items()}
        logs |= {s: r.log_evidence for s, r in self.refitted.items()}
        most = self.refitted[self.best].log_evidence
        return {s: value for s, value in logs.items() if value <= most and s not in self.refuted}


def smallest_relevance(relevance: Mapping[str, float]) -> float:
    """Smallest relevance of a structure's terms; infinite without terms."""
    return min(relevance.values(), default=np.inf)


def inclusion_probabilities(state: SearchState) -> dict[str, float]:
    """Posterior inclusion probability of every term: that of all visited structures which contain it."""
    log_evidence = state.log_evidence()
    structures, logs = list(log_evidence), np.array(list(log_evidence.values()))
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    probabilities: dict[str, float] = {}
    for structure, weight in zip(structures, weights.tolist(), strict=True):
        for term in structure:
            probabilities[term] = min(probabilities.get(term, 0.0) + weight, 1.0)
    return probabilities


def alternatives(state: SearchState, *, min_probability: float = 1e-4) -> tuple[Alternative, ...]:
    """Estimates of every refitted structure, with its probability among all of them.

    Args:
        state: a finished search.
        min_probability: less probable structures are left out: they cannot move an interval at 99 %.
    """
    log_evidence = state.log_evidence()
    kept = [s for s in state.refitted if np.isfinite(log_evidence.get(s, -np.inf))]
    logs = np.array([log_evidence[s] for s in kept])
    weights = np.exp(logs - logs.max())
    fits = [state.refitted[s].fitted for s in kept]
    return tuple(
        Alternative(share, fit.estimates)
        for share, fit in zip((weights / weights.sum()).tolist(), fits, strict=True)
        if share > min_probability
    )


def log_odds(model: Model, state: SearchState, structure: Structure, term: str) -> float:
    """Log odds of a structure against the same without a term.

    Two structures count as they were refitted, else as the linearisation at the best one predicts them.

    Args:
        model: the model, whose terms state what they build on.
        state: a finished search.
        structure: the best structure or a part of it.
        term: key of a term of that structure.
    """
    best, reduced = state.refitted[state.best], structure - {term}

    def predicted(part: Structure) -> float:
        if part == state.best:
            return best.log_evidence
        choice = tuple(v for v in best.choice if v.term in part)
        return best.enumeration.evaluate([choice])[0].log_evidence

    is_carried = any(term in model.terms[t].with_terms for t in structure)
    refits = [state.refitted[part].log_evidence for part in (structure, reduced) if part in state.refitted]
    # a structure with a parameter at its bound has no evidence, and is no comparison
    if not is_carried and len(refits) == 2 and np.all(np.isfinite(refits)):
        return refits[0] - refits[1]
    return predicted(structure) - predicted(reduced)


def supported_terms(model: Model, state: SearchState, min_log_odds: float) -> dict[str, float]:
    """Log odds of the terms of the best structure that have enough beside the other terms.

    The weakest of the others is dropped, and the rest are compared without it: of two terms that can replace
    each other neither has any odds beside the other, however much they explain together.

    Args:
        model: the model, whose terms state what they build on.
        state: a finished search.
        min_log_odds: log odds (nats) that a term needs.
    """
    structure, supported = state.best, dict[str, float]()
    while others := structure - supported.keys():
        odds = {term: log_odds(model, state, structure, term) for term in others}
        supported |= {term: value for term, value in odds.items() if value > min_log_odds}
        structure -= {min(odds, key=lambda term: odds[term])} - supported.keys()
    return supported


def undecided_terms(state: SearchState, *, min_probability: float = 0.1) -> tuple[str, ...]:
    """Terms outside the best structure that the data neither support nor exclude.

    Args:
        state: a finished search.
        min_probability: a term is undecided if the best refitted structure with it has at least this
            probability against the best one without it, and at most one minus this.

    Returns:
        Keys of the undecided terms.
    """
    logs = {structure: refit.log_evidence for structure, refit in state.refitted.items()}
    open_terms = []
    for term in sorted({term for structure in logs for term in structure} - state.best):
        with_term, without_term = (
            max(value for structure, value in logs.items() if (term in structure) == included)
            for included in (True, False)
        )
        probability = float(expit(with_term - without_term))
        if min_probability <= probability <= 1.0 - min_probability:
            open_terms.append(term)
    return tuple(open_terms)


@dataclass(frozen=True, slots=True)
class Exchange:
    """A term that takes the place of another one in a structure."""

    added: str
    removed: str

    @classmethod
    def between(cls, structure: Structure, other: Structure) -> Exchange | None:
        """The exchange that makes one structure of another; None where more than one term differs."""
        added, removed = other - structure, structure - other
        return cls(*added, *removed) if len(added) == len(removed) == 1 else None

    def applies_to(self, structure: Structure) -> bool:
        """Whether a structure has the term that goes, and lacks the one that comes."""
        return self.removed in structure and self.added not in structure

    def of(self, structure: Structure) -> Structure:
        """The structure after the exchange."""
        return (structure - {self.removed}) | {self.added}


def rivals_of(state: SearchState, best: Structure, *, max_log_odds_in_nats: float = 5.0) -> tuple[Rival, ...]:
    """Terms with which a structure is nearly as probable as with one of the best structure's terms.

    Two terms are compared in the best structure, and in likelier ones that were refitted with either: those
    have also terms of too little relevance to be claimed.

    Args:
        state: a finished search.
        best: the structure to compare with.
        max_log_odds_in_nats: a structure with a rival is behind by less than this, a Bayes factor of about
            150.

    Returns:
        The rivals, the most probable first.
    """
    log_evidence, probabilities = state.log_evidence(), inclusion_probabilities(state)
    deficits = _exchange_deficits(log_evidence, best)
    likelier = {s: r.log_evidence for s, r in state.refitted.items() if r.log_evidence > log_evidence[best]}
    for structure in sorted(likelier, key=lambda s: likelier[s]):
        deficits |= _exchange_deficits(likelier, structure)
    rivals = []
    for e, deficit in deficits.items():
        if e.applies_to(best) and deficit < max_log_odds_in_nats:
            behind = max(deficit, 0.0)
            probability = probabilities[e.removed] * float(np.exp(-behind))
            probability = max(probability, probabilities.get(e.added, 0.0))
            rivals.append(Rival(e.added, e.removed, 2.0 * behind, probability))
    return tuple(sorted(rivals, key=lambda rival: rival.delta_bic))


def _exchange_deficits(log_evidence: Mapping[Structure, float], of: Structure) -> dict[Exchange, float]:
    """Log evidence that a structure loses by each exchange."""
    exchanges = {Exchange.between(of, other): value for other, value in log_evidence.items()}
    return {e: log_evidence[of] - value for e, value in exchanges.items() if e is not None}
