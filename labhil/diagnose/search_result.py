"""The steps and the result of a search for missing terms."""

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

    ``probability`` is that of all likely structures that have it, where these were compared.
    """

    terms: tuple[str, ...]
    evidence: Evidence
    p_search: float
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
    def without_claims(self) -> SearchResult:
        """The same search if it names nothing."""
        return replace(self, final=self.baseline, missing=(), rivals=())

    def ending(self, final: Fitted, steps: tuple[Step, ...]) -> SearchResult:
        """The same search if it ends at ``final`` with these of its steps, and their rivals."""
        named = {step.terms[0] for step in steps}
        rivals = tuple(rival for rival in self.rivals if rival.instead_of in named)
        return replace(self, final=final, missing=steps, rivals=rivals) if steps else self.without_claims

    def between_structures(self, key: str) -> float:
        """RMS distance of other likely structures' estimates of a parameter from the final one.

        The part of an estimate's variance that is between models (Hoeting and others 1999).
        """
        estimates = self.final.estimates
        having = [alternative for alternative in self.alternatives if key in alternative.values]
        if key not in estimates or not having:
            return 0.0
        squares = [
            alternative.probability * (alternative.values[key] - estimates[key]) ** 2
            for alternative in having
        ]
        return float(np.sqrt(sum(squares) / sum(alternative.probability for alternative in having)))

    @property
    def possible(self) -> frozenset[str]:
        """Terms that may be present though not named: rivals, open ones, those that explain little."""
        named = (rival.term for rival in self.rivals)
        return frozenset((*named, *self.open, *(minor.term for minor in self.minor)))

    def step(self, term: str) -> Step:
        """The step that added a term; StopIteration where it was none that counts."""
        return next(step for step in self.missing if step.terms[0] == term)
