"""Curves as terms: is a force over one coordinate likelier than named terms, or beside them?

Its spline's coefficients have a Gaussian prior that prefers smooth ones. Where a fit stands, structures with
one are compared by the same evidence as all others; the likeliest are refitted by simulation.
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
from labhil.diagnose.structures.enumerate import RELEVANCE, Choice, Enumeration, Structure
from labhil.diagnose.structures.responses import CurveColumns, responses
from labhil.identify.extended import NAME, Coordinate
from labhil.identify.fitted import Fitted, fit_terms, with_only
from labhil.physics.extra_force import AcceptsExtraForce, MovedPart
from labhil.signals import FloatArray

MOST_SWAPPED = 4
"""Named forces, at most, of which every subset is tried beside a curve."""


@dataclass(frozen=True, slots=True)
class CurveOptions:
    """How curves are weighed.

    Attributes:
        refits: structures with a curve that are refitted, at most.
        margin: nats by which a structure may be behind the named one to be refitted.
        iterations: steps of a refit.
        finished: steps of the one that is chosen, at the end.
        claim: odds (nats) that a curve needs over the named structure.
        relevance: what it explains over what remains beside it, at least.
    """

    refits: int = 2
    margin: float = 5.0
    iterations: int = 8
    finished: int = 25
    claim: float = 5.0
    relevance: float = RELEVANCE


@dataclass(frozen=True, slots=True)
class CurveChoice:
    """A force over a coordinate beside named terms, and its log odds over the named structure."""

    coordinate: Coordinate
    beside: Structure
    log_odds: float


@dataclass(frozen=True, slots=True)
class CurveSearch:
    """A search for a force over one coordinate, in the place of named forces or beside them.

    ``baseline`` are keys of the terms that every structure has, ``correlation`` (c,) is that of the noise of
    neighbouring samples.
    """

    data: Data
    baseline: tuple[str, ...]
    correlation: FloatArray
    options: CurveOptions = CurveOptions()

    def run(self, fitted: Fitted) -> FittedCurve | None:
        """Return the likeliest curve on any part, or None where the named structure of a fit is likelier."""
        best: FittedCurve | None = None
        for begin in position_variants(fitted):
            model = begin.problem.model
            for part in model.moved if isinstance(model, AcceptsExtraForce) else ():
                trial = self._on_part(begin, part)
                if trial is not None and (best is None or trial.log_odds > best.log_odds):
                    best = trial
        if best is None:
            return None
        return replace(best, curve_fit=fix_gauge(refine_with_states(best.curve_fit, self.options.finished)))

    def _on_part(self, fitted: Fitted, part: MovedPart) -> FittedCurve | None:
        best: FittedCurve | None = None
        log_named, choices = self._choices(fitted, part)
        for choice in choices[: self.options.refits]:
            if choice.log_odds < -self.options.margin:
                break
            trial = self._refit(fitted, choice, log_named)
            if best is None or trial.log_odds > best.log_odds:
                best = trial
        return None if best is None or best.log_odds < self.options.claim else best

    def _choices(self, fitted: Fitted, part: MovedPart) -> tuple[float, list[CurveChoice]]:
        """The log evidence of the fit's own structure, and all with a curve, likeliest first."""
        model = fitted.problem.model
        assert isinstance(model, AcceptsExtraForce)
        columns = _columns(fitted, [*motion_coordinates(model, part), *given_coordinates(fitted, part)])
        curves = [curve for _, curve in columns]
        view = self._view(fitted, curves, len(curves))
        named = {term: view.responses.variants[term][0] for term in self._named_terms(fitted, view)}
        log_named = view.evaluate([tuple(named.values())])[0].log_evidence
        tried: list[tuple[Coordinate, Structure, Choice]] = [
            (coordinate, structure, (*(v for t, v in named.items() if t in structure), variant))
            for coordinate, curve in columns
            for structure in _kept_terms(self.data, list(named))
            for variant in view.responses.variants[curve.name]
        ]
        tried = [trial for trial in tried if self._matters(view, trial[2])]
        logs = [trial.log_evidence for trial in view.evaluate([choice for _, _, choice in tried])]
        best = dict[tuple[Coordinate, Structure], float]()
        for (coordinate, structure, _), value in zip(tried, logs, strict=True):
            best[coordinate, structure] = max(best.get((coordinate, structure), -np.inf), value)
        choices = [CurveChoice(*key, value - log_named) for key, value in best.items()]
        return log_named, sorted(self._fewest_names(choices), key=lambda choice: -choice.log_odds)

    def _matters(self, view: Enumeration, choice: Choice) -> bool:
        """Whether a curve, the last of a structure, explains more than what remains beside it."""
        return view.relevance(choice)[choice[-1].term] >= self.options.relevance

    def _fewest_names(self, choices: Sequence[CurveChoice]) -> list[CurveChoice]:
        """Of each coordinate's choices within the odds of a claim the one with the fewest terms."""
        fewest = []
        for coordinate in dict.fromkeys(choice.coordinate for choice in choices):
            of_coordinate = [choice for choice in choices if choice.coordinate == coordinate]
            enough = max(choice.log_odds for choice in of_coordinate) - self.options.claim
            likely = [choice for choice in of_coordinate if choice.log_odds > enough]
            fewest.append(min(likely, key=lambda choice: (len(choice.beside), -choice.log_odds)))
        return fewest

    def _view(self, fitted: Fitted, curves: Sequence[CurveColumns], coordinates: int) -> Enumeration:
        """The structures to compare where a fit stands, with a curve over one of so many coordinates."""
        term_responses = responses(
            self.data, fitted, self.baseline, self.correlation, absent=(), curves=curves
        )
        candidates = len(self.data.model.terms) - len(self.baseline) + coordinates
        return Enumeration(self.data.model, term_responses, frozenset(self.baseline), candidates)

    def _named_terms(self, fitted: Fitted, view: Enumeration) -> list[str]:
        return [t for t in fitted.terms if t not in self.baseline and t in view.responses.variants]

    def _refit(self, fitted: Fitted, choice: CurveChoice, log_named: float) -> FittedCurve:
        """Refit a structure with a curve, and weigh it where that stands."""
        named_fit = self._without(fitted, choice.beside)
        problem, states = named_fit.problem, named_fit.solution.point.states
        along = problem.model.coordinates(named_fit.theta, problem.record, problem.windows, states)
        first = fit_linearised_curve(named_fit, choice.coordinate, choice.coordinate.of(along))
        curved = refine(restart(first), self.options.iterations)
        coordinates = len(problem.model.coordinate_units)
        view = self._view(curved.fitted, (), coordinates)
        names = tuple(view.responses.variants[t][0] for t in self._named_terms(named_fit, view))
        key = curved.model.coefficients[0].term or NAME
        ways = view.evaluate([(*names, way) for way in view.responses.variants[key]])
        likeliest = max(ways, key=lambda prediction: prediction.log_evidence)
        odds = likeliest.log_evidence - log_named if self._matters(view, likeliest.choice) else -np.inf
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


def _kept_terms(data: Data, named: list[str]) -> Iterable[Structure]:
    """Named terms that stay beside a curve: all, and all but some of those that enter where it does."""
    model, terms = data.model, data.model.terms
    assert isinstance(model, AcceptsExtraForce)
    places = {part.enters for part in model.moved}
    likened = [t for t in named if terms[t].enters in places][:MOST_SWAPPED]
    for count in range(len(likened) + 1):
        for gone in combinations(likened, count):
            kept = frozenset(named) - set(gone)
            if not any(t in gone for term in kept for t in terms[term].with_terms):
                yield kept


def _columns(fitted: Fitted, coordinates: Iterable[Coordinate]) -> list[tuple[Coordinate, CurveColumns]]:
    """Change of the residuals by a force over each coordinate that varies."""
    problem, states = fitted.problem, fitted.solution.point.states
    along = problem.model.coordinates(fitted.theta, problem.record, problem.windows, states)
    columns = []
    for coordinate in coordinates:
        values = coordinate.of(along)
        if np.ptp(values) > 0.0:
            extended, spline_problem, point = add_spline(fitted, coordinate, values)
            lin = spline_problem.linearise(point, fitted.solution.residuals)
            slopes = lin.by_parameters[:, -extended.spline.count :]
            name = f"force over {coordinate.name}, {coordinate.acts.name}"
            columns.append((coordinate, CurveColumns(name, slopes, extended.spline.roughness)))
    return columns
