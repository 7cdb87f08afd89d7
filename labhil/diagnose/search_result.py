"""What a search for missing terms stands at, and what it found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from labhil.diagnose.collapsed import Collapsed
from labhil.diagnose.curve import Curved
from labhil.diagnose.evidence import Evidence
from labhil.identify.fitted import Fitted


@dataclass(frozen=True, slots=True)
class Step:
    """One accepted addition with its evidence; ``p_search`` is corrected for all candidates looked at.

    ``told``: it explains enough to be worth telling, and a size of it is told from zero. ``probability`` is
    that of all likely structures that have it, where these were compared.
    """

    terms: tuple[str, ...]
    evidence: Evidence
    p_search: float
    told: bool
    probability: float | None = None


@dataclass(frozen=True, slots=True)
class Rival:
    """A term that would do about as well in the place of another.

    ``delta_bic`` has the held-out data in it: −2 times the log odds against it.
    """

    term: str
    instead_of: str
    delta_bic: float
    probability: float


@dataclass(frozen=True, slots=True)
class Minor:
    """A term that was seen, and the ``share`` of the mismatch that it explains: too little to be named."""

    term: str
    share: float


@dataclass(frozen=True, slots=True)
class Alternative:
    """What a structure that was refitted estimates: ``values`` by key, with its ``probability``."""

    probability: float
    values: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class FittedCurve:
    """A curve as it was refitted ``beside`` some terms, and its log odds over the likeliest named ones."""

    curved: Curved
    beside: Fitted
    log_odds: float


@dataclass(frozen=True, slots=True)
class SearchResult:
    """Where a search ended; ``errors`` are standard errors by key that its fits by themselves cannot know.

    ``collapsed`` are sizes of the rig that gave way in the baseline. ``curve`` is a force without a name that
    is likelier than more names, fitted beside those that are left. ``minor`` are terms that explain
    too little, ``open`` those that are about as likely as not. ``disturbed`` says that by the evidence
    something lasts beside the likeliest structure. ``alternatives`` are that and all others that were
    refitted. ``complete`` is False where it was ended early, with the best so far.
    """

    baseline: Fitted
    final: Fitted
    missing: tuple[Step, ...]
    rivals: tuple[Rival, ...]
    p_value: float
    looks: int
    errors: Mapping[str, float] = field(default_factory=dict)
    collapsed: tuple[Collapsed, ...] = ()
    complete: bool = True
    curve: FittedCurve | None = None
    minor: tuple[Minor, ...] = ()
    open: tuple[str, ...] = ()
    disturbed: bool = False
    alternatives: tuple[Alternative, ...] = ()

    @property
    def nothing(self) -> SearchResult:
        """The same search if nothing of what it found is told."""
        return replace(self, final=self.baseline, missing=(), rivals=())

    def ending(self, final: Fitted, steps: tuple[Step, ...]) -> SearchResult:
        """The same search if it ends at ``final`` with these of its steps, and their rivals."""
        there = {step.terms[0] for step in steps}
        rivals = tuple(rival for rival in self.rivals if rival.instead_of in there)
        return replace(self, final=final, missing=steps, rivals=rivals) if steps else self.nothing

    def between_structures(self, key: str) -> float:
        """How far other likely structures' estimates of a parameter are from the final one, RMS.

        The part of an estimate's variance that is between models (Hoeting and others 1999).
        """
        own = self.final.estimates
        having = [each for each in self.alternatives if key in each.values]
        if key not in own or not having:
            return 0.0
        squares = [each.probability * (each.values[key] - own[key]) ** 2 for each in having]
        return float(np.sqrt(sum(squares) / sum(each.probability for each in having)))

    @property
    def possible(self) -> frozenset[str]:
        """Terms that may be there though they are not named: rivals, open ones, those that explain little."""
        named = (rival.term for rival in self.rivals)
        return frozenset((*named, *self.open, *(each.term for each in self.minor)))

    def step(self, term: str) -> Step:
        """The step that added a term; StopIteration where it was none that counts."""
        return next(step for step in self.missing if step.terms[0] == term)
