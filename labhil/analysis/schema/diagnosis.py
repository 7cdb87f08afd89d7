"""A diagnosis in its JSON (`labhil.diagnosis/1`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from labhil.analysis.next_steps import next_steps
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
    """A parameter that differs from the reference."""

    name: str
    joint: int | None = None
    before: Number
    after: Number
    unit: str = ""
    ci99: Interval | None = None
    p_value: Number = None
    recording: int | None = None


class Regime(Part):
    """A range of a coordinate in which an effect acts."""

    coordinate: str
    low: Number
    high: Number
    share_of_excess: Number = None
    unit: str = ""
    term: str = ""
    joint: int | None = None


class Location(Part):
    """Where a mismatch is.

    Attributes:
        channel: The output with the largest mismatch.
        joint: Its joint, from 0, of an arm.
        enters: Where the missing effect acts: ``force``, ``input``, ``output``, ``electrical``, …
        times: When it is largest, from … to, s.
        regimes: Ranges of a coordinate in which it acts: ``coordinate``, ``low``, ``high``, ``unit``,
            ``share_of_excess`` (of the squared error that the final model removes).
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
    """The evidence for a term."""

    delta_bic: Number = None
    p_value: Number = None
    heldout_loglik_gain: Number = None


class MissingEffect(Part):
    """An effect that the model lacks.

    Attributes:
        term: Its name in the catalogue.
        joint: The joint that it acts on, from 0, of an arm.
        statement: A sentence about it.
        equation: Its law.
        probability: Probability that it exists, calibrated on trials with known answers.
        parameters: Its estimates.
        evidence: ``delta_bic``, ``p_value`` and ``heldout_loglik_gain`` (nats).

    Example:
        >>> import labhil as lh
        >>> effect = lh.load("examples/diagnosis.json").missing[0]
        >>> effect.term, effect.probability > 0.8
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
    """An alternative to a named effect.

    Attributes:
        term: Its name.
        instead_of: The named effect.
        joint: Its joint, from 0, of an arm.
        probability: Probability that it is this one.
        delta_bic: Its BIC minus that of the named effect.
        distinguishable: Whether these data distinguish the two.
        experiment: An experiment that would distinguish them.

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
    """A term that the data cannot decide on."""

    term: str
    joint: int | None = None
    needs: tuple[str, ...] = ()
    reason: str = ""


class ExcludedEffect(Part):
    """An effect that is absent, or smaller than a limit.

    Attributes:
        term: Its name.
        joint: Its joint, from 0, of an arm.
        largest_hidden: Upper limit of the size of its main parameter, in ``unit``.
        unit: SI unit.
        confidence: Confidence of that limit.
        recording: The recording that this is about, from 1, of several.

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
    """The share of the error on test data that the answer explains, and the remaining error.

    Attributes:
        explained: Explained share of the squared error beyond the noise, of the worst output.
        noise_floors: Remaining RMSE of that output, over the noise floor.
        is_noise: Whether only noise remains.
        channel: That output.
        joint: Its joint, from 0, of an arm.
        regimes: Ranges of a coordinate with most of the remaining error.
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
    """A size of the rig whose estimate under the baseline is far from its known value."""

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
        """Whether ``p_value`` is that of a test of the baseline."""
        return self.verdict not in ("data_fault", "not_decidable")

    @property
    def next_steps(self) -> tuple[str, ...]:
        """The next steps, the most useful first: a sentence or two each."""
        return next_steps(self)

    @property
    def judged_rows(self) -> Sequence[Parameter]:
        """The final model's parameters, without significance where more than noise remains."""
        explained = self.verdict in ("no_mismatch", "parameter_change", "missing_physics")
        if explained and self.remainder is None:
            return self.final.parameters
        return tuple(row.model_copy(update={"significant": None}) for row in self.final.parameters)
