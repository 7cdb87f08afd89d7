"""A diagnosis as its JSON says it (`labhil.diagnosis/1`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from labhil.analysis.diagnosis_words import next_steps
from labhil.analysis.schema.improvement import Improvement
from labhil.analysis.schema.parts import (
    EstimatedCurve,
    Fault,
    Interval,
    Number,
    Parameter,
    Parameters,
    Part,
    Source,
    StudyPart,
)
from labhil.physics.terms import keyed


class FittedModel(Part):
    """A model: its terms and parameters."""

    terms: tuple[str, ...]
    parameters: Parameters


class ChangedParameter(Part):
    """A parameter that is not what the reference says."""

    name: str
    joint: int | None = None
    before: Number
    after: Number
    unit: str = ""
    ci99: Interval | None = None
    p_value: Number = None
    recording: int | None = None


class Regime(Part):
    """A range of a coordinate in which an effect lives."""

    coordinate: str
    low: Number
    high: Number
    share_of_excess: Number = None
    unit: str = ""
    term: str = ""
    joint: int | None = None


class Location(Part):
    """Where the mismatch is.

    Attributes:
        channel: The output that is off.
        joint: Its joint, from 0, of an arm.
        enters: Where the missing effect comes in: ``force``, ``input``, ``output``, ``electrical``, …
        times: When it is worst, from … to, s.
        regimes: Ranges of a coordinate in which it lives: ``coordinate``, ``low``, ``high``, ``unit``,
            ``share_of_excess`` (of the squared error that the final model takes away).
        statement: The same in a sentence or two.

    Example:
        >>> import labhil as lh
        >>> where = lh.load("examples/diagnosis.json").where
        >>> where.channel, where.enters
        ('ball_position', 'input')
    """

    channel: str
    joint: int | None = None
    enters: str
    times: tuple[Interval, ...] = ()
    times_in: tuple[int, ...] = ()
    regimes: tuple[Regime, ...] = ()
    statement: str


class Evidence(Part):
    """How strongly the data speak for a term."""

    delta_bic: Number = None
    p_value: Number = None
    heldout_loglik_gain: Number = None


class MissingEffect(Part):
    """An effect that the model lacks.

    Attributes:
        term: Its name in the catalogue.
        joint: The joint that it acts on, from 0, of an arm.
        statement: What was found, in a sentence.
        equation: Its law.
        probability: That it is really there; such claims are calibrated on trials with known answers.
        parameters: Its estimates.
        evidence: ``delta_bic``, ``p_value`` and ``heldout_loglik_gain`` (nats).

    Example:
        >>> import labhil as lh
        >>> effect = lh.load("examples/diagnosis.json").missing[0]
        >>> effect.term, effect.probability > 0.9
        ('dead_zone', True)
        >>> effect.parameters.keys()
        ['dead_zone.left', 'dead_zone.right']
    """

    term: str
    joint: int | None = None
    statement: str
    equation: str = ""
    probability: Number = None
    parameters: Parameters = Parameters()
    evidence: Evidence = Evidence()

    def __str__(self) -> str:
        chance = "" if self.probability is None else f" ({100 * self.probability:.0f} %)"
        return f"{keyed(self.term, self.joint)}{chance}: {self.statement}"


class Rival(Part):
    """What might stand in the place of a found effect.

    Attributes:
        term: Its name.
        instead_of: The found effect.
        joint: Of an arm, from 0.
        probability: That it is this one.
        delta_bic: By how much it explains the data worse.
        distinguishable: Whether these data tell the two apart.
        experiment: What would tell them apart.

    Example:
        >>> import labhil as lh
        >>> lh.load("examples/diagnosis.json").rivals
        ()
    """

    term: str
    instead_of: str
    joint: int | None = None
    probability: Number = None
    delta_bic: Number = None
    distinguishable: bool = False
    experiment: str = ""


class UndecidedEffect(Part):
    """A term of which the data cannot speak."""

    term: str
    joint: int | None = None
    needs: tuple[str, ...] = ()
    reason: str = ""


class ExcludedEffect(Part):
    """An effect that is not there, or smaller than this.

    Attributes:
        term: Its name.
        joint: Of an arm, from 0.
        largest_hidden: The largest size of its main parameter that could hide in these data, in ``unit``.
        unit: SI.
        confidence: That it is smaller.
        recording: Which of several recordings this is said of, from 1.

    Example:
        >>> import labhil as lh
        >>> excluded = {each.term: each for each in lh.load("examples/diagnosis.json").excluded}
        >>> excluded["spring_force"].unit, excluded["spring_force"].confidence
        ('N/m', 0.99)
    """

    term: str
    joint: int | None = None
    largest_hidden: Number
    unit: str = ""
    confidence: Number = None
    recording: int | None = None


class Remainder(Part):
    """What the answer explains of the error on data that the search never saw, and what remains.

    Attributes:
        explained: Share of the squared error beyond the noise that is gone, of the worst output.
        noise_floors: RMSE that remains there, over the noise floor.
        is_noise: Whether nothing remains but noise.
        channel: That output.
        joint: Its joint, from 0, of an arm.
        regimes: Ranges of a coordinate that hold most of what remains.
        statement: The same in a sentence or two.
    """

    explained: Number
    noise_floors: Number
    is_noise: bool = False
    channel: str
    joint: int | None = None
    regimes: tuple[Regime, ...] = ()
    statement: str


Verdict = Literal[
    "no_mismatch",
    "parameter_change",
    "missing_physics",
    "unexplained_mismatch",
    "data_fault",
    "not_decidable",
]


class CollapsedSize(Part):
    """A size of the rig that the baseline alone takes far from what is known of it."""

    key: str
    value: Number
    nominal: Number
    unit: str = ""
    statement: str = ""


class DiagnosisPart(StudyPart):
    """`labhil.diagnosis/1`."""

    recordings: tuple[Source, ...]
    verdict: Verdict
    faults: tuple[Fault, ...] = ()
    doubts: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    collapsed: tuple[CollapsedSize, ...] = ()
    p_value: Number
    p_value_method: str = ""
    p_value_floor: Number = None
    baseline: FittedModel
    changed: tuple[ChangedParameter, ...] = ()
    location: Location | None = None
    missing: tuple[MissingEffect, ...] = ()
    rivals: tuple[Rival, ...] = ()
    undecided: tuple[UndecidedEffect, ...] = ()
    excluded: tuple[ExcludedEffect, ...] = ()
    improvement: Improvement | None = None
    remainder: Remainder | None = None
    final: FittedModel
    scale_factor: Number = None
    curve: EstimatedCurve | None = None
    further_curves: tuple[EstimatedCurve, ...] = ()

    @property
    def asks_baseline(self) -> bool:
        """Whether ``p_value`` tells whether the baseline suffices; 1 stands for nothing else."""
        return self.verdict not in ("data_fault", "not_decidable")

    @property
    def next_steps(self) -> tuple[str, ...]:
        """What to do next, the most useful first: a sentence or two each."""
        return next_steps(self)

    @property
    def judged_rows(self) -> Sequence[Parameter]:
        """The final model's parameters; none is called significant or not where more than noise remains."""
        explained = self.verdict in ("no_mismatch", "parameter_change", "missing_physics")
        if explained and self.remainder is None:
            return self.final.parameters
        return tuple(row.model_copy(update={"significant": None}) for row in self.final.parameters)
