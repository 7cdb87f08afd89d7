"""The result of a structure search: terms with their evidence, rivals, and fits.

``structures/stages.py`` makes it, ``conclude.py`` and ``statements.py`` turn it into an answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labhil.diagnose.collapsed import Collapsed
from labhil.diagnose.curve import CurveFit
from labhil.diagnose.evidence import Evidence
from labhil.identify.fitted import Fitted


@dataclass(frozen=True, slots=True)
class Step:
    """An addition that the data support.

    Attributes:
        terms: keys of the added terms; the first one names it.
        evidence: its evidence.
        p_search: p value on the search data, corrected for the number of candidates.
        probability: posterior probability of all structures that have it, where structures were compared.
    """

    terms: tuple[str, ...]
    evidence: Evidence
    p_search: float
    probability: float | None = None


@dataclass(frozen=True, slots=True)
class Rival:
    """A term that explains the data about as well in the place of another one.

    Attributes:
        term: key of the rival.
        instead_of: key of the named term.
        delta_bic: 2 times the log odds of the named term over the rival.
        probability: posterior probability of the rival.
    """

    term: str
    instead_of: str
    delta_bic: float
    probability: float


@dataclass(frozen=True, slots=True)
class Minor:
    """A term that explains too little to be named: only the ``share`` of the mismatch."""

    term: str
    share: float


@dataclass(frozen=True, slots=True)
class Alternative:
    """Estimates of a refitted structure: ``values`` by parameter key, and the structure's ``probability``."""

    probability: float
    values: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class FittedCurve:
    """A force curve, the fit of the terms ``beside`` it, and its log odds over the likeliest named terms."""

    curve_fit: CurveFit
    beside: Fitted
    log_odds: float


@dataclass(frozen=True, slots=True)
class SearchResult:
    """The result of a structure search.

    Attributes:
        baseline: the fit of the baseline.
        final: the fit of baseline and named terms.
        missing: the named terms, strongest first.
        rivals: terms that explain the data about as well in the place of a named one.
        p_value: p value of the baseline on the search data.
        n_candidates: number of candidate terms.
        errors: standard errors by parameter key that the covariance of a fit does not contain.
        collapsed: sizes of the rig that collapsed in the baseline.
        complete: False where the user ended the search early; the result is then the best so far.
        curve: a force curve that is likelier than further named terms, fitted beside the named ones.
        minor: terms that explain too little to be named.
        open: terms that are about as likely as not.
        disturbed: whether the evidence favours a lasting disturbance beside the likeliest structure.
        alternatives: the likeliest structure and all others that were refitted.
        doubtful: terms that were to be named, but explain nothing of held-out data.
    """

    baseline: Fitted
    final: Fitted
    missing: tuple[Step, ...]
    rivals: tuple[Rival, ...]
    p_value: float
    n_candidates: int
    errors: Mapping[str, float] = field(default_factory=dict)
    collapsed: tuple[Collapsed, ...] = ()
    complete: bool = True
    curve: FittedCurve | None = None
    minor: tuple[Minor, ...] = ()
    open: tuple[str, ...] = ()
    disturbed: bool = False
    alternatives: tuple[Alternative, ...] = ()
    doubtful: tuple[str, ...] = ()

    @property
    def without_claims(self) -> SearchResult:
        """The same search without named terms."""
        return replace(self, final=self.baseline, missing=(), rivals=())

    def with_doubtful(self, terms: Sequence[str]) -> SearchResult:
        """The same search with neither named terms nor a curve; ``terms`` are doubtful instead."""
        return replace(self.without_claims, curve=None, doubtful=tuple(terms))

    def with_steps(self, final: Fitted, steps: tuple[Step, ...]) -> SearchResult:
        """Keep some of the named terms and their rivals.

        Args:
            final: the fit of baseline and kept terms.
            steps: the kept terms.

        Returns:
            The reduced result; without any step it ends at the baseline.
        """
        named = {step.terms[0] for step in steps}
        rivals = tuple(rival for rival in self.rivals if rival.instead_of in named)
        return replace(self, final=final, missing=steps, rivals=rivals) if steps else self.without_claims

    def with_better_final(self, final: Fitted) -> SearchResult:
        """Replace the final fit and its structure's own estimates by a better fit of the same terms."""
        own = self.final.estimates.keys()
        alternatives = tuple(
            replace(alternative, values=final.estimates) if alternative.values.keys() == own else alternative
            for alternative in self.alternatives
        )
        return replace(self, final=final, alternatives=alternatives)

    def between_structures(self, key: str) -> float:
        """RMS difference between other likely structures' estimates of a parameter and the final one.

        This is the between-model part of the variance in Bayesian model averaging (Hoeting and others, Stat.
        Sci. 14, 1999).

        Args:
            key: key of the parameter.

        Returns:
            RMS in SI units; 0 where no other structure has the parameter.
        """
        estimates = self.final.estimates
        with_key = [alternative for alternative in self.alternatives if key in alternative.values]
        if key not in estimates or not with_key:
            return 0.0
        squares = [
            alternative.probability * (alternative.values[key] - estimates[key]) ** 2
            for alternative in with_key
        ]
        return float(np.sqrt(sum(squares) / sum(alternative.probability for alternative in with_key)))

    @property
    def possible(self) -> frozenset[str]:
        """Keys of terms that may be present though not named: rivals, open, minor and doubtful ones."""
        rivals = (rival.term for rival in self.rivals)
        return frozenset((*rivals, *self.open, *self.doubtful, *(minor.term for minor in self.minor)))
