"""Prior probability of structures, and the terms that may be added to them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from math import comb, log

import numpy as np

from labhil.physics.model import Model
from labhil.physics.terms import listed
from labhil.signals import BoolArray, FloatArray

Structure = frozenset[str]
"""Keys of the terms that are added to the baseline."""


def described(structure: Structure) -> str:
    """The structure for people: the baseline, and what is added to it."""
    return "the baseline" + "".join(f" + {term}" for term in listed(sorted(structure)))


def candidates(model: Model, present: Sequence[str]) -> list[tuple[str, ...]]:
    """Every absent term, preceded by the absent terms that it builds on (Stribeck on Coulomb friction)."""
    absent = [name for name in model.terms if name not in present]
    return [(*(t for t in model.terms[name].with_terms if t in absent), name) for name in absent]


def closure(model: Model, terms: Iterable[str], baseline: frozenset[str]) -> Structure:
    """Complete a set of terms by those that they build on, and leave out the terms of the baseline."""
    chosen = frozenset(terms)
    return frozenset({*chosen, *(t for term in chosen for t in model.terms[term].with_terms)}) - baseline


def log_prior(model: Model, structure: Structure, n_candidates: int) -> float:
    """Log prior probability of a structure, up to a constant.

    Every number of terms is half as probable as one less, and all structures with the same number of terms
    are equally probable (Chen and Chen 2008, extended BIC with γ = 1). Terms that others build on do not
    count.

    Args:
        model: the model, whose terms state what they build on.
        structure: keys of the added terms.
        n_candidates: number of terms that may be added.
    """
    carried = {t for term in structure if term in model.terms for t in model.terms[term].with_terms}
    return _log_prior_of(len(structure - carried), n_candidates)


def _log_prior_of(count: int, n_candidates: int) -> float:
    """Log prior probability of a structure with so many terms that no other one builds on."""
    return -count * log(2.0) - log(comb(max(n_candidates, count), count))


@dataclass(frozen=True, slots=True)
class TermTable:
    """Prior of many structures with many additions at once, by matrices over the terms.

    Attributes:
        model: the model, whose terms state what they build on.
        baseline: keys of the terms that every structure has.
    """

    model: Model
    baseline: frozenset[str]

    def may_be_added(
        self,
        structures: Sequence[Collection[str]],
        new: Sequence[str],
        additions: Sequence[Collection[str]],
    ) -> BoolArray:
        """Whether each addition is one new term of each structure and all the terms it builds on.

        Args:
            structures: keys of the terms of S structures.
            new: key of the new term of each of V additions.
            additions: keys of all their terms.

        Returns:
            (S, V).
        """
        present = self._members([{*structure, *self.baseline} for structure in structures])
        absent = self._members(additions)
        needed = self._members([{*self._carried([n])} - {*a} for n, a in zip(new, additions, strict=True)])
        return np.asarray((present @ absent.T == 0) & (present @ needed.T == needed.sum(axis=1)))

    def log_priors(
        self, structures: Sequence[Collection[str]], additions: Sequence[Collection[str]], n_candidates: int
    ) -> FloatArray:
        """Log prior (S, V) of each structure with each addition, as `log_prior` has it.

        Args:
            structures: keys of the terms of S structures.
            additions: keys of the terms of V additions, none of them in a structure.
            n_candidates: number of terms that may be added.
        """
        counted, free = self._counted_and_free(structures)
        counted_added, free_added = self._counted_and_free(additions)
        counts = counted @ free_added.T + free @ counted_added.T
        by_count = [_log_prior_of(count, n_candidates) for count in range(int(counts.max(initial=0.0)) + 1)]
        return np.array(by_count)[counts.astype(np.int64)]

    def _counted_and_free(self, sets: Sequence[Collection[str]]) -> tuple[FloatArray, FloatArray]:
        """Terms of each set that none of it builds on, and all terms that none of it builds on, (S, T)."""
        free = 1.0 - self._members([self._carried(terms) for terms in sets])
        return self._members(sets) * free, free

    def _carried(self, terms: Iterable[str]) -> list[str]:
        """Keys of the terms that these build on."""
        return [t for term in terms for t in self.model.terms[term].with_terms]

    def _members(self, sets: Sequence[Collection[str]]) -> FloatArray:
        """One where a set has a term, (S, T)."""
        place = {term: i for i, term in enumerate(self.model.terms)}
        members = np.zeros((len(sets), len(place)))
        for row, terms in zip(members, sets, strict=True):
            row[[place[term] for term in terms]] = 1.0
        return members
