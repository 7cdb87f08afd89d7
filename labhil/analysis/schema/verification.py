"""A verification in its JSON (`labhil.verification/1`)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from labhil.analysis.next_steps import steps_after_verification
from labhil.analysis.schema.parts import Fault, Number, Part, Score, Source
from labhil.analysis.verdicts import fit_verdict


class ChannelVerdict(Part):
    """The tests of one output: its RMSE over the noise floor, and the limit that noise rarely exceeds.

    ``rmse_p`` is the p value of the simulation, ``structure_p`` that of residuals independent of the input.
    """

    channel: str
    joint: int | None = None
    unit: str = ""
    rmse: Number
    noise_floor: Number
    ratio: Number
    allowed: Number = None
    limit: Number
    rmse_p: Number
    structure_p: Number


class ValueChange(Part):
    """A parameter as accepted and as refitted; ``p_value`` is corrected for the number of parameters."""

    name: str
    joint: int | None = None
    unit: str = ""
    before: Number
    after: Number
    std_error: Number
    z: Number
    p_value: Number
    changed: bool


class WorstWindow(Part):
    """A scored window (s) with its RMSE over the noise floor."""

    begin: float
    end: float
    ratio: Number


class VerificationPart(Part):
    """`labhil.verification/1`."""

    recordings: tuple[Source, ...]
    model: str
    rig: str
    terms: tuple[str, ...]
    verdict: Literal["consistent", "contradicted"]
    alpha: float
    p_value: Number
    reasons: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    faults: tuple[Fault, ...] = ()
    doubts: tuple[str, ...] = ()
    adequacy: Literal["explained", "unexplained", "worse_than_mean"] = "explained"
    residual_over_noise: dict[str, Number] = Field(default_factory=dict)
    score: Score
    channels: tuple[ChannelVerdict, ...]
    values_p: Number
    parameters: tuple[ValueChange, ...] = ()
    worst_windows: tuple[WorstWindow, ...] = ()
    window: Number = None
    seconds: Number = None

    @property
    def consistent(self) -> bool:
        """Whether the recording does not contradict the model."""
        return self.verdict == "consistent"

    @property
    def statement(self) -> str:
        """A line on whether the accepted values explain the recording."""
        r2 = [row.r2 for row in self.score.scored if row.r2 is not None]
        return fit_verdict(self.adequacy, self.residual_over_noise, min(r2, default=None))

    @property
    def next_steps(self) -> tuple[str, ...]:
        """The next steps, the most useful first: a sentence or two each."""
        return steps_after_verification(self)
