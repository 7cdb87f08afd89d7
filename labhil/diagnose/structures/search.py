"""The search: enumerate all structures, refit the few that matter, linearise at the best, until it stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from labhil.cores import side_by_side
from labhil.diagnose.judge import Data
from labhil.diagnose.refit import without
from labhil.diagnose.structures.enumerate import (
    EVIDENCES,
    RELEVANCE,
    BeamOptions,
    Enumeration,
    Evident,
    Predicted,
    Structure,
    candidates,
    relevance,
    with_disturbance,
)
from labhil.diagnose.structures.responses import linearise_to_flatter_side, responses
from labhil.diagnose.structures.state import (
    Refitted,
    SearchState,
    least_relevance,
)  # fmt: skip
from labhil.identify.fitted import Fitted, fit_terms, with_only
from labhil.identify.waves import starts_beside
from labhil.physics.model import index_of
from labhil.signals import FloatArray

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Options:
    """What governs a search.

    Attributes:
        horizons: length of the windows, in scored horizons, of each stage.
        rounds: linearisations in each stage, at most.
        refits: structures that are refitted in each round, at most.
        margin: nats by which an enumerated structure may be behind the best to be refitted.
        claim: odds (nats) that the best structure needs over the one without a term.
        relevance: what a term explains over what no term does, at least: mean squares beyond the noise. An
            effect that is smaller than what is missing beside it cannot be distinguished from that.
        step: what a structure has to explain of what the one before it leaves, over what remains, for the
            search to go on there, and what each of its terms explains, or it goes on without that: of four
            equal missing effects one explains a third of what the others do.
        few: terms more than those of the fit where responses were taken, up to which structures are compared.
        climbed: terms up to which the search linearises at the best structure's parts, too: a larger one was
            reached by way of its parts.
    """

    horizons: tuple[float, ...] = (0.375, 1.5, 3.0)
    rounds: int = 5
    refits: int = 3
    margin: float = 5.0
    claim: float = 5.0
    relevance: float = RELEVANCE
    step: float = 1.0 / 3.0
    few: int = 2
    climbed: int = 4


OUTWEIGHED = np.sqrt(2.0)
"""Noise levels that a stage's best structure leaves from which what is missing outweighs the noise: longer
windows would add up more of that, and show no more of what acts slowly."""


@dataclass(frozen=True, slots=True)
class StructureSearch:
    """A search over sets of terms that are added to a baseline.

    ``nominal`` are values by key of the rig's own sizes that the baseline takes far from them: refits begin
    there, too, for the physics that is missing may bring them back.
    """

    data: Data
    baseline: tuple[str, ...]
    correlation: FloatArray
    progress: Progress
    options: Options = Options()
    nominal: Mapping[str, float] = field(default_factory=dict)

    @property
    def candidates(self) -> int:
        """How many terms may be added."""
        return len(candidates(self.data.model, self.baseline))

    def run(self, begin: Sequence[Fitted]) -> SearchState:
        """Search from fits of some structures until nothing likelier is left to refit."""
        state = SearchState(least=self.options.relevance)
        for fitted in begin:
            self._enter(state, fitted)
        self._settle(state)
        if not state.likeliest:
            self._refit_singles(state)
            self._settle(state)
        while len(state.likeliest) <= self.options.climbed and self._climb(state):
            self._settle(state)
        self._reduce(state, state.likeliest, state.least)
        if not state.best:
            self._refit_singles(state)
        for structure in {frozenset[str](), state.best}:
            self._refit_shapes(state, structure)
        return state

    def _settle(self, state: SearchState) -> None:
        """Linearise at the best structure and refit the likelier ones there, until it is the best one itself.

        And at the one that would be best if nothing disturbed: from afar a disturbance stands in for several
        effects of which none explains most by itself.
        """
        for _ in range(self.options.rounds):
            new = False
            for evidence in EVIDENCES:
                best = self._reduce(state, state.most(evidence), self.options.step)
                if best not in state.linearised and self._leads_on(state, best):
                    self._linearise(state, best)
                    self._refit_narrowed(state, best)
                    self._refit_promising(state, evidence)
                    new = True
            if not new:
                break

    def _leads_on(self, state: SearchState, structure: Structure) -> bool:
        """Whether a structure explains enough of what the best linearised one leaves."""
        if not state.linearised:
            return True
        nearest = max(state.linearised, key=lambda s: state.refitted[s].log_evidence)
        before, after = (state.refitted[s].fitted.mean_squares for s in (nearest, structure))
        refit = state.refitted[structure]
        new = refit.acts(structure - nearest) if structure - nearest else np.ones(len(before), dtype=bool)
        return relevance(before, after, new) >= self.options.step

    def _linearise(self, state: SearchState, structure: Structure) -> None:
        """Linearise at a refitted structure, and compare all others there."""
        near = state.refitted[structure].fitted
        self.progress(f"evidence of all structures beside {', '.join(near.terms)}")
        state.linearised.add(structure)
        state.view = self._at(near)
        state.predicted = state.view.best()

    def _climb(self, state: SearchState) -> bool:
        """Linearise at structures with fewer terms than the best one until one is better; whether one is.

        What two terms do together may show only where one of them is, and what takes the place of one only
        where that is not.
        """
        before = state.likeliest
        for size in range(1, len(before)):
            likely = [p for s, p in state.predicted.items() if len(s) == size and s not in state.refitted]
            if likely:
                self._refit_predicted(state, [max(likely, key=lambda p: p.log_evidence)])
            refitted = [s for s in state.refitted if len(s) == size]
            if refitted and self._linearise_beside(
                state, max(refitted, key=lambda s: state.refitted[s].log_evidence)
            ):
                return True
        for term in sorted(before):
            reduced = frozenset(without(self.data.model, tuple(before), term))
            if reduced not in state.refitted:
                self._refit_and_enter(state, state.refitted[before].fitted, reduced, {})
            if self._linearise_beside(state, reduced):
                return True
        return False

    def _linearise_beside(self, state: SearchState, structure: Structure) -> bool:
        """Linearise at another structure than the best one; whether a better one shows there."""
        if structure in state.linearised:
            return False
        before = state.likeliest
        self._linearise(state, structure)
        longer = [p for s, p in state.predicted.items() if structure < s and s not in state.refitted]
        if longer:  # those with one more term, the terms that it builds on included
            fewest = min(len(p.structure) for p in longer)
            nearest = [p for p in longer if len(p.structure) == fewest]
            self._refit_predicted(state, [max(nearest, key=lambda p: p.log_evidence)])
        self._refit_promising(state, with_disturbance)
        return state.likeliest != before

    def _refit_singles(self, state: SearchState) -> None:
        """Refit every single term beside a baseline far from the data, where responses show little."""
        near = state.refitted[frozenset()].fitted
        if near.noise < OUTWEIGHED:
            return
        singles = [frozenset(terms) for terms in candidates(self.data.model, self.baseline)]
        self._refit_each(state, near, [single for single in singles if single not in state.refitted])

    def _reduce(self, state: SearchState, structure: Structure, least: float) -> Structure:
        """A structure refitted without its terms that explain too little, the least one first."""
        while least_relevance(shares := state.relevance(structure)) < least:
            near = state.refitted[structure]
            structure = structure - {min(shares, key=lambda term: shares[term])}
            if structure not in state.refitted:
                self._refit_and_enter(state, near.fitted, structure, {})
        return structure

    def _refit_narrowed(self, state: SearchState, best: Structure) -> None:
        """Refit a structure with the form of a term that has no width, begun at that term's size."""
        model = self.data.model
        theta, places = state.refitted[best].fitted.theta, index_of(model.parameters)
        for term in best:
            narrow = model.terms[term].narrow
            if not narrow or narrow in best or (best - {term}) | {narrow} in state.refitted:
                continue
            size, term_size = (places[model.terms[key].parameters[0].key] for key in (narrow, term))
            values = {model.parameters[size].key: max(float(theta[term_size]), 0.0)}
            self._refit_and_enter(state, state.refitted[best].fitted, (best - {term}) | {narrow}, values)

    def _refit_shapes(self, state: SearchState, structure: Structure) -> None:
        """Refit a structure with each of its shapes begun anew: other terms may have bent one."""
        near, model = state.refitted[structure].fitted, self.data.model
        shaped = [t for t in near.terms if any(p.shape for p in model.terms[t].parameters)]
        starts = [start for term in shaped for start in starts_beside(near, [term])]
        if starts:
            self._enter(state, self._fit_from(near, near.terms, [{}, *starts]))

    def _at(self, fitted: Fitted, absent: Sequence[str] | None = None) -> Enumeration:
        """What may be compared where a fit stands: its own terms, and all others or those ``absent``."""
        term_responses = responses(self.data, fitted, self.baseline, self.correlation, absent=absent)
        return Enumeration(
            self.data.model, term_responses, frozenset(self.baseline), self.candidates, self._beam(fitted)
        )

    def _beam(self, near: Fitted) -> BeamOptions:
        """How far from a fit structures are compared.

        From afar many terms together stand in for anything: only a few more than those of the fit count,
        except where responses are exact, as of inverse dynamics.
        """
        if not self.data.model.state_names:
            return BeamOptions()
        added = frozenset(near.terms) - frozenset(self.baseline)
        return BeamOptions(most_terms=len(added) + self.options.few)

    def _refit_promising(self, state: SearchState, evidence: Callable[[Evident], float]) -> None:
        """Refit the most promising structures that were not refitted yet."""
        least = evidence(state.refitted[state.most(evidence)]) - self.options.margin
        new = [p for s, p in state.predicted.items() if s not in state.refitted and evidence(p) > least]
        waiting = sorted(new, key=evidence, reverse=True)[: self.options.refits]
        self._refit_predicted(state, waiting)

    def _refit_predicted(self, state: SearchState, predicted: Sequence[Predicted]) -> None:
        """Refit structures from the fit where they were predicted, with the values that they have there."""
        assert state.view is not None
        self._refit_each(
            state, state.view.responses.fitted, [prediction.structure for prediction in predicted]
        )

    def _refit_each(self, state: SearchState, near: Fitted, structures: Sequence[Structure]) -> None:
        """Refit structures from one fit, side by side, with the values that they are predicted to have."""
        values = [state.values_of(structure) for structure in structures]
        for structure in structures:
            self.progress(f"refitting {', '.join(sorted(structure)) or 'the baseline'}")
        fits = side_by_side(lambda pair: self._refit(near, *pair), list(zip(structures, values, strict=True)))
        for fitted, begun in zip(fits, values, strict=True):
            self._enter_best(state, fitted, begun)

    def _refit_and_enter(
        self, state: SearchState, near: Fitted, structure: Structure, values: Mapping[str, float]
    ) -> None:
        """Refit a structure from a fit nearby, and where a part of it fits better, from that one, too."""
        self._enter_best(state, self._refit(near, structure, values), values)

    def _enter_best(self, state: SearchState, fitted: Fitted, values: Mapping[str, float]) -> None:
        """Enter a fit, or where a part of its structure fits better, the refit from there."""
        structure = frozenset(fitted.terms) - frozenset(self.baseline)
        parts = [r.fitted for s, r in state.refitted.items() if s < structure]
        best = min(parts, key=lambda part: part.solution.cost, default=fitted)
        if best.solution.cost < fitted.solution.cost:
            again = self._refit(best, structure, values)
            fitted = min((fitted, again), key=lambda fit: fit.solution.cost)
        self._enter(state, fitted)

    def _refit(self, near: Fitted, structure: Structure, values: Mapping[str, float]) -> Fitted:
        """Fit a structure from where a fit stands, with these values by key."""
        model = self.data.model
        terms = (*self.baseline, *(t for t in model.terms if t in structure))
        fresh = [t for t in terms if t not in near.terms]
        starts: list[Mapping[str, float]] = [values]
        if fresh:
            starts += starts_beside(near, fresh)[1:2]
        if self.nominal:
            starts.append({**values, **self.nominal})
        return self._fit_from(near, terms, starts)

    def _fit_from(self, near: Fitted, terms: Sequence[str], starts: Sequence[Mapping[str, float]]) -> Fitted:
        """Fit terms from where a fit stands, with each of these values by key."""
        return fit_terms(
            self.data.model, self.data.search, terms, self.data.window, self.data.sigma,
            start=with_only(self.data.model, near.theta, terms), starts=starts,
            states=near.solution.point.states, iterations=25, tolerance=1e-4, held=self.data.held,
        )  # fmt: skip

    def _enter(self, state: SearchState, fitted: Fitted) -> None:
        structure = frozenset(fitted.terms) - frozenset(self.baseline)
        previous = state.refitted.get(structure)
        if previous is not None and previous.fitted.solution.cost <= fitted.solution.cost:
            return
        view = self._at(fitted, absent=())
        variants = view.responses.variants
        choice = tuple(variants[t][0] for t in fitted.terms if t in structure and t in variants)
        prediction = view.evaluate([choice])[0]
        # a size that runs to its bound says that the effect is of another kind
        possible = 0.0 if self._within_bounds(fitted, structure) else -np.inf
        possible += _shortfall(fitted, view.responses.grams.dof)
        state.refitted[structure] = Refitted(
            fitted,
            prediction.log_evidence + possible,
            prediction.undisturbed + possible,
            choice,
            view,
            view.relevance(choice),
        )

    def _within_bounds(self, fitted: Fitted, structure: Structure) -> bool:
        """Whether no size of the added terms is at a bound other than zero."""
        parameters, places = self.data.model.parameters, index_of(self.data.model.parameters)
        sizes = [p for p in parameters if p.term in structure and not p.shape]
        values = [float(fitted.theta[places[p.key]]) for p in sizes]
        return not any(value and p.at_bound(value) for p, value in zip(sizes, values, strict=True))


def _shortfall(fitted: Fitted, dof: float) -> float:
    """Log likelihood (≤ 0) of a fit over that of the minimum its slopes promise, of so many samples.

    Evidence takes a fit for the minimum that its slopes point at. A fit that has not converged, as its slopes
    differ from those of a few steps further, counts by its own residuals.
    """
    if fitted.solution.converged:
        return 0.0
    problem, solution = fitted.problem, fitted.solution
    lin = linearise_to_flatter_side(problem, solution)
    projected = problem.project(lin, np.column_stack([solution.residuals, lin.by_parameters]))
    residuals, slopes = projected[:, 0], projected[:, 1:]
    promised = residuals - slopes @ np.linalg.lstsq(slopes, residuals, rcond=None)[0]
    squares = max(float(solution.residuals @ solution.residuals), 1e-300)
    return 0.5 * dof * min(float(np.log(max(float(promised @ promised), 1e-300) / squares)), 0.0)
