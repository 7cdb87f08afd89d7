"""Search over model structures on windows of one length, by linearisation and refits in turn.

All structures are compared on the linearisation of a fit (enumerate.py), the best are refitted by simulation,
and the search linearises again at the best refit until that stays the best. State in state.py; the sequence
of window lengths in stages.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from labhil.diagnose.judge import Data
from labhil.diagnose.refit import without
from labhil.diagnose.structures.enumerate import (
    EVIDENCES,
    MIN_RELEVANCE,
    BeamOptions,
    Enumeration,
    HasLogEvidence,
    Prediction,
    relevance,
    with_disturbance,
)
from labhil.diagnose.structures.prior import Structure, candidates, described
from labhil.diagnose.structures.responses import compute_responses
from labhil.diagnose.structures.state import (
    Exchange,
    RefittedStructure,
    SearchState,
    convergence_deficit,
    smallest_relevance,
)
from labhil.identify.fitted import INTERMEDIATE_TOLERANCE, Fitted, fit_terms, with_only
from labhil.identify.waves import starts_for_added_terms
from labhil.physics.model import index_of
from labhil.signals import FloatArray

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class SearchOptions:
    """Options of a structure search.

    Values without a source are heuristics; benchmarks/measuring/measure_ablation.py measures several of them.

    Attributes:
        window_horizons: length of the windows of each stage, in scored horizons.
        max_rounds: largest number of linearisations in each stage.
        max_refits: largest number of structures that are refitted in each round.
        refit_margin: log odds (nats) by which a structure may be behind the best one to be refitted.
        min_log_odds: log odds (nats) that the best structure needs over the one without a term: 5 is a Bayes
            factor of 150, very strong evidence (Kass and Raftery 1995).
        min_relevance: smallest relevance of a claimed term, see `enumerate.relevance`.
        min_step_relevance: smallest relevance of a term, and of a structure over the last linearised one,
            while the search goes on: of four equal missing effects one explains a third of the other three.
        max_added_terms: structures are compared with at most so many terms more than the linearised fit.
        max_terms_for_subsets: the search linearises also at subsets of a best structure of at most so many
            terms; a larger one was reached by way of its subsets.
        max_residual_in_noise: RMS of the residuals in noise levels from which missing physics outweighs the
            noise, √2 where both are equal. Then no longer windows are searched, and single terms are
            refitted.
    """

    window_horizons: tuple[float, ...] = (0.375, 1.5, 3.0)
    max_rounds: int = 5
    max_refits: int = 3
    refit_margin: float = 5.0
    min_log_odds: float = 5.0
    min_relevance: float = MIN_RELEVANCE
    min_step_relevance: float = 1.0 / 3.0
    max_added_terms: int = 2
    max_terms_for_subsets: int = 4
    max_residual_in_noise: float = np.sqrt(2.0)


@dataclass(frozen=True, slots=True)
class StructureSearch:
    """A search over sets of terms that are added to a baseline.

    Attributes:
        data: searched data, model, and length of the windows.
        baseline: keys of the terms that every structure has.
        correlation: (c,), first-order autocorrelation of the noise.
        progress: is called with a line of text before each step.
        options: options of the search.
        nominal: nominal values by key of the rig's own parameters that the baseline takes far from them.
            Refits begin there, too: with the missing physics these parameters may return.
    """

    data: Data
    baseline: tuple[str, ...]
    correlation: FloatArray
    progress: Progress
    options: SearchOptions = SearchOptions()
    nominal: Mapping[str, float] = field(default_factory=dict)

    @property
    def n_candidates(self) -> int:
        """Number of terms that may be added."""
        return len(candidates(self.data.model, self.baseline))

    def run(self, begin: Sequence[Fitted]) -> SearchState:
        """Search until no more probable structure is left to refit.

        Args:
            begin: fits of some structures, the baseline among them, on the windows of this search.

        Returns:
            All visited structures.
        """
        state = SearchState(min_relevance=self.options.min_relevance)
        for fitted in begin:
            self._record(state, fitted)
        self._linearise_until_stable(state)
        if self._is_far(state, state.likeliest):
            self._refit_single_terms(state)
            self._linearise_until_stable(state)
        while len(state.likeliest) <= self.options.max_terms_for_subsets and self._search_subsets(state):
            self._linearise_until_stable(state)
        # before terms are dropped: with a wrong order of cogging it explains little
        for structure in dict.fromkeys((frozenset[str](), state.likeliest)):
            self._refit_shapes(state, structure)
        self._drop_irrelevant(state, state.likeliest, state.min_relevance)
        if not state.best and self._is_far(state, state.best):
            self._refit_single_terms(state)
        if state.best not in (frozenset(), state.likeliest):
            self._refit_shapes(state, state.best)
            self._refit_exchanges(state)
        return state

    def _linearise_until_stable(self, state: SearchState) -> None:
        """Linearise at the best structure and refit the promising ones, until the best one stays the same.

        The same is done at the best structure given that there is no disturbance: far from the data a
        disturbance can stand for several missing effects, none of which explains most alone.
        """
        for _ in range(self.options.max_rounds):
            new = False
            for evidence in EVIDENCES:
                best = self._drop_irrelevant(state, state.best_by(evidence), self.options.min_step_relevance)
                if best not in state.linearised and self._is_improvement(state, best):
                    self._linearise(state, best)
                    self._refit_limits(state, best)
                    self._refit_promising(state, evidence)
                    new = True
            if not new:
                break

    def _is_improvement(self, state: SearchState, structure: Structure) -> bool:
        """Whether a structure is relevant enough over the best linearised one."""
        if not state.linearised:
            return True
        nearest = max(state.linearised, key=lambda s: state.refitted[s].log_evidence)
        before, after = (state.refitted[s].fitted.mean_squares for s in (nearest, structure))
        refit = state.refitted[structure]
        new = (
            refit.affected_outputs(structure - nearest)
            if structure - nearest
            else np.ones(len(before), dtype=bool)
        )
        return relevance(before, after, new) >= self.options.min_step_relevance

    def _linearise(self, state: SearchState, structure: Structure) -> None:
        """Linearise at a refitted structure, and predict the evidence of all others."""
        near = state.refitted[structure].fitted
        self.progress(f"evidence of all structures, linearised at {described(structure)}")
        state.linearised.add(structure)
        state.enumeration = self._linearisation_at(near)
        state.predicted = state.enumeration.search_beam()

    def _search_subsets(self, state: SearchState) -> bool:
        """Linearise at structures with fewer terms than the best one until a better one shows.

        The joint effect of two terms may show only at a fit with one of them, and the replacement of a term
        only at a fit without it.

        Returns:
            Whether a better structure was found.
        """
        before = state.likeliest
        for size in range(1, len(before)):
            likely = [p for s, p in state.predicted.items() if len(s) == size and s not in state.refitted]
            if likely:
                self._refit_predicted(state, [max(likely, key=lambda p: p.log_evidence)])
            refitted = [s for s in state.refitted if len(s) == size]
            if refitted and self._linearise_elsewhere(
                state, max(refitted, key=lambda s: state.refitted[s].log_evidence)
            ):
                return True
        for term in sorted(before):
            reduced = frozenset(without(self.data.model, tuple(before), term))
            # also where it was refitted before: from there it may have reached a higher minimum only
            self._refit_and_record(state, state.refitted[before].fitted, reduced, {})
            if self._linearise_elsewhere(state, reduced):
                return True
        return False

    def _linearise_elsewhere(self, state: SearchState, structure: Structure) -> bool:
        """Linearise at a structure other than the best one, and return whether a better one was found."""
        if structure in state.linearised:
            return False
        before = state.likeliest
        self._linearise(state, structure)
        longer = [p for s, p in state.predicted.items() if structure < s and s not in state.refitted]
        if longer:  # with one more term and the terms that it builds on
            fewest = min(len(p.structure) for p in longer)
            nearest = [p for p in longer if len(p.structure) == fewest]
            self._refit_predicted(state, [max(nearest, key=lambda p: p.log_evidence)])
        self._refit_promising(state, with_disturbance)
        return state.likeliest != before

    def _is_far(self, state: SearchState, structure: Structure) -> bool:
        """Whether missing physics outweighs the noise, so that a linearisation may mislead.

        That of inverse dynamics, which has no states, is exact in sizes: there only if it shows nothing.
        """
        is_far = state.refitted[structure].fitted.noise > self.options.max_residual_in_noise
        return is_far and (not structure or bool(self.data.model.state_names))

    def _refit_single_terms(self, state: SearchState) -> None:
        """Refit every single term: what a linearisation far from the data does not show, a fit may.

        A short fit that explains too little for the search to continue from it is not continued.
        """
        near = state.refitted[frozenset()].fitted
        singles = [frozenset(terms) for terms in candidates(self.data.model, self.baseline)]
        enough = near.solution.cost / (1.0 + self.options.min_step_relevance)
        self._refit_each(state, near, [s for s in singles if s not in state.refitted], max_scout_cost=enough)

    def _drop_irrelevant(self, state: SearchState, structure: Structure, least: float) -> Structure:
        """Drop terms of too little relevance one by one, the smallest first, and refit after each.

        A structure that was refitted before is refitted again where it stands higher than a term of so little
        relevance can explain: it ended in another minimum.
        """
        while smallest_relevance(shares := state.relevance(structure)) < least:
            near = state.refitted[structure].fitted
            structure = structure - {min(shares, key=lambda term: shares[term])}
            before, tried = state.refitted.get(structure), (structure, near.solution.cost)
            is_high = before is None or before.fitted.solution.cost > (1.0 + least) * near.solution.cost
            if is_high and tried not in state.reduced:
                state.reduced.add(tried)
                self._refit_and_record(state, near, structure, {})
        return structure

    def _refit_limits(self, state: SearchState, best: Structure) -> None:
        """Refit a structure with a term's limit of zero width in its place, begun at that term's size."""
        model = self.data.model
        theta, places = state.refitted[best].fitted.theta, index_of(model.parameters)
        for term in best:
            narrow = model.terms[term].narrow
            if not narrow or narrow in best or (best - {term}) | {narrow} in state.refitted:
                continue
            size, term_size = (places[model.terms[key].parameters[0].key] for key in (narrow, term))
            values = {model.parameters[size].key: max(float(theta[term_size]), 0.0)}
            self._refit_and_record(state, state.refitted[best].fitted, (best - {term}) | {narrow}, values)

    def _refit_shapes(self, state: SearchState, structure: Structure) -> None:
        """Refit a structure from other starts of its shape parameters, which other terms may have biased.

        Each start has a whole fit: beside a fit that stands in its minimum no short one from elsewhere wins.
        """
        near, model = state.refitted[structure].fitted, self.data.model
        shaped = [t for t in near.terms if any(p.shape for p in model.terms[t].parameters)]
        starts = [start for term in shaped for start in starts_for_added_terms(near, [term])]
        fits = near.problem.side_by_side(lambda start: self._fit_from(near, near.terms, [start]), starts)
        for fitted in fits:
            self._record(state, fitted)

    def _refit_exchanges(self, state: SearchState) -> None:
        """Refit the likeliest structure with the rivals of the best one's terms in their place.

        The best structure lacks the terms of too little relevance. Two terms with nearly the same effect may
        differ more beside the error that these leave than beside these.
        """
        best, likeliest, relevant = state.best, state.likeliest, state.relevant
        rivals = [e for s in relevant if (e := Exchange.between(best, s)) and e.applies_to(likeliest)]
        rivals.sort(key=lambda e: -relevant[e.of(best)].log_evidence)
        for exchange in rivals[: self.options.max_refits]:
            estimates = relevant[exchange.of(best)].fitted.estimates
            values = {p.key: estimates[p.key] for p in self.data.model.terms[exchange.added].parameters}
            self._refit_and_record(state, state.refitted[likeliest].fitted, exchange.of(likeliest), values)

    def _linearisation_at(self, fitted: Fitted, absent: Sequence[str] | None = None) -> Enumeration:
        """The linearisation at a fit, with its own terms and all others, or those in ``absent`` only."""
        term_responses = compute_responses(self.data, fitted, self.baseline, self.correlation, absent=absent)
        return Enumeration(
            self.data.model,
            term_responses,
            frozenset(self.baseline),
            self.n_candidates,
            self._beam_options(fitted),
        )

    def _beam_options(self, near: Fitted) -> BeamOptions:
        """Options of the beam search from a fit.

        Far from the data many terms together can imitate any effect, so only a few terms are added, except
        where responses are exact (inverse dynamics).
        """
        if not self.data.model.state_names:
            return BeamOptions()
        added = frozenset(near.terms) - frozenset(self.baseline)
        return BeamOptions(max_terms=len(added) + self.options.max_added_terms)

    def _refit_promising(self, state: SearchState, evidence: Callable[[HasLogEvidence], float]) -> None:
        """Refit the structures of highest predicted evidence that were not refitted yet.

        Where all of these have a size at its bound, the best ones without these terms are refitted in turn:
        a linearisation knows no bounds.
        """
        least = evidence(state.refitted[state.best_by(evidence)]) - self.options.refit_margin
        predicted = state.corrected_predictions().values()
        new = [p for p in predicted if p.structure not in state.refitted and evidence(p) > least]
        while new:
            promising = sorted(new, key=evidence, reverse=True)[: self.options.max_refits]
            self._refit_predicted(state, promising)
            bounded = [state.refitted[p.structure].at_bound for p in promising]
            if not all(bounded):
                break
            new = [p for p in new if p.structure.isdisjoint(frozenset().union(*bounded))]

    def _refit_predicted(self, state: SearchState, predicted: Sequence[Prediction]) -> None:
        """Refit structures from the fit where they were predicted, with their predicted values."""
        assert state.enumeration is not None
        self._refit_each(
            state, state.enumeration.responses.fitted, [prediction.structure for prediction in predicted]
        )

    def _refit_each(
        self,
        state: SearchState,
        near: Fitted,
        structures: Sequence[Structure],
        max_scout_cost: float = np.inf,
    ) -> None:
        """Refit structures from one fit, in parallel, with their predicted values."""
        values = [state.values_of(structure) for structure in structures]
        for structure in structures:
            self.progress(f"refitting {described(structure)}")
        pairs = list(zip(structures, values, strict=True))
        fits = near.problem.side_by_side(lambda pair: self._refit(near, *pair, max_scout_cost), pairs)
        for fitted, begun in zip(fits, values, strict=True):
            self._record_better(state, fitted, begun)

    def _refit_and_record(
        self, state: SearchState, near: Fitted, structure: Structure, values: Mapping[str, float]
    ) -> None:
        """Refit a structure from a nearby fit, and record the better of that and a refit from a subset."""
        self._record_better(state, self._refit(near, structure, values), values)

    def _record_better(self, state: SearchState, fitted: Fitted, values: Mapping[str, float]) -> None:
        """Record a fit, or a refit from a subset of its structure where that has a lower cost."""
        structure = frozenset(fitted.terms) - frozenset(self.baseline)
        subsets = [r.fitted for s, r in state.refitted.items() if s < structure]
        best = min(subsets, key=lambda subset: subset.solution.cost, default=fitted)
        if best.solution.cost < fitted.solution.cost:
            again = self._refit(best, structure, values)
            fitted = min((fitted, again), key=lambda fit: fit.solution.cost)
        self._record(state, fitted)

    def _refit(
        self, near: Fitted, structure: Structure, values: Mapping[str, float], max_scout_cost: float = np.inf
    ) -> Fitted:
        """Fit a structure from another fit with these values by key; a short fit where the cost is high."""
        model = self.data.model
        terms = (*self.baseline, *(t for t in model.terms if t in structure))
        fresh = [t for t in terms if t not in near.terms]
        starts: list[Mapping[str, float]] = [values]
        if fresh:
            starts += starts_for_added_terms(near, fresh)[1:2]
        if self.nominal:
            starts.append({**values, **self.nominal})
        return self._fit_from(near, terms, starts, max_scout_cost)

    def _fit_from(
        self,
        near: Fitted,
        terms: Sequence[str],
        starts: Sequence[Mapping[str, float]],
        max_scout_cost: float = np.inf,
    ) -> Fitted:
        """Fit terms from another fit, with each of these sets of values by key."""
        return fit_terms(
            self.data.model, self.data.search, terms, self.data.window, self.data.sigma,
            start=with_only(self.data.model, near.theta, terms), starts=starts,
            states=near.solution.point.states, iterations=25,
            tolerance=INTERMEDIATE_TOLERANCE, held=self.data.held,
            max_scout_cost=max_scout_cost,
        )  # fmt: skip

    def _record(self, state: SearchState, fitted: Fitted) -> None:
        """Record a fit with its evidence, unless the state has a better fit of the same structure."""
        structure = frozenset(fitted.terms) - frozenset(self.baseline)
        previous = state.refitted.get(structure)
        if previous is not None and previous.fitted.solution.cost <= fitted.solution.cost:
            return
        enumeration = self._linearisation_at(fitted, absent=())
        variants = enumeration.responses.variants
        choice = tuple(variants[t][0] for t in fitted.terms if t in structure and t in variants)
        prediction = enumeration.evaluate([choice])[0]
        # a size at its bound shows that the effect is of another kind
        at_bound = self._terms_at_bound(fitted, structure)
        correction = -np.inf if at_bound else 0.0
        correction += convergence_deficit(fitted, enumeration.responses.grams.dof)
        state.refitted[structure] = RefittedStructure(
            fitted,
            prediction.log_evidence + correction,
            prediction.undisturbed + correction,
            choice,
            enumeration,
            enumeration.relevance(choice),
            at_bound,
        )

    def _terms_at_bound(self, fitted: Fitted, structure: Structure) -> Structure:
        """The added terms with a size at a bound other than zero."""
        parameters, places = self.data.model.parameters, index_of(self.data.model.parameters)
        sizes = [(p, float(fitted.theta[places[p.key]])) for p in parameters if not p.shape]
        return frozenset(p.term for p, value in sizes if p.term in structure and value and p.at_bound(value))
