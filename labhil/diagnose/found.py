"""What a search for missing terms stands at, and what it found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from labhil.diagnose.collapsed import Collapsed
from labhil.diagnose.curve import Curved
from labhil.diagnose.evidence import Evidence
from labhil.identify.fitted import Fitted

BETTER = 1e-3
"""Share of the cost by which a fit of the same terms has to be better to be another one."""


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
    probability: float | None = None


@dataclass(frozen=True, slots=True)
class FittedCurve:
    """A curve as it was refitted ``beside`` some terms, and its log odds over the likeliest named ones."""

    curved: Curved
    beside: Fitted
    log_odds: float


@dataclass(frozen=True, slots=True)
class Found:
    """Where a search ended; ``errors`` are standard errors by key that its fits by themselves cannot know.

    ``collapsed`` are sizes of the rig that gave way in the baseline. ``curve`` is a force without a name that
    is likelier than more names, fitted beside those that are left.
    ``complete`` is False where it was ended early, with the best so far.
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

    @property
    def nothing(self) -> Found:
        """The same search if nothing of what it found is told."""
        return replace(self, final=self.baseline, missing=(), rivals=())

    def ending(self, final: Fitted, steps: tuple[Step, ...]) -> Found:
        """The same search if it ends at ``final`` with these of its steps, and their rivals."""
        there = {step.terms[0] for step in steps}
        rivals = tuple(rival for rival in self.rivals if rival.instead_of in there)
        return replace(self, final=final, missing=steps, rivals=rivals) if steps else self.nothing

    def step(self, term: str) -> Step:
        """The step that added a term; StopIteration where it was none that counts."""
        return next(step for step in self.missing if step.terms[0] == term)


@dataclass(slots=True)
class Trail:
    """Where a search stands: the best model so far, p values of its steps, rivals of its terms.

    ``been`` are the sets of terms that it stood at, with the cost there: it goes back only to a better fit,
    for a first one may have ended in a wrong valley.
    """

    current: Fitted
    p_values: list[float]
    rivals: tuple[Rival, ...] = ()
    been: dict[frozenset[str], float] = field(default_factory=dict)

    def begin(self, fitted: Fitted) -> None:
        """Stand there, on windows on which it has been nowhere yet."""
        self.been = {frozenset(fitted.terms): fitted.solution.cost}
        self.current = fitted

    def may_go(self, fitted: Fitted) -> bool:
        """Whether it has not stood there, or at a clearly worse fit of the same terms."""
        cost = self.been.get(frozenset(fitted.terms), float("inf"))
        return fitted.solution.cost < (1.0 - BETTER) * cost

    def go(self, fitted: Fitted) -> bool:
        """Stand there from now on; False, and stay, where it has been before."""
        if not self.may_go(fitted):
            return False
        self.been[frozenset(fitted.terms)] = fitted.solution.cost
        self.current = fitted
        return True
