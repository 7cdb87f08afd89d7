"""The answer of a diagnosis: missing terms, rivals, limits, changes, and the whole."""

from __future__ import annotations

from dataclasses import dataclass

from labhil.diagnose.collapsed import Collapsed
from labhil.diagnose.evidence import Evidence
from labhil.diagnose.intake import Fault
from labhil.diagnose.locate import Location
from labhil.diagnose.remainder import Remainder
from labhil.identify.fitted import Fitted
from labhil.identify.score import Score
from labhil.identify.statistics import Estimate
from labhil.physics.model import Record
from labhil.physics.terms import keyed
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class Missing:
    """One effect that the baseline lacks; ``probability`` is that it is really there."""

    term: str
    joint: int | None
    statement: str
    equation: str
    probability: float
    parameters: list[Estimate]
    evidence: Evidence


@dataclass(frozen=True, slots=True)
class RivalTerm:
    """A term that would explain the data about as well in the place of a missing one."""

    term: str
    instead_of: str
    joint: int | None
    probability: float
    delta_bic: float
    distinguishable: bool
    experiment: str


@dataclass(frozen=True, slots=True)
class Undecided:
    """A term that these data cannot decide."""

    term: str
    joint: int | None
    needs: tuple[str, ...]
    reason: str


@dataclass(frozen=True, slots=True)
class Excluded:
    """A term that is not there: the largest size of its main parameter that could hide in the data.

    ``recording`` is the one that this holds for, where each has a value of its own.
    """

    term: str
    joint: int | None
    largest_hidden: float
    unit: str
    confidence: float
    recording: int | None = None


@dataclass(frozen=True, slots=True)
class Change:
    """A parameter whose value differs from that of the user's own model."""

    name: str
    joint: int | None
    before: float
    after: float
    unit: str
    ci99: tuple[float, float]
    p_value: float
    recording: int | None = None


@dataclass(frozen=True, slots=True)
class Curve:
    """What no named term explains: ``value`` (m,) in ``unit`` over ``x`` (m,) of one coordinate.

    ``low`` and ``high`` (m,) are a pointwise 99 % band; ``acts`` says which way it acts; ``formula`` is a
    short one that lies within the band, if there is one; ``share`` is how much of the mismatch it explains
    on data that the search never saw; ``joint`` is the one of an arm that it acts on.
    """

    depends_on: str
    acts: str
    x: FloatArray
    value: FloatArray
    low: FloatArray
    high: FloatArray
    unit: str
    x_unit: str
    formula: str | None
    share: float
    joint: int | None = None


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The answer. ``data`` is "test" or "heldout"; scores are of ``held_out``, which the search never saw.

    ``faults`` are those of the data, whether or not they make them unfit. ``wider`` says that scores are on
    parts of what was held out, and that the parts between were searched; ``shorter`` are scores before and
    after on windows as short as the search's, where the answer only shows on those. ``collapsed`` are sizes
    of the rig that the baseline alone takes far from what is known of them. ``remainder`` is what the answer
    explains and what it leaves. ``curve`` is the
    strongest one, ``further_curves`` are those of an arm's other joints. ``scale_factor`` is in all errors of
    ``final``: by it parts of the data disagree on the values more than noise explains.
    ``complete`` is False where it was ended early, with the best so far.
    """

    verdict: str
    faults: tuple[Fault, ...]
    p_value: float
    p_value_method: str
    p_value_floor: float
    baseline_terms: tuple[str, ...]
    baseline: list[Estimate]
    changed: tuple[Change, ...]
    location: Location | None
    missing: tuple[Missing, ...]
    rivals: tuple[RivalTerm, ...]
    undecided: tuple[Undecided, ...]
    excluded: tuple[Excluded, ...]
    data: str
    held_out: Record
    before: Score
    after: Score
    final_terms: tuple[str, ...]
    final: list[Estimate]
    baseline_fit: Fitted
    final_fit: Fitted
    curve: Curve | None
    seconds: float
    further_curves: tuple[Curve, ...] = ()
    shorter: tuple[Score, Score] | None = None
    collapsed: tuple[Collapsed, ...] = ()
    wider: bool = False
    complete: bool = True
    remainder: Remainder | None = None
    scale_factor: float = 1.0

    @property
    def named(self) -> list[str]:
        """Keys of the missing effects that have a name; what has none has a curve."""
        keys = (keyed(item.term, item.joint) for item in self.missing)
        return [key for key in keys if key in self.final_fit.problem.model.terms]
