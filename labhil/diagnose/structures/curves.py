"""Search for a nonparametric force: a spline over one coordinate, next to named terms or instead of them.

The spline's coefficients have a Gaussian smoothness prior. Structures with a spline are compared with named
ones by the same evidence (marginal.py) on the linearisation of a fit; the best are refitted by simulation.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from labhil.diagnose.curve import (
    add_spline,
    fit_linearised_curve,
    fix_gauge,
    refine,
    refine_with_states,
    restart,
)
from labhil.diagnose.force_curve import given_coordinates, motion_coordinates, position_variants
from labhil.diagnose.judge import Data
from labhil.diagnose.search_result import FittedCurve
from labhil.diagnose.structures.enumerate import EVIDENCES, MIN_RELEVANCE, Choice, Enumeration, Prediction
from labhil.diagnose.structures.prior import Structure
from labhil.diagnose.structures.responses import CurveResponse, compute_responses
from labhil.identify.extended import UNMODELLED_FORCE, Coordinate
from labhil.identify.fitted import Fitted, fit_terms, with_only
from labhil.physics.extra_force import AcceptsExtraForce, MovedPart
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class CurveOptions:
    """Options of the search for a curve; values without a source are heuristics.

    Attributes:
        max_refits: largest number of structures with a curve that are refitted.
        refit_margin: log odds (nats) by which a structure may be behind the named one to be refitted.
        iterations: iterations of a refit.
        final_iterations: further iterations of the refit that is chosen.
        min_log_odds: log odds (nats) that a curve needs over the named structure: 5 is a Bayes factor of 150,
            very strong evidence (Kass and Raftery 1995).
        min_relevance: smallest relevance of a curve, see `enumerate.relevance`.
        max_replaced: largest number of named forces of which every subset is tried next to a curve.
    """

    max_refits: int = 2
    refit_margin: float = 5.0
    iterations: int = 8
    final_iterations: int = 25
    min_log_odds: float = 5.0
    min_relevance: float = MIN_RELEVANCE
    max_replaced: int = 4


@dataclass(frozen=True, slots=True)
class CurveChoice:
    """A force over a coordinate, the named terms ``beside`` it, and its log odds over the named structure."""

    coordinate: Coordinate
    beside: Structure
    log_odds: float


@dataclass(frozen=True, slots=True)
class CurveSearch:
    """A search for a force over one coordinate, in addition to named forces or instead of them.

    Attributes:
        data: the data of the search.
        baseline: keys of the terms that every structure has.
        correlation: (c,), first-order autocorrelation of the noise.
        options: options of the search.
    """

    data: Data
    baseline: tuple[str, ...]
    correlation: FloatArray
    options: CurveOptions = CurveOptions()

    def run(self, fitted: Fitted) -> FittedCurve | None:
        """Find the most probable curve on any moved part.

        Args:
            fitted: fit of the named structure.

        Returns:
            The refitted curve, or None where the odds do not favour one over the named structure.
        """
        best: FittedCurve | None = None
        for begin in position_variants(fitted):
            model = begin.problem.model
            for part in model.moved if isinstance(model, AcceptsExtraForce) else ():
                candidate = self._search_part(begin, part)
                if candidate is not None and (best is None or candidate.log_odds > best.log_odds):
                    best = candidate
        if best is None:
            return None
        return replace(
            best, curve_fit=fix_gauge(refine_with_states(best.curve_fit, self.options.final_iterations))
        )

    def _search_part(self, fitted: Fitted, part: MovedPart) -> FittedCurve | None:
        """The most probable curve on one moved part, or None."""
        best: FittedCurve | None = None
        alone, choices = self._choices(fitted, part)
        for choice in choices[: self.options.max_refits]:
            if choice.log_odds < -self.options.refit_margin:
                break
            candidate = self._refit(fitted, choice, alone)
            if best is None or candidate.log_odds > best.log_odds:
                best = candidate
        return None if best is None or best.log_odds < self.options.min_log_odds else best

    def _choices(self, fitted: Fitted, part: MovedPart) -> tuple[Prediction, list[CurveChoice]]:
        """Evidence of the fit's own structure, and the structures with a curve, most probable first."""
        model = fitted.problem.model
        assert isinstance(model, AcceptsExtraForce)
        columns = _columns(fitted, [*motion_coordinates(model, part), *given_coordinates(fitted, part)])
        curves = [curve for _, curve in columns]
        enumeration = self._linearisation_at(fitted, curves, len(curves))
        named = {
            term: enumeration.responses.variants[term][0] for term in self._named_terms(fitted, enumeration)
        }
        alone = enumeration.evaluate([tuple(named.values())])[0]
        tried: list[tuple[Coordinate, Structure, Choice]] = [
            (coordinate, structure, (*(v for t, v in named.items() if t in structure), variant))
            for coordinate, curve in columns
            for structure in _kept_terms(self.data, list(named), self.options.max_replaced)
            for variant in enumeration.responses.variants[curve.name]
        ]
        tried = [candidate for candidate in tried if self._is_relevant(enumeration, candidate[2])]
        odds = [_log_odds(with_curve, alone) for with_curve in enumeration.evaluate([c for _, _, c in tried])]
        best = dict[tuple[Coordinate, Structure], float]()
        for (coordinate, structure, _), value in zip(tried, odds, strict=True):
            best[coordinate, structure] = max(best.get((coordinate, structure), -np.inf), value)
        choices = [CurveChoice(*key, value) for key, value in best.items()]
        return alone, sorted(self._with_fewest_terms(choices), key=lambda choice: -choice.log_odds)

    def _is_relevant(self, enumeration: Enumeration, choice: Choice) -> bool:
        """Whether a curve, the last variant of a structure, has the smallest relevance."""
        return enumeration.relevance(choice)[choice[-1].term] >= self.options.min_relevance

    def _with_fewest_terms(self, choices: Sequence[CurveChoice]) -> list[CurveChoice]:
        """Of each coordinate's choices that are nearly as probable, the one with the fewest named terms."""
        fewest = []
        for coordinate in dict.fromkeys(choice.coordinate for choice in choices):
            of_coordinate = [choice for choice in choices if choice.coordinate == coordinate]
            least_odds = max(choice.log_odds for choice in of_coordinate) - self.options.min_log_odds
            likely = [choice for choice in of_coordinate if choice.log_odds > least_odds]
            fewest.append(min(likely, key=lambda choice: (len(choice.beside), -choice.log_odds)))
        return fewest

    def _linearisation_at(
        self, fitted: Fitted, curves: Sequence[CurveResponse], coordinates: int
    ) -> Enumeration:
        """The structures on the linearisation of a fit, with a curve over one of so many coordinates."""
        term_responses = compute_responses(
            self.data, fitted, self.baseline, self.correlation, absent=(), curves=curves
        )
        candidates = len(self.data.model.terms) - len(self.baseline) + coordinates
        return Enumeration(self.data.model, term_responses, frozenset(self.baseline), candidates)

    def _named_terms(self, fitted: Fitted, enumeration: Enumeration) -> list[str]:
        """Keys of the fit's added terms that the data can show."""
        return [t for t in fitted.terms if t not in self.baseline and t in enumeration.responses.variants]

    def _refit(self, fitted: Fitted, choice: CurveChoice, alone: Prediction) -> FittedCurve:
        """Refit a structure with a curve, and compute its log odds on the linearisation at that fit."""
        named_fit = self._without(fitted, choice.beside)
        problem, states = named_fit.problem, named_fit.solution.point.states
        along = problem.model.coordinates(named_fit.theta, problem.record, problem.windows, states)
        first = fit_linearised_curve(named_fit, choice.coordinate, choice.coordinate.values(along))
        curved = refine(restart(first), self.options.iterations)
        coordinates = len(problem.model.coordinate_units)
        enumeration = self._linearisation_at(curved.fitted, (), coordinates)
        names = tuple(enumeration.responses.variants[t][0] for t in self._named_terms(named_fit, enumeration))
        key = curved.model.coefficients[0].term or UNMODELLED_FORCE
        predictions = enumeration.evaluate(
            [(*names, variant) for variant in enumeration.responses.variants[key]]
        )
        likeliest = max(predictions, key=lambda prediction: _log_odds(prediction, alone))
        is_relevant = self._is_relevant(enumeration, likeliest.choice)
        odds = _log_odds(likeliest, alone) if is_relevant else -np.inf
        return FittedCurve(curved, named_fit, odds)

    def _without(self, fitted: Fitted, kept: Structure) -> Fitted:
        """The fit with only some of its named terms, on the same windows."""
        terms = [t for t in fitted.terms if t in self.baseline or t in kept]
        if len(terms) == len(fitted.terms):
            return fitted
        model, start = fitted.problem.model, with_only(self.data.model, fitted.theta, terms)
        return fit_terms(
            model, self.data.search, terms, fitted.window, self.data.sigma, start=start, starts=[{}],
            states=fitted.solution.point.states, held=self.data.held,
        )  # fmt: skip


def _log_odds(with_curve: Prediction, alone: Prediction) -> float:
    """Log odds of a structure with a curve, the smaller of those with and without a disturbance.

    A curve that pays only beside a disturbance stands, with it, for noise of another colour than assumed.
    """
    return min(evidence(with_curve) - evidence(alone) for evidence in EVIDENCES)


def _kept_terms(data: Data, named: list[str], max_replaced: int) -> Iterable[Structure]:
    """Named terms that stay next to a curve: all, and all but some of those that enter where it does."""
    model, terms = data.model, data.model.terms
    assert isinstance(model, AcceptsExtraForce)
    places = {part.enters for part in model.moved}
    replaceable = [t for t in named if terms[t].enters in places][:max_replaced]
    for count in range(len(replaceable) + 1):
        for removed in combinations(replaceable, count):
            kept = frozenset(named) - set(removed)
            if not any(t in removed for term in kept for t in terms[term].with_terms):
                yield kept


def _columns(fitted: Fitted, coordinates: Iterable[Coordinate]) -> list[tuple[Coordinate, CurveResponse]]:
    """Responses of the residuals to a force over each coordinate that varies."""
    problem, states = fitted.problem, fitted.solution.point.states
    along = problem.model.coordinates(fitted.theta, problem.record, problem.windows, states)
    columns = []
    for coordinate in coordinates:
        values = coordinate.values(along)
        if np.ptp(values) > 0.0:
            extended, spline_problem, point = add_spline(fitted, coordinate, values)
            lin = spline_problem.linearise(point, fitted.solution.residuals)
            slopes = lin.by_parameters[:, -extended.spline.count :]
            name = f"force over {coordinate.name}, {coordinate.acts.name}"
            columns.append((coordinate, CurveResponse(name, slopes, extended.spline.roughness)))
    return columns
