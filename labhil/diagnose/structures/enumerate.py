"""Beam search over model structures (sets of added terms) on one linearisation of a fit.

Every structure is scored by its log evidence in closed form (marginal.py) plus a log prior. Read on in
search.py, which refits the best structures by simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, combinations
from math import inf, log
from typing import Protocol

import numpy as np

from labhil.diagnose.structures.marginal import Batch, extended_evidence, log_evidence, solve
from labhil.diagnose.structures.prior import Structure, TermTable, closure, log_prior
from labhil.diagnose.structures.responses import Responses, Variant
from labhil.physics.model import Model
from labhil.signals import BoolArray, FloatArray

NOISE_RMS_TOLERANCE = 1.1
"""RMS of residuals in noise levels that counts as noise: noise levels are known to about ten per cent."""

MIN_RELEVANCE = 1.0
"""Smallest relevance of a term: the mean square that it explains over the one that stays unexplained beyond
the noise. A smaller effect cannot be distinguished from the missing ones."""

Choice = tuple[Variant, ...]
"""A structure with the variant of each of its terms."""


@dataclass(frozen=True, slots=True)
class BeamOptions:
    """Extent of the beam search; the defaults are heuristics.

    Attributes:
        width: structures of each size that are extended by one more term, for either evidence.
        variants: variants of a term that larger structures try; those with the most evidence alone.
        max_terms: largest number of terms in a structure.
        patience: the search ends after so many sizes in a row without a better structure. More than one,
            since two terms may help together although neither helps alone.
        evaluated_per_width: extended structures that are evaluated exactly, over the width.
        ranked_per_width: extended structures that are compared by predicted evidence, over the width.
    """

    width: int = 40
    variants: int = 2
    max_terms: int = 24
    patience: int = 2
    evaluated_per_width: int = 2
    ranked_per_width: int = 8


@dataclass(frozen=True, slots=True)
class Prediction:
    """Evidence of a structure as one linearisation predicts it.

    Attributes:
        structure: keys of the added terms.
        log_evidence: marginalised over the disturbance, prior of the structure included.
        undisturbed: the same given that there is no disturbance.
        choice: variant of each term.
        sizes: (k,), posterior means of the parameters, in units of the responses.
    """

    structure: Structure
    log_evidence: float
    undisturbed: float
    choice: Choice
    sizes: FloatArray


class HasLogEvidence(Protocol):
    """A structure with log evidence, predicted or of a refit."""

    @property
    def log_evidence(self) -> float:
        """Log evidence marginalised over the size of a disturbance."""
        ...

    @property
    def undisturbed(self) -> float:
        """Log evidence given that there is no disturbance."""
        ...


def with_disturbance(scored: HasLogEvidence) -> float:
    """Log evidence of a structure, marginalised over the size of a disturbance."""
    return scored.log_evidence


def without_disturbance(scored: HasLogEvidence) -> float:
    """Log evidence of a structure, given that there is no disturbance."""
    return scored.undisturbed


EVIDENCES = (with_disturbance, without_disturbance)


def relevance(without_term: FloatArray, with_term: FloatArray, affected: BoolArray) -> float:
    """Ratio of the mean square that a term explains to the one that stays unexplained beyond the noise.

    Args:
        without_term: (c,), mean squares of the outputs' residuals without the term, in noise levels.
        with_term: (c,), the same with the term.
        affected: (c,), whether the term changes an output.

    Returns:
        The ratio over the outputs that the term changes; infinite where only noise remains.
    """
    # a stuck part has no slope by the force that holds it: then all outputs count
    on = affected if affected.any() else np.ones_like(affected)
    beyond_noise = float(np.mean(with_term[on])) - NOISE_RMS_TOLERANCE**2
    explained = float(np.mean((without_term - with_term)[on]))
    return explained / beyond_noise if beyond_noise > 0.0 else inf


@dataclass(frozen=True, slots=True)
class Enumeration:
    """Evidence of all structures on one linearisation of a fit.

    Attributes:
        model: the model with all its terms.
        responses: responses of all terms where the fit stands.
        baseline: keys of the terms that every structure has.
        n_candidates: number of terms that may be added.
        options: extent of the beam search.
        residual_cache: residual mean squares (c,) that were computed already, by the variants of a structure.
    """

    model: Model
    responses: Responses
    baseline: frozenset[str]
    n_candidates: int
    options: BeamOptions = field(default_factory=BeamOptions)
    residual_cache: dict[frozenset[int], FloatArray] = field(default_factory=dict)

    def evaluate(self, choices: Sequence[Choice]) -> list[Prediction]:
        """Compute the log evidence of structures, their priors included, in the order given."""
        predictions: list[Prediction | None] = [None] * len(choices)
        widths = [_width(choice) for choice in choices]
        for width in sorted(set(widths)):
            places = [i for i, w in enumerate(widths) if w == width]
            batch = _batch([choices[i] for i in places], width)
            for i, *values in zip(places, *log_evidence(self.responses.grams, batch), strict=True):
                predictions[i] = self._predict(choices[i], *values)
        return [prediction for prediction in predictions if prediction is not None]

    def relevance(self, choice: Choice) -> dict[str, float]:
        """Predict the relevance of each term of a structure, without the terms that others build on."""
        with_term = self._residual_mean_squares(choice)
        terms = [self.model.terms[v.term] for v in choice if v.term in self.model.terms]
        carried = {t for term in terms for t in term.with_terms}
        return {
            v.term: relevance(
                self._residual_mean_squares(tuple(variant for variant in choice if variant is not v)),
                with_term,
                self.responses.affected_outputs(v),
            )
            for v in choice
            if v.term not in carried
        }

    def _residual_mean_squares(self, choice: Choice) -> FloatArray:
        """Predicted mean squares (c,) of a structure's residuals; cached."""
        key = _key(choice)
        if key not in self.residual_cache:
            self.residual_cache[key] = self.responses.grams.residual_mean_squares(
                [p for v in choice for p in v.places]
            )
        return self.residual_cache[key]

    def search_beam(self) -> dict[Structure, Prediction]:
        """Search from small structures to larger ones.

        Returns:
            Every structure that the beam reached, the empty one included, with its best variants.
        """
        order = self._best_variants()
        reached = dict[Structure, Prediction]()
        beam = self._initial_choices()
        self._keep_better(reached, self.evaluate(beam))
        sizes_without_gain = 0
        while extended := self._extend_beam(beam, order, reached):
            predictions = self.evaluate(extended)
            tops = [max(evidence(p) for p in reached.values()) for evidence in EVIDENCES]
            self._keep_better(reached, predictions)
            better = any(
                max(evidence(p) for p in predictions) > top
                for evidence, top in zip(EVIDENCES, tops, strict=True)
            )
            sizes_without_gain = 0 if better else sizes_without_gain + 1
            if sizes_without_gain == self.options.patience:
                break
            beam = list(
                {
                    _key(choice): choice
                    for evidence in EVIDENCES
                    for choice in self._best_choices(predictions, evidence)
                }.values()
            )
        return reached

    def _best_choices(
        self, predictions: Sequence[Prediction], evidence: Callable[[Prediction], float]
    ) -> list[Choice]:
        """The structures with the most evidence of a kind, each with its best variants."""
        ranked = sorted(predictions, key=evidence, reverse=True)
        first = {p.structure: p.choice for p in reversed(ranked)}
        return [first[s] for s in dict.fromkeys(p.structure for p in ranked)][: self.options.width]

    def _predict(self, choice: Choice, value: float, undisturbed: float, sizes: FloatArray) -> Prediction:
        prior = self._log_prior(choice)
        return Prediction(_terms(choice), float(value + prior), float(undisturbed + prior), choice, sizes)

    def _log_prior(self, choice: Choice) -> float:
        """Log prior of a structure and of the variants of its terms."""
        return log_prior(self.model, _terms(choice), self.n_candidates) - float(self._log_ways([choice])[0])

    @staticmethod
    def _keep_better(reached: dict[Structure, Prediction], predictions: Iterable[Prediction]) -> None:
        """Keep the better of two choices of variants of the same structure."""
        for predicted in predictions:
            best = reached.get(predicted.structure)
            if best is None or predicted.log_evidence > best.log_evidence:
                reached[predicted.structure] = predicted

    def _best_variants(self) -> dict[str, list[Variant]]:
        """The variants of each term that have the most evidence alone, best first."""
        order = dict[str, list[Variant]]()
        flat = [(variant,) for variants in self.responses.variants.values() for variant in variants]
        for predicted in sorted(self.evaluate(flat), key=lambda p: -p.log_evidence):
            (variant,) = predicted.choice
            order.setdefault(variant.term, []).append(variant)
        return {term: variants[: self.options.variants] for term, variants in order.items()}

    def _initial_choices(self) -> list[Choice]:
        """The empty structure, the structure of the fit, and the latter without each of its terms."""
        variants = self.responses.variants
        present = [t for t in self.responses.fitted.terms if t not in self.baseline and t in variants]
        full = tuple(variants[t][0] for t in present)
        seeds = [(), full, *(tuple(v for v in full if v.term != dropped) for dropped in present)]
        return list({_key(seed): seed for seed in seeds if self._is_closed(seed)}.values())

    def _is_closed(self, choice: Choice) -> bool:
        terms = _terms(choice)
        return closure(self.model, terms, self.baseline) == terms

    def _extend_beam(
        self,
        beam: Sequence[Choice],
        order: Mapping[str, Sequence[Variant]],
        reached: Mapping[Structure, object],
    ) -> list[Choice]:
        """Structures of the beam with one more term and the terms it builds on, by predicted evidence.

        The prediction keeps the prior widths of the structure that is extended, which few terms would change.
        """
        predicted = dict[frozenset[int], tuple[FloatArray, Choice]]()
        added = self._additions(order)
        for width in sorted({_width(choice) for choice in beam}):
            choices = [choice for choice in beam if _width(choice) == width]
            for key, longer, logs in self._rank_additions(choices, added, reached):
                best = predicted.get(key)
                if best is None or logs.max() > best[0].max():
                    predicted[key] = (logs, longer)
        chosen = dict[frozenset[int], Choice]()
        for kind in range(len(EVIDENCES)):
            ranked = sorted(predicted.items(), key=lambda item: -float(item[1][0][kind]))
            evaluated = self.options.evaluated_per_width * self.options.width
            chosen |= {key: longer for key, (_, longer) in ranked[:evaluated]}
        return list(chosen.values())

    def _additions(self, order: Mapping[str, Sequence[Variant]]) -> list[Choice]:
        """Every term that may be added, in each of its variants, with and without the terms it builds on."""
        additions: list[Choice] = []
        for term, ways in order.items():
            carried = [t for t in self.model.terms[term].with_terms if t not in self.baseline]
            if any(t not in order for t in carried):
                continue
            for brought in chain.from_iterable(combinations(carried, n) for n in range(len(carried) + 1)):
                additions += [(*(order[t][0] for t in brought), way) for way in ways]
        return additions

    def _rank_additions(
        self, choices: Sequence[Choice], added: Sequence[Choice], reached: Mapping[Structure, object]
    ) -> Iterator[tuple[frozenset[int], Choice, FloatArray]]:
        """Choices of one width with the additions that apply to them, and both predicted log evidences."""
        grams, batch = self.responses.grams, _batch(choices, _width(choices[0]))
        solved, table = solve(grams, batch), TermTable(self.model, self.baseline)
        terms, keys = [_terms(choice) for choice in choices], [_key(choice) for choice in choices]
        added_terms, added_keys = [_terms(a) for a in added], [_key(a) for a in added]
        prior = table.log_priors(terms, added_terms, self.n_candidates)
        prior -= self._log_ways(choices)[:, None] + self._log_ways(added)
        prior[~table.may_be_added(terms, [a[-1].term for a in added], added_terms)] = -np.inf
        for width in sorted({_width(addition) for addition in added}):
            numbers = [j for j, addition in enumerate(added) if _width(addition) == width]
            same = [added[j] for j in numbers]
            places = np.array([[p for v in addition for p in v.places] for addition in same], dtype=np.int64)
            positive = np.array([[s for v in addition for s in v.positive] for addition in same], dtype=bool)
            logs = np.stack(extended_evidence(grams, batch, solved, places, positive), axis=-1)
            logs += prior[:, numbers, None]
            for i, n in _largest_indices(logs, self.options.ranked_per_width * self.options.width):
                j = numbers[n]
                structure = terms[i] | added_terms[j]
                if len(structure) <= self.options.max_terms and structure not in reached:
                    yield keys[i] | added_keys[j], (*choices[i], *added[j]), logs[i, n]

    def _log_ways(self, choices: Sequence[Choice]) -> FloatArray:
        """Log number (S,) of the choices of variants of the same terms."""
        variants = self.responses.variants
        return np.array([sum(log(len(variants[v.term])) for v in choice) for choice in choices])


def _largest_indices(logs: FloatArray, most: int) -> list[tuple[int, int]]:
    """Indices (s, v) of the ``most`` largest entries of logs (S, V, K), for each of the K kinds."""
    places = dict[tuple[int, int], None]()
    for kind in range(logs.shape[-1]):
        flat = logs[..., kind].ravel()
        first = np.argpartition(-flat, min(most, len(flat)) - 1)[:most]
        for place in first[np.isfinite(flat[first])]:
            i, j = divmod(int(place), logs.shape[1])
            places[i, j] = None
    return list(places)


def _width(choice: Choice) -> int:
    """Number of responses of a structure."""
    return sum(len(v.keys) for v in choice)


def _key(choice: Choice) -> frozenset[int]:
    """First columns of a structure's variants, which tell it from all others."""
    return frozenset(v.first for v in choice)


def _terms(choice: Choice) -> Structure:
    return frozenset(v.term for v in choice)


def _batch(choices: Sequence[Choice], width: int) -> Batch:
    """Structures with the same number of responses, as arrays."""
    shape = (len(choices), width)
    columns = [[c for v in choice for c in v.places] for choice in choices]
    block = [[b for b, v in enumerate(choice) for _ in v.keys] for choice in choices]
    positive = [[s for v in choice for s in v.positive] for choice in choices]
    return Batch(
        np.array(columns, dtype=np.int64).reshape(shape),
        np.array(block, dtype=np.int64).reshape(shape),
        np.array(positive, dtype=bool).reshape(shape),
    )
