"""The answer of a diagnosis: missing terms, rivals, exclusion limits, changed values and scores.

``diagnosis.py`` fills it in; ``analysis/results.py`` writes it as JSON.
"""

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
from labhil.physics.record import Record
from labhil.physics.terms import keyed
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class Missing:
    """An effect that the baseline lacks, with the ``probability`` that it is really there."""

    term: str
    joint: int | None
    statement: str
    equation: str
    probability: float
    parameters: list[Estimate]
    evidence: Evidence


@dataclass(frozen=True, slots=True)
class RivalTerm:
    """A term that explains the data about as well in the place of a missing one."""

    term: str
    instead_of: str
    joint: int | None
    probability: float
    delta_bic: float
    distinguishable: bool
    experiment: str


@dataclass(frozen=True, slots=True)
class Undecided:
    """A term that these data neither confirm nor exclude, and what they would need."""

    term: str
    joint: int | None
    needs: tuple[str, ...]
    reason: str


@dataclass(frozen=True, slots=True)
class Excluded:
    """A term that is excluded above a limit: the largest size of its main parameter that could be hidden.

    ``recording`` is the one that the limit holds for, where each has a value of its own.
    """

    term: str
    joint: int | None
    largest_hidden: float
    unit: str
    confidence: float
    recording: int | None = None


@dataclass(frozen=True, slots=True)
class Change:
    """A parameter whose value differs significantly from that of the user's own model."""

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
    """A force that no named term explains, as a curve over one coordinate.

    Attributes:
        depends_on: name of the coordinate.
        acts: how it acts: as a force, as the level of a friction or as a damping.
        x: points of the coordinate, (m,), in ``x_unit``.
        value: the curve there, (m,), in ``unit``.
        low: lower end of its pointwise 99 % band, (m,).
        high: upper end of the band, (m,).
        unit: unit of the force.
        x_unit: unit of the coordinate.
        formula: a short formula within the band, if there is one.
        share: share of the mismatch that it explains on held-out data.
        joint: joint of an arm that it acts on.
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
    """The answer of a diagnosis.

    Attributes:
        verdict: missing_physics, parameter_change, no_mismatch, unexplained_mismatch, not_decidable or
            data_fault.
        faults: faults of the data, whether or not they make the data unusable.
        p_value: p value that the baseline suffices.
        p_value_method: how the p value was computed.
        p_value_floor: smallest p value of that method.
        baseline_terms: keys of the baseline's terms.
        baseline: estimates of the baseline.
        changed: parameters that differ from the user's values.
        location: where the mismatch is.
        missing: effects that the baseline lacks, strongest first.
        rivals: terms that explain the data about as well as a missing one.
        undecided: terms that the data cannot decide.
        excluded: limits of the absent terms.
        data: "test" or "heldout", the kind of held-out data.
        held_out: the held-out data, on which the scores are.
        before: score of the baseline.
        after: score of the final model.
        final_terms: keys of the final model's terms.
        final: estimates of the final model.
        baseline_fit: the fit of the baseline.
        final_fit: the fit of the final model.
        curve: the strongest force that no named term explains.
        seconds: duration of the diagnosis, s.
        further_curves: such forces on other joints of an arm.
        shorter: scores before and after on windows of the search's length, where only those show the gain.
        collapsed: sizes of the rig that collapsed in the baseline.
        wider: whether the search had every other part of the held-out data, and scores are on the rest.
        complete: False where the user ended the diagnosis early; it is then the best answer so far.
        remainder: the error that remains.
        scale_factor: factor in all errors of ``final`` by which parts of the data disagree.
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
        """Keys of the missing effects that are named terms, not curves."""
        keys = (keyed(item.term, item.joint) for item in self.missing)
        return [key for key in keys if key in self.final_fit.problem.model.terms]
