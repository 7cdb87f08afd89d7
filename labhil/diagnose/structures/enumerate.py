"""All structures that matter on one linearisation, by a beam search over sets of added terms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import comb, log

import numpy as np

from labhil.diagnose.structures.marginal import Batch, log_evidence
from labhil.diagnose.structures.responses import Responses, Variant
from labhil.physics.model import Model
from labhil.signals import FloatArray

Structure = frozenset[str]
"""Keys of the terms beside the baseline."""

WIDTH = 40
"""Structures of each size that are extended."""

KEPT_VARIANTS = 2
"""Ways of a term to act that larger structures try."""

MOST_TERMS = 24


@dataclass(frozen=True, slots=True)
class Predicted:
    """A structure with its log evidence as one linearisation predicts it, and the sizes of its terms by key."""

    structure: Structure
    log_evidence: float
    values: Mapping[str, float]


def closed(model: Model, structure: Iterable[str], baseline: frozenset[str]) -> Structure:
    """A structure with the terms that its terms build on."""
    terms = frozenset(structure)
    return frozenset({*terms, *(t for term in terms for t in model.terms[term].with_terms)}) - baseline


def log_prior(model: Model, structure: Structure, candidates: int) -> float:
    """Prior of a structure: every number of terms half as likely as one less, all of one number alike.

    What others build on comes with them and is not counted (Chen and Chen 2008 for the multiplicity).
    """
    carried = {t for term in structure for t in model.terms[term].with_terms}
    count = len(structure - carried)
    return -count * log(2.0) - log(comb(max(candidates, count), count))


@dataclass(frozen=True, slots=True)
class Enumeration:
    """Evidence of structures on one linearisation."""

    model: Model
    responses: Responses
    baseline: frozenset[str]
    candidates: int

    def evaluate(self, choices: Sequence[tuple[Variant, ...]]) -> list[Predicted]:
        """Log evidence, prior included, of structures that are given by the variants of their terms."""
        found: list[Predicted | None] = [None] * len(choices)
        widths = [sum(len(v.keys) for v in choice) for choice in choices]
        for width in sorted(set(widths)):
            places = [i for i, w in enumerate(widths) if w == width]
            logs, sizes = log_evidence(self.responses.grams, _batch([choices[i] for i in places], width))
            for i, value, own in zip(places, logs, sizes, strict=True):
                found[i] = self._predicted(choices[i], float(value), own)
        return [each for each in found if each is not None]

    def _predicted(self, choice: tuple[Variant, ...], value: float, sizes: FloatArray) -> Predicted:
        structure = frozenset(v.term for v in choice)
        ways = sum(log(len(self.responses.variants[v.term])) for v in choice)
        prior = log_prior(self.model, structure, self.candidates)
        return Predicted(structure, value + prior - ways, self.responses.sizes(choice, sizes))

    def best(self) -> dict[Structure, Predicted]:
        """The best variant of every structure that the beam reaches, the empty one included."""
        variants = self.responses.variants
        single = {term: [(v,) for v in of] for term, of in variants.items()}
        flat = [choice for of in single.values() for choice in of]
        alone = self.evaluate(flat)
        order: dict[str, list[Variant]] = {}
        for predicted, (variant,) in sorted(zip(alone, flat, strict=True), key=lambda pair: -pair[0].log_evidence):
            of = order.setdefault(variant.term, [])
            if len(of) < KEPT_VARIANTS:
                of.append(variant)
        reached: dict[Structure, tuple[Predicted, tuple[Variant, ...]]] = {}
        nothing = self.evaluate([()])[0]
        reached[nothing.structure] = (nothing, ())
        present = [t for t in self.responses.fitted.terms if t not in self.baseline and t in variants]
        seeds: list[tuple[Variant, ...]] = [(), tuple(variants[t][0] for t in present)]
        seeds += [tuple(variants[t][0] for t in present if t != left) for left in present]
        beam = list({_key(seed): seed for seed in seeds if self._is_closed(seed)}.values())
        for predicted, choice in zip(self.evaluate(beam), beam, strict=True):
            reached.setdefault(predicted.structure, (predicted, choice))
        for _ in range(MOST_TERMS):
            extended = self._extended(beam, order, reached)
            if not extended:
                break
            pairs = sorted(zip(self.evaluate(extended), extended, strict=True), key=lambda p: -p[0].log_evidence)
            beam, structures = [], set[Structure]()
            top = max(p.log_evidence for p, _ in reached.values())
            for predicted, choice in pairs:
                known = reached.get(predicted.structure)
                if known is None or predicted.log_evidence > known[0].log_evidence:
                    reached[predicted.structure] = (predicted, choice)
                if predicted.structure not in structures and len(beam) < WIDTH:
                    structures.add(predicted.structure)
                    beam.append(choice)
            if pairs[0][0].log_evidence < top - 30.0:
                break
        return {structure: predicted for structure, (predicted, _) in reached.items()}

    def _is_closed(self, choice: tuple[Variant, ...]) -> bool:
        terms = frozenset(v.term for v in choice)
        return closed(self.model, terms, self.baseline) == terms

    def _extended(
        self,
        beam: Sequence[tuple[Variant, ...]],
        order: Mapping[str, Sequence[Variant]],
        reached: Mapping[Structure, object],
    ) -> list[tuple[Variant, ...]]:
        """Each structure of the beam with one more term, and what that builds on."""
        found = dict[frozenset[tuple[str, int]], tuple[Variant, ...]]()
        for choice in beam:
            terms = frozenset(v.term for v in choice)
            for term, ways in order.items():
                if term in terms:
                    continue
                carried = [t for t in self.model.terms[term].with_terms if t not in terms | self.baseline]
                if any(t not in order for t in carried):
                    continue
                for way in ways:
                    longer = (*choice, *(order[t][0] for t in carried), way)
                    if frozenset(v.term for v in longer) not in reached:
                        found.setdefault(_key(longer), longer)
        return list(found.values())


def _key(choice: tuple[Variant, ...]) -> frozenset[tuple[str, int]]:
    return frozenset((v.term, v.first) for v in choice)


def _batch(choices: Sequence[tuple[Variant, ...]], width: int) -> Batch:
    columns = np.array([[c for v in choice for c in v.places] for choice in choices], dtype=np.int64)
    block = np.array([[b for b, v in enumerate(choice) for _ in v.keys] for choice in choices], dtype=np.int64)
    positive = np.array([[s for v in choice for s in v.positive] for choice in choices], dtype=bool)
    shape = (len(choices), width)
    return Batch(columns.reshape(shape), block.reshape(shape), positive.reshape(shape))
