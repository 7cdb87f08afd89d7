"""A fit in its JSON (`labhil.fit/1`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from labhil.analysis.next_steps import steps_after_fit
from labhil.analysis.schema.parts import (
    EstimatedCurve,
    Fault,
    Number,
    Parameter,
    Parameters,
    Part,
    Score,
    Source,
    StudyPart,
)
from labhil.analysis.verdicts import fit_verdict


class Identifiability(Part):
    """Combinations of parameters that the data do not determine."""

    rank: int
    of: int
    combinations: tuple[str, ...] = ()
    would_help: tuple[str, ...] = ()


class ResidualTests(Part):
    """p values that residuals are white and uncorrelated with the input."""

    ljung_box_p: Number = None
    input_crosscorrelation_p: Number = None


class Intervals(Part):
    """The method of the intervals."""

    method: str = "wald"
    simultaneous: bool = False


class WindowEstimate(Part):
    """Estimates with fitted windows of one length."""

    window: float
    residual: Number = None
    values: dict[str, Number]
    std_errors: dict[str, Number]


class FittedChannel(Part):
    """The residual RMSE of one channel in the fitted windows."""

    channel: str
    joint: int | None = None
    unit: str = ""
    rmse: Number = None


class FitPart(StudyPart):
    """`labhil.fit/1`."""

    recordings: tuple[Source, ...]
    rig: str
    estimator: str = ""
    seed: int = 0
    verdict: Literal["explained", "unexplained", "worse_than_mean"] | None = None
    residual_over_noise: dict[str, Number] = Field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    doubts: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    sampling: tuple[str, ...] = ()
    terms: tuple[str, ...]
    parameters: Parameters
    covariance: tuple[tuple[Number, ...], ...] = ()
    identifiability: Identifiability
    train: Score
    test: Score | None = None
    residuals: ResidualTests = ResidualTests()
    intervals: Intervals = Intervals()
    criterion: str = "windowed_simulation"
    left: tuple[FittedChannel, ...] = ()
    window: Number = None
    by_window: tuple[WindowEstimate, ...] = ()
    compared: tuple[float, ...] = ()
    curve: EstimatedCurve | None = None
    further_curves: tuple[EstimatedCurve, ...] = ()
    converged: bool = True
    evaluations: int = 0

    @property
    def statement(self) -> str | None:
        """The verdict as a line; None of a result without one."""
        if self.verdict is None:
            return None
        scores = [self.train] if self.test is None else [self.train, self.test]
        r2 = [row.r2 for score in scores for row in score.scored if row.r2 is not None]
        return fit_verdict(self.verdict, self.residual_over_noise, min(r2, default=None))

    @property
    def next_steps(self) -> tuple[str, ...]:
        """The next steps, the most useful first: a sentence or two each."""
        return steps_after_fit(self)

    @property
    def judged_rows(self) -> Sequence[Parameter]:
        """The parameters, without significance where the model does not explain its data."""
        if self.verdict in (None, "explained"):
            return self.parameters
        return tuple(row.model_copy(update={"significant": None}) for row in self.parameters)
