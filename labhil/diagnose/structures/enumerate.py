"""All structures that matter on one linearisation, by a beam search over sets of added terms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, combinations
from math import comb, inf, log
from typing import Protocol

import numpy as np

from labhil.diagnose.structures.marginal import Batch, extended_evidence, log_evidence
from labhil.diagnose.structures.responses import Responses, Variant
from labhil.physics.model import Model
from labhil.signals import BoolArray, FloatArray

Structure = frozenset[str]
"""Keys of the terms beside the baseline."""

KNOWN_NOISE = 1.1
"""RMS in noise levels up to which nothing remains: a noise level is known to some ten per cent."""

RELEVANCE = 1.0
"""What a term or a curve explains over what no term does, at least. An effect that is smaller than what is
missing beside it cannot be distinguished from that."""

PROMISING, LOOKED_AT = 2, 8
"""Structures that are weighed exactly, and additions whose priors are looked at, over the width of the beam:
what an addition promises is nearly what it gives."""

Choice = tuple[Variant, ...]
"""A structure with the way in which each of its terms acts."""


@dataclass(frozen=True, slots=True)
class BeamOptions:
    """How far the enumeration goes.

    Attributes:
        width: structures of each size that are extended by one more term, by either evidence.
        variants: ways of a term to act that larger structures try, the best ones by themselves.
        most_terms: terms that a structure has, at most.
        patience: sizes in a row without a better structure after which it ends: two terms may help together
            of which neither does by itself.
    """

    width: int = 40
    variants: int = 2
    most_terms: int = 24
    patience: int = 2


@dataclass(frozen=True, slots=True)
class Predicted:
    """A structure with its log evidence as one linearisation predicts it, and the ``sizes`` of its responses.

    ``undisturbed`` is the same where no disturbance is possible.
    """

    structure: Structure
    log_evidence: float
    undisturbed: float
    choice: Choice
    sizes: FloatArray


class Evident(Protocol):
    """What has log evidence, with a disturbance that is possible and without one."""

    @property
    def log_evidence(self) -> float:
        """A disturbance of any size summed out."""
        ...

    @property
    def undisturbed(self) -> float:
        """The same where nothing disturbs."""
        ...


def with_disturbance(of: Evident) -> float:
    """Log evidence where a disturbance is possible."""
    return of.log_evidence


def without_disturbance(of: Evident) -> float:
    """Log evidence where nothing disturbs."""
    return of.undisturbed


EVIDENCES = (with_disturbance, without_disturbance)


def relevance(without: FloatArray, remains: FloatArray, acts: BoolArray) -> float:
    """What a term explains over what remains beside it, in the outputs that it acts on.

    Args:
        without: mean squares (c,) of the outputs' errors without the term, in noise levels.
        remains: the same with it.
        acts: (c,) marks the outputs that the term changes.
    """
    on = acts if acts.any() else np.ones_like(acts)  # a hold changes nothing until it lets go: no slope shows
    beyond_noise = float(np.mean(remains[on])) - KNOWN_NOISE**2
    explained = float(np.mean((without - remains)[on]))
    return explained / beyond_noise if beyond_noise > 0.0 else inf


def candidates(model: Model, present: Sequence[str]) -> list[tuple[str, ...]]:
    """Every absent term, together with those that it builds on (Stribeck friction on Coulomb friction)."""
    absent = [name for name in model.terms if name not in present]
    return [(*(t for t in model.terms[name].with_terms if t in absent), name) for name in absent]


def closure(model: Model, terms: Iterable[str], baseline: frozenset[str]) -> Structure:
    """Return a structure with the terms that its terms build on, but for those of the baseline."""
    chosen = frozenset(terms)
    return frozenset({*chosen, *(t for term in chosen for t in model.terms[term].with_terms)}) - baseline


def log_prior(model: Model, structure: Structure, candidates: int) -> float:
    """Return the log prior of a structure.

    Every number of terms is half as likely as one less, and all structures of one number are alike (Chen and
    Chen 2008, extended BIC with γ = 1). What others build on comes with them and is not counted.
    """
    carried = {t for term in structure if term in model.terms for t in model.terms[term].with_terms}
    count = len(structure - carried)
    return -count * log(2.0) - log(comb(max(candidates, count), count))


@dataclass(frozen=True, slots=True)
class Enumeration:
    """Evidence of structures on one linearisation."""

    model: Model
    responses: Responses
    baseline: frozenset[str]
    candidates: int
    options: BeamOptions = field(default_factory=BeamOptions)
    known: dict[frozenset[int], FloatArray] = field(default_factory=dict)

    def evaluate(self, choices: Sequence[Choice]) -> list[Predicted]:
        """Return each structure with its log evidence, prior included, in the order given."""
        predictions: list[Predicted | None] = [None] * len(choices)
        widths = [_width(choice) for choice in choices]
        for width in sorted(set(widths)):
            places = [i for i, w in enumerate(widths) if w == width]
            batch = _batch([choices[i] for i in places], width)
            for i, *values in zip(places, *log_evidence(self.responses.grams, batch), strict=True):
                predictions[i] = self._predict(choices[i], *values)
        return [prediction for prediction in predictions if prediction is not None]

    def relevance(self, choice: Choice) -> dict[str, float]:
        """Return what each term explains over what the structure leaves unexplained, as responses predict it.

        Both are mean squares, beyond the noise. Terms that others of the structure build on are left out.
        """
        remains = self._rest(choice)
        terms = [self.model.terms[v.term] for v in choice if v.term in self.model.terms]
        carried = {t for term in terms for t in term.with_terms}
        return {
            v.term: relevance(
                self._rest([variant for variant in choice if variant is not v]),
                remains,
                self.responses.acts(v),
            )
            for v in choice
            if v.term not in carried
        }

    def _rest(self, choice: Sequence[Variant]) -> FloatArray:
        """Mean squares (c,) that a structure leaves, as responses predict it; cached for repeated calls."""
        key = frozenset(v.first for v in choice)
        if key not in self.known:
            self.known[key] = self.responses.grams.rest([p for v in choice for p in v.places])
        return self.known[key]

    def best(self) -> dict[Structure, Predicted]:
        """Return the best way of every structure that the beam reaches, the empty one included."""
        order = self._best_variants()
        reached = dict[Structure, Predicted]()
        beam = self._seeds()
        self._keep_better(reached, self.evaluate(beam))
        waited = 0
        while extended := self._most_promising(beam, order, reached):
            predictions = self.evaluate(extended)
            tops = [max(of(p) for p in reached.values()) for of in EVIDENCES]
            self._keep_better(reached, predictions)
            better = any(
                max(of(p) for p in predictions) > top for of, top in zip(EVIDENCES, tops, strict=True)
            )
            waited = 0 if better else waited + 1
            if waited == self.options.patience:
                break
            beam = list(
                {
                    _key(choice): choice for of in EVIDENCES for choice in self._best_ways(predictions, of)
                }.values()
            )
        return reached

    def _best_ways(
        self, predictions: Sequence[Predicted], evidence: Callable[[Predicted], float]
    ) -> list[Choice]:
        """The best way of each of the structures with the most evidence of a kind."""
        ranked = sorted(predictions, key=evidence, reverse=True)
        first = {p.structure: p.choice for p in reversed(ranked)}
        return [first[s] for s in dict.fromkeys(p.structure for p in ranked)][: self.options.width]

    def _predict(self, choice: Choice, value: float, undisturbed: float, sizes: FloatArray) -> Predicted:
        structure = frozenset(v.term for v in choice)
        prior = self._log_prior(choice)
        return Predicted(structure, float(value + prior), float(undisturbed + prior), choice, sizes)

    def _log_prior(self, choice: Choice) -> float:
        """Log prior of a structure and of the ways in which its terms act."""
        ways = sum(log(len(self.responses.variants[v.term])) for v in choice)
        return log_prior(self.model, frozenset(v.term for v in choice), self.candidates) - ways

    @staticmethod
    def _keep_better(reached: dict[Structure, Predicted], predictions: Iterable[Predicted]) -> None:
        """Keep the better of two ways of the same structure."""
        for predicted in predictions:
            best = reached.get(predicted.structure)
            if best is None or predicted.log_evidence > best.log_evidence:
                reached[predicted.structure] = predicted

    def _best_variants(self) -> dict[str, list[Variant]]:
        """The ways of each term to act that explain most by themselves, best first."""
        order = dict[str, list[Variant]]()
        flat = [(variant,) for of in self.responses.variants.values() for variant in of]
        for predicted in sorted(self.evaluate(flat), key=lambda p: -p.log_evidence):
            (variant,) = predicted.choice
            order.setdefault(variant.term, []).append(variant)
        return {term: of[: self.options.variants] for term, of in order.items()}

    def _seeds(self) -> list[Choice]:
        """Nothing, the structure of the fit, and that less one term."""
        variants = self.responses.variants
        present = [t for t in self.responses.fitted.terms if t not in self.baseline and t in variants]
        full = tuple(variants[t][0] for t in present)
        seeds = [(), full, *(tuple(v for v in full if v.term != dropped) for dropped in present)]
        return list({_key(seed): seed for seed in seeds if self._is_closed(seed)}.values())

    def _is_closed(self, choice: Choice) -> bool:
        terms = frozenset(v.term for v in choice)
        return closure(self.model, terms, self.baseline) == terms

    def _most_promising(
        self,
        beam: Sequence[Choice],
        order: Mapping[str, Sequence[Variant]],
        reached: Mapping[Structure, object],
    ) -> list[Choice]:
        """Structures of the beam with one more term and the terms it builds on: those that promise most.

        The promise keeps the priors of the structure that is extended, which few terms would change.
        """
        promises = dict[frozenset[tuple[str, int]], tuple[FloatArray, Choice]]()
        added = self._additions(order)
        for width in sorted({_width(choice) for choice in beam}):
            choices = [choice for choice in beam if _width(choice) == width]
            for choice, more, logs in self._promising_additions(choices, added):
                longer = (*choice, *more)
                if len(longer) > self.options.most_terms or frozenset(v.term for v in longer) in reached:
                    continue
                best = promises.get(_key(longer))
                if best is None or logs.max() > best[0].max():
                    promises[_key(longer)] = (logs, longer)
        chosen = dict[frozenset[tuple[str, int]], Choice]()
        for kind in range(len(EVIDENCES)):
            ranked = sorted(promises.items(), key=lambda item: -float(item[1][0][kind]))
            chosen |= {key: longer for key, (_, longer) in ranked[: PROMISING * self.options.width]}
        return list(chosen.values())

    def _additions(self, order: Mapping[str, Sequence[Variant]]) -> list[Choice]:
        """Every term that may be added, by each of its ways, with and without the terms it builds on."""
        additions: list[Choice] = []
        for term, ways in order.items():
            carried = [t for t in self.model.terms[term].with_terms if t not in self.baseline]
            if any(t not in order for t in carried):
                continue
            for brought in chain.from_iterable(combinations(carried, n) for n in range(len(carried) + 1)):
                additions += [(*(order[t][0] for t in brought), way) for way in ways]
        return additions

    def _promising_additions(
        self, choices: Sequence[Choice], added: Sequence[Choice]
    ) -> Iterator[tuple[Choice, Choice, FloatArray]]:
        """Choices of one number of responses with additions that fit them, and both promises of evidence."""
        batch = _batch(choices, _width(choices[0]))
        for width in sorted({_width(more) for more in added}):
            same = [more for more in added if _width(more) == width]
            places = np.array([[p for v in more for p in v.places] for more in same], dtype=np.int64)
            positive = np.array([[s for v in more for s in v.positive] for more in same], dtype=bool)
            logs = np.stack(extended_evidence(self.responses.grams, batch, places, positive), axis=-1)
            logs[~self._fits(choices, same)] = -np.inf
            for i, j in _largest_places(logs, LOOKED_AT * self.options.width):
                yield choices[i], same[j], logs[i, j] + self._log_prior((*choices[i], *same[j]))

    def _fits(self, choices: Sequence[Choice], added: Sequence[Choice]) -> BoolArray:
        """Whether each addition is what each structure lacks for one more term, (S, V)."""
        terms = [frozenset(v.term for v in choice) | self.baseline for choice in choices]
        fits = np.empty((len(choices), len(added)), dtype=bool)
        for j, more in enumerate(added):
            new, brought = more[-1].term, {v.term for v in more[:-1]}
            carried = self.model.terms[new].with_terms
            fits[:, j] = [
                new not in structure and {t for t in carried if t not in structure} == brought
                for structure in terms
            ]
        return fits


def _largest_places(logs: FloatArray, most: int) -> list[tuple[int, int]]:
    """Places of the so many largest of logs (S, V, K), for each of the K kinds."""
    places = dict[tuple[int, int], None]()
    for kind in range(logs.shape[-1]):
        flat = logs[..., kind].ravel()
        first = np.argpartition(-flat, min(most, len(flat)) - 1)[:most]
        for place in first[np.isfinite(flat[first])]:
            i, j = divmod(int(place), logs.shape[1])
            places[i, j] = None
    return list(places)


def _width(choice: Choice) -> int:
    """How many responses a structure has."""
    return sum(len(v.keys) for v in choice)


def _key(choice: Choice) -> frozenset[tuple[str, int]]:
    return frozenset((v.term, v.first) for v in choice)


def _batch(choices: Sequence[Choice], width: int) -> Batch:
    """Structures of one number of responses, as arrays."""
    shape = (len(choices), width)
    columns = [[c for v in choice for c in v.places] for choice in choices]
    block = [[b for b, v in enumerate(choice) for _ in v.keys] for choice in choices]
    positive = [[s for v in choice for s in v.positive] for choice in choices]
    return Batch(
        np.array(columns, dtype=np.int64).reshape(shape),
        np.array(block, dtype=np.int64).reshape(shape),
        np.array(positive, dtype=bool).reshape(shape),
    )
