"""A diagnosis as its JSON says it (`labhil.diagnosis/1`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from labhil.analysis.diagnosis_words import next_steps
from labhil.analysis.schema.parts import (
    ChannelErrors,
    EstimatedCurve,
    Fault,
    Interval,
    Number,
    Parameter,
    Parameters,
    Part,
    RecordingErrors,
    Score,
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


BEFORE_AND_AFTER = ("mse", "rmse", "max_abs_error", "r2", "relative_error")
"""Figures of a channel that are stated of the model before and after."""


class ChannelImprovement(Part):
    """One channel before and after."""

    channel: str
    joint: int | None = None
    unit: str = ""
    rmse_before: Number
    rmse_after: Number
    noise_floor: Number = None
    noise_floor_before: Number = None
    r2_before: Number = None
    r2_after: Number = None
    mse_before: Number = None
    mse_after: Number = None
    max_abs_error_before: Number = None
    max_abs_error_after: Number = None
    relative_error_before: Number = None
    relative_error_after: Number = None
    metric: str | None = None

    @property
    def before(self) -> ChannelErrors:
        """Its errors with the model before the search."""
        before = self.noise_floor if self.noise_floor_before is None else self.noise_floor_before
        return self._errors("before", before)

    @property
    def after(self) -> ChannelErrors:
        """Its errors with the final model."""
        return self._errors("after", self.noise_floor)

    def _errors(self, when: str, noise_floor: Number) -> ChannelErrors:
        figures = {name: getattr(self, f"{name}_{when}") for name in BEFORE_AND_AFTER}
        return ChannelErrors(
            channel=self.channel,
            joint=self.joint,
            unit=self.unit,
            noise_floor=noise_floor,
            metric=self.metric,
            **figures,
        )


class RecordingImprovement(Part):
    """One of several recordings before and after."""

    recording: int
    per_channel: tuple[ChannelImprovement, ...]


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


class ShorterWindows(Part):
    """The headline before and after on windows as short as the search's."""

    horizon: Number = None
    rmse_before: Number
    rmse_after: Number


class Improvement(Part):
    """How much better the final model predicts data that the search never saw.

    Attributes:
        data: ``test`` or ``heldout``.
        parts: Whether these are parts of a recording of which the search saw the parts between.
        metric: ``windowed_simulation`` or ``inverse_dynamics``.
        horizon: Length of the simulated windows, s.
        rmse_before: The headline of the model as it was: in the output's unit, or, with several outputs, the
            mean over their noise floors.
        rmse_after: The same of the final model.
        noise_floor: What a perfect model would reach.
        r2_before: Mean R², a fraction.
        r2_after: The same of the final model.
        per_channel: The same of each output.

    Example:
        >>> import labhil as lh
        >>> better = lh.load("examples/diagnosis.json").improvement
        >>> round(better.r2_after, 3), better.rmse_after < 1.1 * better.noise_floor
        (1.0, True)
    """

    data: str = "heldout"
    parts: bool = False
    metric: str = "windowed_simulation"
    horizon: Number = None
    rmse_before: Number
    rmse_after: Number
    noise_floor: Number = None
    mse_before: Number = None
    mse_after: Number = None
    r2_before: Number = None
    r2_after: Number = None
    per_channel: tuple[ChannelImprovement, ...] = ()
    per_recording: tuple[RecordingImprovement, ...] = ()
    shorter_windows: ShorterWindows | None = None

    @property
    def before(self) -> Score:
        """The errors of the model before the search, as of a fit."""
        return self._score("before")

    @property
    def after(self) -> Score:
        """The errors of the final model, as of a fit."""
        return self._score("after")

    def _score(self, when: str) -> Score:
        return Score(
            metric=self.metric,
            horizon=self.horizon,
            rmse=getattr(self, f"rmse_{when}"),
            r2=getattr(self, f"r2_{when}"),
            noise_floor=self.noise_floor,
            per_channel=tuple(getattr(row, when) for row in self.per_channel),
            per_recording=tuple(
                RecordingErrors(
                    recording=own.recording,
                    per_channel=tuple(getattr(row, when) for row in own.per_channel),
                )
                for own in self.per_recording
            ),
        )

    @property
    def unit(self) -> str:
        """Of the headline, which is in multiples of noise floors where it is of several channels."""
        own = [row for row in self.per_channel if row.metric in (None, self.metric)]
        return own[0].unit if len(own) == 1 else ""


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
